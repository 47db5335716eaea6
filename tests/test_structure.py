"""The limits of the source code, held to a small package worked by hand."""

from dataclasses import replace
from pathlib import Path

import pytest
from checks.structure import LONGEST_BODY, LONGEST_FILE, circle, complaints, main, read

SOURCE = '''"""Two lines of
prose."""

from tiltcal.other import thing


def body(x):
    """Not counted."""
    y = x + 1
    return y
'''


@pytest.fixture
def package(tmp_path: Path) -> Path:
    """A package of two modules that import each other."""
    folder = tmp_path / "tiltcal"
    folder.mkdir()
    (folder / "one.py").write_text(SOURCE)
    (folder / "other.py").write_text("from tiltcal.one import body\n")
    return folder


def test_lines_and_bodies_are_counted(package):
    source = read(package / "one.py", package)
    assert (source.module, source.lines, source.bodies) == ("tiltcal.one", 10, ((2, "body"),))


def test_a_circle_of_imports_is_found(package):
    sources = [read(path, package) for path in sorted(package.glob("*.py"))]
    assert set(circle(sources)) == {"tiltcal.one", "tiltcal.other"}
    assert [line.split(":")[0] for line in complaints(sources)] == ["circle of imports"]
    assert circle(sources[:1]) == []


@pytest.mark.parametrize(
    ("more", "words"),
    [
        ({"lines": LONGEST_FILE + 1}, "601 lines, at most 600"),
        ({"bodies": ((LONGEST_BODY + 1, "body"),)}, "body of 41 lines, at most 40"),
    ],
)
def test_what_exceeds_a_limit_is_named(package, more, words):
    source = read(package / "one.py", package)
    assert list(complaints([source])) == []
    (line,) = complaints([replace(source, **more)])
    assert line.startswith("tiltcal.one")
    assert words in line


def test_the_source_keeps_its_limits(capsys):
    assert main() == 0, capsys.readouterr().out
