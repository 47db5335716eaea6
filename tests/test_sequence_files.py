"""A sequence as a laboratory's file: what is written is what is read, and what cannot be is
said.
"""

from pathlib import Path

import numpy as np
import pytest

from tiltcal.core.errors import TiltcalError
from tiltcal.setup.schedule import build_schedule
from tiltcal.setup.sequence import Step
from tiltcal.setup.sequence_files import read_sequence, sequence_columns, sequence_text
from tiltcal.setup.setup import Rig

DUAL = Rig(table="dual")
HEAD = ",".join(sequence_columns(())) + "\n"


def written(tmp_path: Path, text: str) -> Path:
    path = tmp_path / "sequence.csv"
    path.write_text(text)
    return path


def test_a_sequence_comes_back_with_the_same_angles_at_every_instant(tmp_path: Path) -> None:
    steps = (
        Step(action="rest", dwell_s=2),
        Step(action="remount", mount="Rz(180)"),
        Step(action="move", outer_deg=30, inner_deg=-45, dwell_s=3, rate_deg_s=17, label="first"),
        Step(action="turn", axis="inner", angle_deg=720, rate_deg_s=40),
        Step(action="sweep", outer_deg=60, step_deg=10, dwell_s=1),
        Step(action="scheme", scheme="6", dwell_s=1.5),
    )
    first = build_schedule(steps, DUAL)
    back = build_schedule(read_sequence(written(tmp_path, sequence_text(steps, DUAL))), DUAL)
    assert back.times[1] == pytest.approx(first.times[1], abs=1e-4)
    time = np.linspace(0, first.times[1], 2000)
    for name in DUAL.axis_names:
        np.testing.assert_allclose(
            back.drive(time).axes[name].x, first.drive(time).axes[name].x, atol=2e-6
        )
    assert (
        [m for _, m in back.mountings(time)]
        == [m for _, m in first.mountings(time)]
        == ["identity", "Rz(180)"]
    )
    assert list(back.labels(time)) == list(first.labels(time))


def test_an_empty_cell_means_unchanged(tmp_path: Path) -> None:
    steps = read_sequence(
        written(tmp_path, HEAD + "1,move,10,,20,5,1,,\n2,turn,50,,,10,,,\n3,sweep,,,0,10,2,,\n")
    )
    end = build_schedule(steps, DUAL).drive(np.array([1e6])).axes
    assert np.degrees(end["outer"].x[0]) == pytest.approx(50)
    assert np.degrees(end["inner"].x[0]) == pytest.approx(0)


def test_a_whole_turn_is_called_a_turn_and_needs_no_more_columns() -> None:
    text = sequence_text((Step(action="move", outer_deg=360, rate_deg_s=40, dwell_s=3),), DUAL)
    assert text.splitlines()[1] == "1,turn,360,,,40,3,,"


@pytest.mark.parametrize(
    ("text", "found"),
    [
        (HEAD, "no steps"),
        ("step,outer_deg\n1,3\n", "no steps"),
        ("step,action,outer\n1,move,3\n", "column 'outer'"),
        (HEAD + "1,swing,,,,,,,\n", "action 'swing'"),
        (HEAD + "1,move,far,,,,,,\n", "'far'"),
        (HEAD + "1,move,nan,,,,,,\n", "'nan'"),
        (HEAD + "1,move,3,,,0,,,\n", "'0'"),
        (HEAD + "1,rest,,,,,-1,,\n", "'-1'"),
        (HEAD + "1,remount,,,,,,,\n", "remount without a mount"),
        (HEAD + "1,remount,,,,,,Rq(3),\n", "'Rq(3)'"),
    ],
)
def test_a_wrong_cell_is_named(tmp_path: Path, text: str, found: str) -> None:
    with pytest.raises(TiltcalError) as error:
        read_sequence(written(tmp_path, text))
    assert found in error.value.found


def test_bytes_that_are_no_text_are_no_sequence(tmp_path: Path) -> None:
    path = tmp_path / "sequence.csv"
    path.write_bytes(b"step,action\n\xff\xfe,rest\n")
    with pytest.raises(TiltcalError, match="no table"):
        read_sequence(path)


def test_what_has_no_word_in_the_file_is_refused() -> None:
    with pytest.raises(TiltcalError, match="oscillate"):
        sequence_text(
            (Step(action="oscillate", axis="outer", amplitude_deg=5, frequency_hz=1),), DUAL
        )
    with pytest.raises(TiltcalError, match="handheld"):
        sequence_text((Step(action="rest", dwell_s=1),), Rig(table="handheld"))
