"""The reference pages: docs/physics.md defines every effect once; what code cites is a heading or a
publication; modules, files and commands that the pages name exist.
"""

import pkgutil
import re
from functools import cache
from pathlib import Path

import pytest
from docs_examples import ROOT

from tiltcal.cli.commands import COMMANDS
from tiltcal.effects import CATALOGUE

PAGES = ("physics", "sources", "interfaces")
PAGE = (ROOT / "docs" / "physics.md").read_text(encoding="utf-8")
HEADING = re.compile(r"^#{2,3} (.+)$", re.M)
ROW = re.compile(r"^\| `(\w+)` \| (.+) \| (.+) \| (.+) \|$", re.M)
SHORT = re.compile(r"^\| ([^|]+?) \| [^|]+ \|$", re.M)
CHAPTER = "Physics: "
CITATION = re.compile(r'docs/(\w+)\.md,\s+"([^"]+)"')
CODE = sorted(
    p
    for folder in ("tiltcal", "sim", "tests")
    for p in (ROOT / folder).rglob("*.py")
    if p.is_file()
)


@cache
def chapters() -> dict[str, str]:
    """Heading -> the text below it, up to the next heading."""
    found = list(HEADING.finditer(PAGE))
    ends = [*(m.start() for m in found[1:]), len(PAGE)]
    return {m.group(1): PAGE[m.end() : end] for m, end in zip(found, ends, strict=True)}


def test_every_effect_is_defined_exactly_once():
    defined = [match.group(1) for match in ROW.finditer(PAGE)]
    assert sorted(defined) == sorted(CATALOGUE)


@pytest.mark.parametrize("id", CATALOGUE)
def test_a_source_names_the_chapter_that_defines_the_effect_and_publications_it_lists(id):
    *publications, last = CATALOGUE[id].source.split("; ")
    assert last.startswith(CHAPTER)
    row = next(m for m in ROW.finditer(chapters()[last.removeprefix(CHAPTER)]) if m.group(1) == id)
    assert all(cell.strip() for cell in row.groups())
    listed = {match.group(1) for match in SHORT.finditer(chapters()["References"])}
    for publication in publications:
        assert publication in listed
        assert publication in row.group(3)


def test_headings_that_code_cites_exist():
    cited = {
        (page, heading)
        for path in CODE
        for page, heading in CITATION.findall(path.read_text(encoding="utf-8"))
    }
    for page, heading in cited:
        text = (ROOT / "docs" / f"{page}.md").read_text(encoding="utf-8")
        assert " ".join(heading.split()) in HEADING.findall(text), f"{page}: {heading}"


PYTHON_NAME = re.compile(r"`(tiltcal(?:\.\w+)+|tiltsim(?:\.\w+)+)`")
FILE = re.compile(r"`((?:scenarios|tests)/[\w/]+\.\w+)`")
COMMAND = re.compile(r"`tiltcal ([a-z-]+)")


def named(pattern: re.Pattern[str]) -> list[str]:
    """What the reference pages name in this way."""
    texts = [(ROOT / "docs" / f"{page}.md").read_text(encoding="utf-8") for page in PAGES]
    return sorted({name for text in texts for name in pattern.findall(text)})


@pytest.mark.parametrize("name", named(PYTHON_NAME))
def test_a_named_module_or_function_exists(name):
    assert pkgutil.resolve_name(name) is not None


@pytest.mark.parametrize("name", named(FILE))
def test_a_named_file_exists(name):
    assert (ROOT / name).exists()


def test_named_commands_exist():
    assert set(named(COMMAND)) <= set(COMMANDS)


OUTSIDE = re.compile(r"\b(?:PHYSICS|METHODS) \d|\bCONTRACT\b|\bseed S\d|\bshared/|[\"']shared[\"']")


@pytest.mark.parametrize("folder", ["tiltcal", "sim", "tests", "docs", "scenarios", "models"])
def test_nothing_cites_a_document_outside_the_repository(folder):
    files = [p for p in (ROOT / folder).rglob("*") if p.suffix in {".py", ".md", ".toml", ".xml"}]
    assert files
    texts = {p: p.read_text(encoding="utf-8") for p in files if p != Path(__file__)}
    assert [str(p) for p, text in texts.items() if OUTSIDE.search(text)] == []


def test_named_tests_exist():
    tests = "\n".join(p.read_text(encoding="utf-8") for p in (ROOT / "tests").glob("test_*.py"))
    for name in named(re.compile(r"`(test_\w+)`")):
        assert f"def {name}(" in tests, name
