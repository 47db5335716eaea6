"""The statistics of the source code, held to a small package worked by hand."""

from pathlib import Path

import pytest
from checks.structure import circles, read

SOURCE = '''"""Two lines of
prose."""

from tiltcal.other import thing

LIMIT, LEAST = 3.0, -1  # two numbers
NAMES = ("a", "b")


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


def test_tokens_constants_and_bodies_are_counted(package):
    source = read(package / "one.py", package)
    assert (source.lines, source.code, source.constants) == (13, 6, 2)
    assert source.tokens == 6 + 8 + 7 + 6 + 5 + 2
    assert source.bodies == ((2, "body"),)


def test_a_circle_of_imports_is_found(package):
    sources = [read(path, package) for path in sorted(package.glob("*.py"))]
    assert [sorted(group) for group in circles(sources)] == [["tiltcal.one", "tiltcal.other"]]
    assert circles(sources[:1]) == []
