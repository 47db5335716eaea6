"""The documentation: pages say what they are for, examples are real, links lead somewhere."""

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
import yaml
from docs_examples import PAGES, ROOT, examples_of

PICTURE = re.compile(r"!\[[^\]]+\]\(pictures/([^)]+)\)")


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_every_example_prints_what_the_page_says(page):
    for example in examples_of(page):
        assert example.holds, f"{example.command}\nstated:\n{example.stated}\n{example.printed}"


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_every_page_begins_with_what_the_reader_can_do_after_it(page):
    title, _, text = page.read_text(encoding="utf-8").partition("\n")
    assert title.startswith("# ")
    assert text.strip().startswith("After this page you")


@pytest.mark.parametrize("page", [*PAGES, *sorted(ROOT.glob("*.md"))], ids=lambda page: page.stem)
def test_every_link_leads_somewhere(page):
    text = page.read_text(encoding="utf-8")
    for target in re.findall(r"\]\((?!https?:|pictures/)([^)#]+)(?:#[^)]*)?\)", text):
        assert (page.parent / target).exists(), target


def test_every_page_is_in_the_navigation():
    class Loader(yaml.SafeLoader):
        """Site settings may name Python objects."""

    Loader.add_multi_constructor("tag:yaml.org,2002:python/", lambda *_: None)
    site = yaml.load((ROOT / "mkdocs.yml").read_text(encoding="utf-8"), Loader)
    assert sorted(pages_in(site["nav"])) == [page.name for page in PAGES]


def pages_in(nav):
    """The files of a navigation."""
    for entry in nav:
        if isinstance(entry, str):
            yield entry
        else:
            (below,) = entry.values()
            yield from [below] if isinstance(below, str) else pages_in(below)


def test_every_picture_is_one_that_the_build_draws(monkeypatch):
    monkeypatch.syspath_prepend(ROOT / "docs" / "site")
    from tutorial_pictures import PICTURES

    shown = {name for page in PAGES for name in PICTURE.findall(page.read_text(encoding="utf-8"))}
    assert shown == set(PICTURES)


@pytest.mark.long
def test_the_site_is_built_without_warnings_and_loads_nothing_from_other_hosts(tmp_path):
    program = Path(sys.executable).parent / "mkdocs"
    words = [program, "build", "--strict", "--quiet", "--site-dir", tmp_path]
    quick = os.environ | {"TILTCAL_DOCS_PICTURES": "off", "NO_MKDOCS_2_WARNING": "1"}
    done = subprocess.run(words, cwd=ROOT, env=quick, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (0, "")
    pages = list(tmp_path.rglob("*.html"))
    assert len(pages) > len(PAGES)
    loading = re.compile(
        r"<(?:script|link|img|iframe)\b[^>]*?\b(?:src|href)=\"?(?:https?:)?//[^>]*>"
    )
    for page in pages:
        text = page.read_text(encoding="utf-8")
        assert not loading.search(text), page
    assert "site/assets/iframe-worker.js" in (tmp_path / "index.html").read_text(encoding="utf-8")
    _look_at_every_page([p for p in pages if p.name != "404.html"])  # that one is for a server


def _look_at_every_page(pages):
    """Every page in a phone's width and the other way round in the dark: nothing is asked of a
    network, nothing complains, nothing is cut off; a dark page is dark.
    """
    program = shutil.which("chromium") or shutil.which("chromium-browser")
    if program is None:
        return
    from playwright.sync_api import sync_playwright

    with sync_playwright() as play:
        browser = play.chromium.launch(executable_path=program, args=["--no-sandbox"])
        for width, scheme in ((390, "light"), (1280, "dark")):
            context = browser.new_context(
                viewport={"width": width, "height": 900}, color_scheme=scheme
            )
            page, noted = context.new_page(), []
            page.on("pageerror", lambda error, noted=noted: noted.append(str(error)))
            page.on("console", lambda m, noted=noted: m.type == "error" and noted.append(m.text))
            page.on("request", lambda request, noted=noted: noted.append(request.url))
            for path in pages:
                noted.clear()
                page.goto(path.as_uri(), wait_until="load")
                assert [n for n in noted if not n.startswith("file:")] == [], path
                wide = page.evaluate("document.documentElement.scrollWidth - innerWidth")
                assert wide <= 0, (path, width)
                colour = page.evaluate("getComputedStyle(document.body).backgroundColor")
                light = sum(int(c) for c in re.findall(r"\d+", colour)[:3]) / 3
                assert (light < 100) == (scheme == "dark"), (path, colour)
        browser.close()
