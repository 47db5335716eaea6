"""Turns of a stated total angle (Ferraris): a gyro triad on a hand or table axis between rests."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from statistics_helpers import rng_of

from tiltcal.calibration.methods import gyro_turns
from tiltcal.calibration.methods.registry import calibrate
from tiltcal.calibration.methods.stated_angles import StatedAngles
from tiltcal.core.frames import AXES, parse_turn
from tiltcal.core.units import DEG
from tiltcal.recordings.recording import Recording
from tiltcal.setup.setup import Setup

RATE, NOISE = 50.0, 0.05 * DEG  # Hz, rad/s a sample
M = np.array([[1.01, -0.003, 0.002], [0.001, 0.98, -0.002], [0.0015, -0.004, 1.03]])
BIAS = np.array([0.01, -0.02, 0.005])
EARTH = 7.292115e-5 * np.array([0.0, np.cos(40 * DEG), np.sin(40 * DEG)])
G = 9.80123
SETUP = Setup.model_validate(
    {
        "site": {"gravity_m_s2": G, "latitude_deg": 40.0},
        "rig": {"table": "handheld"},
        "sensor": [
            {"name": "gyro", "kind": "gyro", "rate_hz": RATE},
            {"name": "accel", "kind": "accelerometer", "rate_hz": RATE},
        ],
    }
)
# about each axis while it is vertical, then quarter turns from face to face
SESSION = [(2, 360), (2, -360), (0, 90), (1, 360), (1, -360), (2, 90), (0, 360), (0, -720)]
FULL = [0, 1, 3, 4, 6, 7]
QUARTERS = [(0, 1)] * 4 + [(1, 1)] * 4 + [(0, 1)] + [(2, 1)] * 4
QUARTERS += [(1, 1), (0, -1), (2, 1), (1, -1), (0, 1), (2, -1)]
SESSION += [(axis, 90 * way) for axis, way in QUARTERS]


@pytest.fixture(autouse=True)
def no_turns_left_out(monkeypatch):
    """It costs most, and changes no parameter."""
    monkeypatch.setattr(gyro_turns, "_held_out", lambda *_: 0.0)


def recorded(turns, name, stated, tilt=(0.0, 0.0, 0.0)):
    """Rests of 3 s with turns between them in closed form at 50 Hz, by the equations of a triad
    written out.

    Args:
        turns: axis of the body and angle of each, deg.
        name: of the noise.
        stated: label of the rows of each turn; None: no label.
        tilt: rotation vector from the axes that are turned about to those of the body, rad.
    """
    away = Rotation.from_rotvec(tilt).as_matrix()
    parts, words = [np.zeros((400, 3))], [[None] * 400]
    for (axis, angle), label in zip(turns, stated, strict=True):
        count = 100 if abs(angle) < 360 else 200
        profile = np.sin(np.pi * (np.arange(count) + 0.5) / count) ** 2
        profile *= angle * DEG / (profile.sum() / RATE)
        parts += [np.outer(profile, away[:, axis]), np.zeros((150, 3))]
        words += [[label] * count, [None] * 150]
    w = np.vstack(parts)
    # each sample stands for its interval, so that the sum of the steps is the angle
    steps = Rotation.from_rotvec(w / RATE)
    attitude = [Rotation.from_rotvec([0.05, -0.03, 0.0])]
    for step in steps[:-1]:
        attitude.append(attitude[-1] * step)
    body = Rotation.concatenate(attitude).inv()
    rng = rng_of(f"stated turns {name}")
    total = w + body.apply(np.tile(EARTH, (len(w), 1)))
    gyro = BIAS + total @ M.T + rng.normal(0, NOISE, w.shape)
    force = body.apply(np.tile([0, 0, G], (len(w), 1))) + rng.normal(0, 5e-3, w.shape)
    columns = {f"gyro_{a}_rad_s": gyro[:, i] for i, a in enumerate(AXES)}
    columns |= {f"accel_{a}_m_s2": force[:, i] for i, a in enumerate(AXES)}
    labels = np.array([w for part in words for w in part], dtype=object)
    return Recording.from_columns(np.arange(len(w)) / RATE, columns, labels=labels, source="f.csv")


def begin_of(number):
    """When a turn of the session begins, s."""
    rows = [100 if abs(angle) < 360 else 200 for _, angle in SESSION[:number]]
    return (400 + sum(rows) + 150 * number) / RATE


def as_made(turns):
    """Labels of the full turns."""
    return [
        f"turn {AXES[axis]} {angle}" if k in FULL else None for k, (axis, angle) in enumerate(turns)
    ]


def z_scores(found):
    """Errors of scale and cross-axis terms in standard uncertainties."""
    scores = []
    for i, a in enumerate(AXES):
        for j, b in enumerate(AXES):
            name = f"gyro.scale_{a}" if i == j else f"gyro.cross_{a}{b}"
            estimate = found.parameters[name]
            scores.append((estimate.value - (M[i, j] - (i == j))) / estimate.sigma)
    return np.array(scores)


def test_turns_of_a_known_angle_give_a_triad_within_its_uncertainty():
    scores = []
    for seed in range(3):
        log = recorded(SESSION, f"known {seed}", as_made(SESSION))
        found = calibrate("gyro_turns", log, SETUP)
        assert found.verdict == "good", [t.statement for t in found.tests if not t.passed]
        scores.append(z_scores(found))
        assert any("the angle of 6 of 27 turns is stated" in w for w in found.warnings)
    scores = np.array(scores)
    assert np.abs(scores).max() < 4.5
    assert 0.3 < np.mean(scores**2) < 2.3  # 27 of them, 5 standard deviations of chance


def test_the_scale_factor_is_as_certain_as_the_stated_angles_make_it():
    """At least: by the noise of the integral of each full turn of an axis alone. Without the labels
    gravity does not see the full turns at all: their axis is vertical.
    """
    found = calibrate("gyro_turns", recorded(SESSION, "bound", as_made(SESSION)), SETUP)
    none = [None] * len(SESSION)
    bare = calibrate("gyro_turns", recorded(SESSION, "bound", none), SETUP)
    for i, a in enumerate(AXES):
        angles = np.array([SESSION[k][1] for k in FULL if SESSION[k][0] == i])
        noise = NOISE * np.sqrt(200) / RATE  # of the integral, rad
        by_hand = noise / np.sqrt(np.sum((angles * DEG) ** 2))
        sigma = found.parameters[f"gyro.scale_{a}"].sigma
        assert sigma < 1.3 * by_hand
        assert sigma < 0.7 * bare.parameters[f"gyro.scale_{a}"].sigma


def test_an_axis_that_is_not_quite_that_of_the_body_does_no_harm():
    log = recorded(SESSION, "tilted", as_made(SESSION), tilt=(0.02, -0.03, 0.015))
    found = calibrate("gyro_turns", log, SETUP)
    assert found.verdict == "good", [t.statement for t in found.tests if not t.passed]
    assert np.abs(z_scores(found)).max() < 4.5


@pytest.mark.parametrize(("number", "made"), [(3, 370), (6, 720), (1, -359)])
def test_a_wrong_angle_is_suspect_and_its_turn_is_named(number, made):
    turns = list(SESSION)
    axis, stated = turns[number]
    turns[number] = (axis, made)
    log = recorded(turns, f"wrong {number}", as_made(SESSION))
    found = calibrate("gyro_turns", log, SETUP)
    assert found.verdict == "suspect"
    # another number of turns is told before the fit
    name = "number of turns" if abs(made - stated) > 180 else "cause"
    (statement,) = [t.statement for t in found.tests if t.name == name and not t.passed]
    words, _, rest = statement.partition(
        f" s is stated as {stated} deg about {AXES[axis]}, and was "
    )
    assert " is stated as " not in words + rest  # no other turn
    # before the fit without the scale factor, at most 3 %
    within = 0.05 * abs(made) if name != "cause" else 0.2
    assert float(rest.split(";")[0]) == pytest.approx(made, abs=within)
    start = float(words.rpartition("the turn from ")[2].split()[0])
    assert start == pytest.approx(begin_of(number), abs=0.5)
    assert np.abs(z_scores(found)).max() < 4.5 or name == "cause"


def test_the_uncertainty_of_a_label_or_the_option_is_that_of_the_angle():
    turns = list(SESSION)
    turns[3] = (1, 361)  # stated as 360
    plain = as_made(SESSION)
    assert calibrate("gyro_turns", recorded(turns, "sigma", plain), SETUP).verdict == "suspect"
    rough = [w and f"{w} +- 1 deg" for w in plain]
    by_label = calibrate("gyro_turns", recorded(turns, "sigma", rough), SETUP)
    log = recorded(turns, "sigma", plain)
    by_option = calibrate("gyro_turns", log, SETUP, angle_sigma_deg=1.0)
    assert by_label.verdict == by_option.verdict == "good"
    assert by_label.parameters == by_option.parameters


def test_labels_are_read_as_turns_or_left_as_text():
    for label, axis, angle in (
        ("turn z 360", 2, 360.0),
        ("Turn  -x 90 deg", 0, -90.0),
        ("turn +y -720.5", 1, -720.5),
        ("turn -y -45", 1, 45.0),
    ):
        found = parse_turn(label)
        assert found is not None
        assert found[0].tolist() == np.eye(3)[axis].tolist()
        assert found[1] == pytest.approx(angle * DEG)
        assert found[2] is None
    assert parse_turn("turn z 360 +- 0.02 deg")[2] == pytest.approx(0.02 * DEG)
    assert parse_turn("turn z 360 ± 0.02")[2] == pytest.approx(0.02 * DEG)
    for text in ("turn about z", "z 360", "turn z", "+z", "return z 90", ""):
        assert parse_turn(text) is None


def test_the_error_of_an_angle_by_hand_counts_whole_turns():
    """A fixed axis off those of the body, integrated 2 deg short, and once 360 deg too many."""
    axis = np.array([0.1, -0.2, 1.0])
    axis /= np.linalg.norm(axis)
    for stated, integrated in ((360.0, 358.0), (90.0, 450.0), (-720.0, -722.0), (360.0, -360.0)):
        angles = StatedAngles(
            np.array([0]), np.array([stated * DEG]), np.eye(3)[[2]], np.array([1e-3])
        )
        vector = integrated * DEG * axis
        R = Rotation.from_rotvec(-vector).as_matrix()
        error = angles.errors(R[None, None], vector[None, None])
        assert error[0, 0] / DEG == pytest.approx(stated - integrated, abs=1e-9)
