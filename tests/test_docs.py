"""The documentation: pages say what they are for, examples are real, links lead somewhere."""

import re

import pytest
from docs_examples import PAGES, ROOT, examples_of


@pytest.mark.slow
@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_every_example_prints_what_the_page_says(page):
    for example in examples_of(page):
        assert example.holds, f"{example.command}\nstated:\n{example.stated}\n{example.printed}"


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_every_page_begins_with_what_the_reader_can_do_after_it(page):
    title, _, text = page.read_text(encoding="utf-8").partition("\n")
    assert title.startswith("# ")
    assert text.strip().startswith("After this page you")


@pytest.mark.parametrize("page", [*PAGES, ROOT / "README.md"], ids=lambda page: page.stem)
def test_every_link_leads_somewhere(page):
    text = page.read_text(encoding="utf-8")
    for target in re.findall(r"\]\((?!https?:)([^)#]+)(?:#[^)]*)?\)", text):
        assert (page.parent / target).exists(), target
