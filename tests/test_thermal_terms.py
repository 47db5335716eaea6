"""Further terms of a triad beside bias, scale and axes over temperature, and what few attitudes
leave open of them.
"""

import json
from dataclasses import replace

import numpy as np
import pytest
from builders import ACCEL, G, setup_of
from statistics_helpers import rng_of

import tiltcal as tc
from tiltcal.calibration.methods.registry import calibrate
from tiltcal.calibration.result import Calibration
from tiltcal.core.errors import TiltcalError
from tiltcal.core.units import G0
from tiltcal.recordings.recording import Recording

SENSOR = ACCEL.model_copy(update={"rate_hz": 0.5})
SETUP = setup_of("handheld", SENSOR)
STEP, DWELL, CYCLES, NOISE = 2.0, 120.0, 3, 2e-3
FACES = [s * np.eye(3)[i] for i in range(3) for s in (1.0, -1.0)]
EDGES = [
    (np.eye(3)[i] + s * np.eye(3)[j]) * r
    for i, j in ((0, 1), (1, 2), (2, 0))
    for s in (1, -1)
    for r in (1, -1)
]
CORNERS = [np.array([a, b, c]) for a in (1, -1) for b in (1, -1) for c in (1, -1)]
OBLIQUE = [np.array([2.0, 1, 0]), np.array([0, 2.0, 1]), np.array([1, 0, 2.0])]
TERMS = ["bias", "scale", "cross_axis", "K2", "K3", "Kio"]
LINEAR = TERMS[:3]
M = np.array([[1.002, 0.003, 0.0], [-0.001, 0.999, 0.002], [0.0, 0.001, 1.001]])
WARM = 1e-5 * np.array([[3, 1, 0], [0, -2, 1], [2, 0, 4]])
BIAS = np.array([0.05, -0.02, 0.01])
BIAS_WARM = np.array([1e-3, 2e-3, -1e-3])
UG = 1e-6 * G0
K2, K3 = {0: 400.0}, {1: -900.0}  # ug/g^2 and ug/g^3 of channels x and y


def cycle(attitudes, name, curved=True):
    """A log of a triad at stated attitudes while the temperature goes up and down, by its equation
    written out; and the force and the temperature of every row.
    """
    dwells = 8 * len(attitudes)
    time = np.arange(0, dwells * DWELL, STEP)
    number = (time // DWELL).astype(int) % len(attitudes)
    temperature = 20 + 40 * np.sin(2 * np.pi * CYCLES * time / time[-1])
    up = np.array([a / np.linalg.norm(a) for a in attitudes])[number]
    warm, f = temperature - temperature.mean(), G * up
    values = BIAS + warm[:, None] * BIAS_WARM + f @ M.T + warm[:, None] * (f @ WARM.T)
    if curved:
        values[:, 0] += K2[0] * UG * (f[:, 0] / G0) ** 2
        values[:, 1] += K3[1] * UG * (f[:, 1] / G0) ** 3
    values += rng_of(f"thermal terms {name}").normal(0, NOISE, f.shape)
    # a hand between the dwells
    moving = (time % DWELL) < 10
    values[moving] += rng_of(f"moves {name}").normal(0, 1.0, (int(moving.sum()), 3))
    columns = {f"accel_{a}_m_s2": values[:, i] for i, a in enumerate("xyz")}
    columns["temperature_degC"] = temperature
    labels = np.array([str(list(map(float, attitudes[k]))) for k in number], dtype=object)
    log = Recording.from_columns(time, columns, labels=labels)
    return log, f, warm, ~moving


@pytest.fixture(scope="module")
def many():
    return cycle([*FACES, *EDGES, *CORNERS, *OBLIQUE], "many")


def by_hand(log, f, warm, still):
    """Least squares of each channel over all samples at rest: the value and the standard deviation
    of its second- and third-order term, ug/g^n.
    """
    found = {}
    for i, axis in enumerate("xyz"):
        linear = np.column_stack([np.ones(len(f)), f])
        own = f[:, i, None] / G0
        A = np.column_stack([linear, warm[:, None] * linear, UG * own**2, UG * own**3])[still]
        y = log.column(f"accel_{axis}_m_s2")[still]
        x = np.linalg.lstsq(A, y, rcond=None)[0]
        sigma = NOISE * np.sqrt(np.diag(np.linalg.inv(A.T @ A)))
        found[f"K2_{axis}"], found[f"K3_{axis}"] = (x[-2], sigma[-2]), (x[-1], sigma[-1])
    return found


def test_second_and_third_order_come_back_beside_the_terms_over_temperature(many):
    found = calibrate("thermal", many[0], SETUP, terms=["bias", "scale", "cross_axis", "K2", "K3"])
    assert found.verdict == "good", [t.statement for t in found.tests if not t.passed]
    truth = {"K2_x": K2[0], "K3_y": K3[1]}
    for name, (value, sigma) in by_hand(*many).items():
        estimate = found.parameters[f"accel.{name}"]
        assert estimate.unit == {"K2": "ug_g2", "K3": "ug_g3"}[name[:2]]
        # the edges of the dwells are left out there
        assert estimate.value == pytest.approx(value, abs=2 * sigma)
        assert estimate.sigma == pytest.approx(sigma, rel=0.35)
        assert abs(estimate.value - truth.get(name, 0.0)) < 4 * estimate.sigma
    for name, true in (("scale_y", -1e-3), ("temp1_scale_x", 3e-5), ("temp1_cross_zx", 2e-5)):
        estimate = found.parameters[f"accel.{name}"]
        assert abs(estimate.value - true) < 4 * estimate.sigma
    assert "K3_i f_i^3" in found.instrument(SETUP.sensor, G).equation(SETUP.sensor[0])


def test_products_of_two_axes_belong_to_one_channel_each(many):
    plain = calibrate("thermal", many[0], SETUP, terms=TERMS)
    assert plain.verdict == "good"
    products = [n for n in plain.parameters if n.startswith("accel.Kio")]
    assert len(products) == 3
    for name in products:
        assert abs(plain.value(name)) < 4 * plain.parameters[name].sigma


def test_without_them_the_fit_fails_and_the_linear_terms_are_the_default(many):
    found = calibrate("thermal", many[0], SETUP)
    assert found.verdict == "suspect"
    assert not any("K3" in n for n in found.parameters)
    named = calibrate("thermal", many[0], SETUP, terms=["bias", "scale", "cross_axis"])
    assert named.parameters == found.parameters


@pytest.fixture(scope="module")
def faces():
    """A calibration by faces alone: K3 is the scale factor there."""
    return calibrate(
        "thermal", cycle(FACES, "faces", curved=False)[0], SETUP, terms=[*LINEAR, "K3"]
    )


HIDDEN = [f"accel.{t}_{a}" for a in "xyz" for t in ("scale", "K3")]


def test_what_the_attitudes_do_not_determine_is_left_out_and_named(faces):
    assert faces.verdict == "cannot_tell"
    assert not set(HIDDEN) & set(faces.parameters)
    (test,) = [t for t in faces.tests if t.name == "determined"]
    assert all(n in test.statement for n in HIDDEN)
    for name, true in (("bias_x", 0.05), ("cross_xy", 3e-3), ("temp1_scale_x", 3e-5)):
        estimate = faces.parameters[f"accel.{name}"]
        assert abs(estimate.value - true) < 4 * estimate.sigma


def tumble(terms) -> Calibration:
    """Poses of many attitudes at one temperature."""
    log = cycle([*FACES, *EDGES, *CORNERS, *OBLIQUE], "room", curved=False)[0]
    cold = {n: log.column(n) for n in log.column_names if n != "label"}
    warm = log.column("temperature_degC") - log.column("temperature_degC").mean()
    up = np.array([json.loads(w) for w in log.labels])
    up /= np.linalg.norm(up, axis=1)[:, None]
    less = warm[:, None] * (BIAS_WARM + G * up @ WARM.T)
    for i, a in enumerate("xyz"):
        cold[f"accel_{a}_m_s2"] = cold[f"accel_{a}_m_s2"] - less[:, i]
    cold["temperature_degC"] = np.full(len(log), 20.0)
    return calibrate(
        "six_position",
        Recording.from_columns(log.time, cold, labels=log.labels),
        SETUP,
        terms=terms,
    )


def test_another_calibration_completes_it(faces):
    room = tumble([*LINEAR, "K3"])
    joint = tc.combine(room, faces)
    assert joint.agrees
    assert joint.calibration.verdict == room.verdict == "good"
    assert set(HIDDEN) <= set(joint.calibration.parameters)
    assert all(t.passed for t in joint.calibration.tests)


def test_what_no_other_calibration_has_stays_undetermined(faces):
    room = tumble(LINEAR)
    assert tc.combine(room, faces).calibration.verdict == "cannot_tell"
    # nor does another one help where this one has no residual to judge it by
    bare = replace(faces, dof=0)
    assert tc.combine(tumble([*LINEAR, "K3"]), bare).calibration.verdict == "cannot_tell"


def test_terms_without_attitudes_and_unknown_ones_are_refused():
    log = cycle(FACES, "refused")[0]
    with pytest.raises(TiltcalError, match=r"calibration term 'K33'.*did you mean 'K3'"):
        calibrate("thermal", log, SETUP, terms=["K33"])
    columns = {n: log.column(n) for n in log.column_names if n != "label"}
    with pytest.raises(TiltcalError, match="need several known attitudes"):
        calibrate("thermal", Recording.from_columns(log.time, columns), SETUP, terms=["K3"])
    with pytest.raises(TiltcalError, match="method thermal, option terms"):
        calibrate("thermal", log, SETUP, terms="K3")
