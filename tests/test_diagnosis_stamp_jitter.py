"""Random stamps against noise that grows with the rate or while moving: only the first makes all
channels of a row err together, as their rates say.
"""

import shutil
from pathlib import Path

import numpy as np
import pytest
from diagnosis_fixtures import honest, rewritten

from tiltcal.cli import main
from tiltcal.data_quality.spikes import off_neighbours
from tiltcal.diagnosis.data_faults.prepare import prepare
from tiltcal.laboratory.scenario import load_scenario, parse_scenario
from tiltcal.recordings.recording_files import read_recording

JITTER = 5e-3  # s
COLUMNS = [f"accel_{a}_m_s2" for a in "xyz"]


def slopes_of(sound):
    """d reading / dt of each channel, m/s3, (n, 3)."""
    values = np.column_stack([sound.column(name) for name in COLUMNS])
    return np.gradient(values, sound.time, axis=0)


def own_times_rate(rng, slopes):
    """Noise of each channel in proportion to its own rate: variances just as random stamps make
    them.
    """
    return slopes * rng.normal(0, JITTER, slopes.shape)


def louder_in_moves(rng, slopes):
    """Noise that is louder in some moves, whatever their rate."""
    moving = np.abs(slopes).max(axis=1) > 0.05
    loud = moving & (np.cumsum(np.diff(moving.astype(int), prepend=0) == 1) % 2 == 0)
    return 0.01 * loud[:, None] * rng.standard_normal(slopes.shape)


def trembling_in_moves(rng, slopes):
    """While moving the table trembles: two channels share most of their noise."""
    moving = np.abs(slopes).max(axis=1) > 0.05
    common = rng.standard_normal((len(slopes), 1)) * [1.0, 0.7, 0.0]
    return 0.01 * moving[:, None] * (common + 0.5 * rng.standard_normal(slopes.shape))


def found_in(truth, sound, noise):
    columns = {name: sound.column(name) + noise[:, k] for k, name in enumerate(COLUMNS)}
    return prepare(honest(truth), [rewritten(sound, **columns)]).faults


def test_random_stamps_that_are_stated_are_left_out_alike(truth, sound, rng):
    slopes = slopes_of(sound)
    noise = slopes * rng.normal(0, JITTER, (len(slopes), 1))
    columns = {name: sound.column(name) + noise[:, k] for k, name in enumerate(COLUMNS)}
    table = honest(truth).model_dump(exclude_defaults=True, by_alias=True)
    stated = [{"id": "data_jitter", "sensor": "accel", "jitter_ms": 1e3 * JITTER}]
    knows = parse_scenario({"schema": 1, **table, "effect": stated})
    read = [rewritten(sound, **columns)]
    found, known = prepare(honest(truth), read), prepare(knows, read)
    assert known.faults == ()
    for a, b in zip(found.observations.channels, known.observations.channels, strict=True):
        assert len(b.values) == len(a.values) < len(sound)


def test_random_stamps_are_found_and_sized(truth, sound, rng):
    slopes = slopes_of(sound)
    (fault,) = found_in(truth, sound, slopes * rng.normal(0, JITTER, (len(slopes), 1)))
    assert fault.effect.id == "data_jitter"
    off = fault.effect.value("jitter") - JITTER
    assert abs(off) < 4 * fault.sigma["jitter"] + 0.1 * JITTER


@pytest.mark.parametrize("noise", [own_times_rate, louder_in_moves, trembling_in_moves])
def test_noise_that_grows_in_moves_is_no_fault_of_the_stamps(truth, sound, noise, rng):
    faults = found_in(truth, sound, noise(rng, slopes_of(sound)))
    assert "data_jitter" not in [fault.effect.id for fault in faults]


def test_of_one_channel_nothing_is_claimed(truth, sound, rng):
    slopes = slopes_of(sound) * [1.0, 0.0, 0.0]
    noise = slopes * rng.normal(0, JITTER, (len(slopes), 1))
    assert not found_in(truth, sound, noise)


def test_a_value_is_far_off_by_the_noise_of_its_own_rate(rng):
    """Short moves whose noise follows a bell of rate; a value far beyond it is still seen."""
    speed = np.tile(np.concatenate([np.zeros(60), np.sin(np.linspace(0, np.pi, 30)) ** 2]), 40)
    values = (1 + 40 * speed) * rng.standard_normal(len(speed))
    assert (off_neighbours(values) > 8).sum() > 10
    assert (off_neighbours(values, speed) > 8).sum() == 0
    values[75] = 4000.0
    assert off_neighbours(values, speed)[75] > 8


def test_a_hand_that_begins_to_turn_is_no_outlier(rng):
    """All that is known of its rate is whether it turns: noise nine times as loud from a row on."""
    turning = np.tile(np.repeat([0.0, 1.0], [150, 40]), 40)
    values = (1 + 8 * turning) * rng.standard_normal(len(turning))
    before, after = ((off_neighbours(values, how) > 8).sum() for how in (None, turning))
    assert before > 5
    assert after <= 3  # no fault is claimed of so few


@pytest.mark.parametrize("turn", [(1, -1), (1, 1, -1, -1), (2, -1, -1)])
def test_stamps_that_come_early_and_late_in_turn_are_not_random(truth, sound, turn):
    """Double buffers and packets: as large as random stamps that are found."""
    slopes = slopes_of(sound)
    late = np.resize(np.array(turn, float), len(slopes))
    late *= JITTER / late.std()
    faults = found_in(truth, sound, slopes * late[:, None])
    assert "data_jitter" not in [fault.effect.id for fault in faults]


ARM = Path(__file__).parents[1] / "scenarios" / "arm" / "arm.xml"
AXES = ("pan", "lift", "elbow", "wrist")


def test_where_a_move_begins_between_two_rows_says_nothing_of_the_stamps(tmp_path):
    """All channels of an arm err together in the row at which a quick move begins: its prediction
    is uncertain there, and weighs as little as it does in the fit.
    """
    head = f"""\
schema = 1
name = "arm"
seed = 2
[site]
gravity_m_s2 = 9.82
[rig]
mjcf = "arm.xml"
site = "tool"
axes = {{ {", ".join(f'{a} = "{a}"' for a in AXES)} }}
readout = "command"
[[sensor]]
name = "accel"
kind = "accelerometer"
rate_hz = 50
adjustable = ["bias", "scale", "cross_axis"]
"""
    rng = np.random.default_rng(5)  # poses at which it was taken for a scatter of the stamps
    moves = [
        '[[sequence]]\naction = "move"\ndwell_s = 1.5\nrate_deg_s = 60\n'
        + "\n".join(
            f"{a}_deg = {x:.0f}"
            for a, x in zip(AXES, rng.uniform(-1, 1, 4) * [175, 75, 75, 175], strict=True)
        )
        for _ in range(28)
    ]
    noise = '[[effect]]\nid = "acc_noise"\nwhite_ug_rthz = 32\n'
    shutil.copy(ARM, tmp_path)
    (tmp_path / "truth.toml").write_text("\n".join([head, *moves, noise]))
    (tmp_path / "honest.toml").write_text(head)
    assert main(["simulate", str(tmp_path / "truth.toml"), "-o", str(tmp_path / "run.csv")]) == 0
    recording = read_recording(tmp_path / "run.csv")
    faults = prepare(load_scenario(tmp_path / "honest.toml"), [recording]).faults
    assert faults == ()
