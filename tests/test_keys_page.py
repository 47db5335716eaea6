"""The page of all keys is that of the models, and says what every key means."""

import subprocess
import sys

import numpy as np
import pytest
from keys_page import FILES, PAGE, page, sections_of

from tiltcal.calibration.result import Calibration


@pytest.mark.parametrize("file", FILES, ids=lambda file: file.title)
def test_every_key_has_a_meaning(file):
    for name, section in sections_of(file).items():
        properties = section.schema["properties"]
        unexplained = [key for key in section.keys if not properties[key].get("description")]
        assert unexplained == [], f"{name}: write a docstring below the field"
        assert section.about, name


def test_the_page_is_as_the_models_say():
    """In a process of its own: other tests add tables to those that a scenario may name."""
    words = [sys.executable, "-m", "tests.keys_page"]
    done = subprocess.run(words, cwd=PAGE.parents[1], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr


@pytest.mark.parametrize("file", FILES, ids=lambda file: file.title)
def test_headings_differ_so_that_links_lead_to_their_table(file):
    anchors = [section.anchor for other in FILES for section in sections_of(other).values()]
    for section in sections_of(file).values():
        assert anchors.count(section.anchor) == 1
        assert f"### {section.heading}\n" in page()


def test_what_a_calibration_writes_is_on_the_page():
    (stored,) = [f for f in FILES if f.title == "CAL.json"]
    written = Calibration("mine", "good", {}, np.zeros((0, 0)), own_frame=True).to_json()
    assert set(written) <= set(sections_of(stored)["StoredCalibration"].keys)
