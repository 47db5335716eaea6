"""Every number that decides a diagnosis is on a page, with what it decides."""

import subprocess
import sys

import pytest

from tests.constants_page import PAGE, numbers, vary


def test_every_number_says_what_it_decides():
    found = list(numbers())
    assert len(found) > 100
    assert [n.name for n in found if not n.about] == []
    names = [n.name for n in found]
    assert len(set(names)) == len(names)


def test_the_page_is_as_the_code_says():
    words = [sys.executable, "-m", "tests.constants_page"]
    done = subprocess.run(words, cwd=PAGE.parents[1], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr


def test_a_number_that_is_none_is_refused():
    with pytest.raises(SystemExit, match="no such number"):
        vary("candidates.NONE", 1)
