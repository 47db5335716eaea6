"""Every number that decides a diagnosis is on a page, with what it decides."""

import json
import os
import subprocess
import sys

import pytest

from tests.constants_effects import FAILS, SCALED, TYPES, UNUSED, measure, varied
from tests.constants_page import EFFECTS, PAGE, ROOT, Number, known_effects, numbers


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
        measure("candidates.NONE", 1)


def test_a_number_is_varied_before_others_are_derived_from_it(tmp_path):
    """And several in one, each; the copy is as before afterwards."""
    file = tmp_path / "tiltcal" / "some.py"
    file.parent.mkdir()
    (file.parent / "__init__.py").touch()
    file.write_text("A, B = (\n    3,\n    (0.5, 'x'),\n)\nC = 2 * A\n")
    (tmp_path / "scaled_number.py").write_text(SCALED)
    number = Number(ROOT / "tiltcal" / "some.py", ("A", "B"), "", "", 4)
    with varied(number, 2.0, tmp_path):
        said = subprocess.run(
            [sys.executable, "-c", "from tiltcal.some import *; print(A, B, C)"],
            cwd=tmp_path,
            env=os.environ | {"PYTHONPATH": str(tmp_path)},
            capture_output=True,
            text=True,
            check=True,
        )
    assert said.stdout == "6 (1.0, 'x') 12\n"
    assert file.read_text().startswith("A, B = (\n    3,\n    (0.5, 'x'),\n)\nC")


def test_what_was_measured_is_of_numbers_that_are_there():
    """Of values that changed since, and of names that are gone, nothing is shown."""
    kept = json.loads(EFFECTS.read_text())
    assert set(kept) == set(known_effects())
    told = {found[which] for found in kept.values() for which in ("halved", "doubled")}
    assert told <= {*range(len(TYPES) + 1), UNUSED, FAILS}
