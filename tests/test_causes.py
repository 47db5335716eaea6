"""The causes that all methods try where their model does not fit, on readings that the test makes
itself: closed form, numpy only.
"""

import re

import numpy as np
import pytest
from statistics_helpers import rng_of

from tiltcal.calibration.methods.registry import calibrate
from tiltcal.calibration.screen.causes import cause_test
from tiltcal.calibration.screen.explanations import Explanation
from tiltcal.recordings.recording import Recording
from tiltcal.setup.setup import Setup
from tiltcal.setup.sources import SourceTable

G = 9.80123
SIGMA = 3e-3  # m/s2 of a sample
RATE = 25.0
DEG = np.pi / 180


def setup_of(table, *sensors, **site):
    return Setup.model_validate(
        {"site": {"gravity_m_s2": G, **site}, "rig": {"table": table}, "sensor": list(sensors)}
    )


ACCEL = {"name": "accel", "kind": "accelerometer", "rate_hz": RATE}
GYRO = {"name": "gyro", "kind": "gyro", "rate_hz": 50.0}


def dwells(rng, up, seconds=6.0, move=2.0):
    """Force along the way from pose to pose, (n, 3), and the dwell of each row, -1 while moving."""
    force, number = [], []
    for k, direction in enumerate(up):
        n, m = round(seconds * RATE), round(move * RATE)
        force.append(np.tile(direction, (n, 1)))
        number += [k] * n
        if k + 1 < len(up):
            s = ((np.arange(m) + 0.5) / m)[:, None]
            way = (1 - s) * direction + s * up[k + 1] + 1e-3 * rng.normal(size=3)
            force.append(way / np.linalg.norm(way, axis=1)[:, None])
            number += [-1] * m
    return G * np.vstack(force), np.array(number)


def by_norm(rng, fault, **stated):
    up = rng.normal(size=(20, 3))
    up /= np.linalg.norm(up, axis=1)[:, None]
    up[:6] = np.vstack([np.eye(3), -np.eye(3)])
    force, dwell = dwells(rng, up)
    M = np.eye(3) + np.diag(rng.uniform(-0.02, 0.02, 3))
    read = rng.uniform(-0.3, 0.3, 3) + force @ M.T
    time = np.arange(len(read)) / RATE
    from_tenth = np.argmax(dwell == 10)
    if fault == "step":
        read[from_tenth:, 1] += 30 * SIGMA
    elif fault == "drift":
        read[:, 1] += 60 * SIGMA * time / time[-1]
    elif fault == "K2":
        read[:, 1] += 60 * SIGMA * (force[:, 1] / G) ** 2
    elif fault == "part":
        read[dwell == 10] += 60 * SIGMA * up[10]
    elif fault == "limiter":
        read[:, 1] = np.minimum(read[:, 1], 9.0)
    elif fault == "scale":
        read[from_tenth:, 1] *= 1.01
    read += rng.normal(0, SIGMA, read.shape)
    columns = {f"accel_{a}_m_s2": read[:, i] for i, a in enumerate("xyz")}
    recording = Recording.from_columns(time, columns, source="norm.csv")
    setup = setup_of("handheld", ACCEL)
    return calibrate("norm", recording, setup.model_copy(update=stated))


def by_rates(rng, fault):
    """Steady rates about Up on a vertical table, the body on each of three sides."""
    speeds = np.array([0, 30, -30, 90, -90, 150, -150, 0]) * DEG
    knots = np.cumsum(np.tile([8.0, 2.0], len(speeds)))  # ends of the steady stretches and ramps
    time = np.arange(round(knots[-1] * 50)) / 50.0
    fine = np.arange(round(knots[-1] * 5000) + 1) / 5000
    at = np.concatenate([[0.0], knots])
    values = np.append(np.repeat(speeds, 2), 0.0)
    rate = np.interp(time, at, values)
    number = np.searchsorted(knots[1::2], time, side="right")
    course = np.interp(fine, at, values)
    angle = np.concatenate([[0.0], np.cumsum((course[1:] + course[:-1]) / 2) / 5000])[::100]
    angle = angle[: len(time)]
    read = 1e-3 + 1.01 * rate
    if fault == "step":
        read[number > 3] += 1e-3
    elif fault == "scale_asym":
        read += 2e-3 * np.abs(rate)
    elif fault == "limiter":
        read = np.clip(read, -130 * DEG, 130 * DEG)
    elif fault == "delay":
        read = np.interp(time - 0.3, time, read)
    noise = rng.normal(0, 3e-4, (len(read), 1))
    columns = {"gyro_z_rad_s": read + noise[:, 0], "table_outer_deg": angle / DEG}
    recording = Recording.from_columns(time, columns, source="rates.csv")
    setup = setup_of("vertical", {**GYRO, "axes": ["z"]})
    return calibrate("gyro_rates", recording, setup, terms=["bias", "scale"])


def by_temperature(rng, fault):
    names = ["+x", "+y", "+z", "-x", "-y", "-z"]
    faces = np.vstack([np.eye(3), -np.eye(3)])
    force, dwell = dwells(rng, np.tile(faces, (8, 1)), seconds=20.0)
    time = np.arange(len(force)) / RATE
    warm = 20 + 25 * np.sin(2 * np.pi * time / time[-1])
    read = 0.02 + force * 1.005 + 2e-3 * (warm - 20)[:, None]
    labels = np.array([names[k % 6] if k >= 0 else None for k in dwell], dtype=object)
    if fault == "step":
        read[np.argmax(dwell == 25) :, 1] += 30 * SIGMA
    elif fault == "label":
        labels[dwell == 25] = "+z"
    read += rng.normal(0, SIGMA, read.shape)
    columns = {f"accel_{a}_m_s2": read[:, i] for i, a in enumerate("xyz")}
    columns["temperature_degC"] = warm + rng.normal(0, 0.01, len(warm))
    recording = Recording.from_columns(time, columns, labels=labels, source="warm.csv")
    return calibrate("thermal", recording, setup_of("handheld", ACCEL))


MAKERS = {"norm": by_norm, "rates": by_rates, "temperature": by_temperature}
SAID = [
    ("norm", "step", r"the bias of accel_y changes by a step"),
    ("norm", "drift", r"the bias drifts over the recording"),
    ("norm", "K2", r"the term K2"),
    ("norm", "part", r"the dwell from .* does not fit the others"),
    ("norm", "limiter", r"accel_y is limited at (9|9\.000\d|8\.999\d) "),
    ("norm", "scale", r"the scale factor of accel_y changes by a step"),
    ("rates", "step", r"the bias of gyro_z changes by a step"),
    ("rates", "scale_asym", r"the term scale_asym"),
    ("rates", "limiter", r"gyro_z is limited at 2\.26\d* and -2\.26\d* "),
    ("rates", "delay", r"the readings lag or lead the readout"),
    ("temperature", "step", r"the bias of accel_y changes by a step"),
    ("temperature", "label", r"the stretch from .* is off by a constant: another bias, attitude"),
]


@pytest.mark.parametrize("name", MAKERS)
def test_where_nothing_is_wrong_no_cause_is_looked_for(name):
    found = MAKERS[name](rng_of(f"no cause {name}"), "nothing")
    assert found.verdict == "good", [t.statement for t in found.tests if not t.passed]
    assert not [t for t in found.tests if t.name.startswith("cause")]


@pytest.mark.parametrize(("name", "fault", "words"), SAID)
def test_the_cause_of_a_misfit_is_named(name, fault, words):
    found = MAKERS[name](rng_of(f"cause {name} {fault}"), fault)
    assert found.verdict == "suspect"
    (test,) = [t for t in found.tests if t.name.startswith("cause")]
    assert re.search(words, test.statement), test.statement


@pytest.mark.parametrize(
    ("fault", "words"), [(fault, words) for name, fault, words in SAID if name == "norm"]
)
def test_the_cause_is_named_beside_uncertain_references(fault, words):
    """A reference common to all poses mixes their residuals; one of them can still be left out. The
    readings are those of the test without one.
    """
    gravity = SourceTable.model_validate({"id": "gravity", "gravity_ppm": 20})
    found = by_norm(rng_of(f"cause norm {fault}"), fault, budget=(gravity,))
    (test,) = [t for t in found.tests if t.name == "cause"]
    assert re.search(words, test.statement), test.statement


def test_what_no_single_cause_explains_is_handed_to_diagnose():
    rng = rng_of("two causes")
    up = rng.normal(size=(24, 3))
    up /= np.linalg.norm(up, axis=1)[:, None]
    force, _ = dwells(rng, up)
    wave = 40 * SIGMA * np.sin(9 * force / G) * np.cos(7 * np.roll(force, 1, axis=1) / G)
    read = force + wave + rng.normal(0, SIGMA, force.shape)
    columns = {f"accel_{a}_m_s2": read[:, i] for i, a in enumerate("xyz")}
    recording = Recording.from_columns(np.arange(len(read)) / RATE, columns, source="wave.csv")
    found = calibrate("norm", recording, setup_of("handheld", ACCEL))
    (test,) = [t for t in found.tests if t.name == "cause"]
    assert "no single cause" in test.statement
    assert "tiltcal diagnose wave.csv --scenario" in test.statement


def test_the_cause_that_takes_most_is_named_where_none_takes_all():
    """By hand: of chi-square 1e6 one cause leaves 6e3 of 10 degrees of freedom, the others all."""
    tried = [
        Explanation("the dwell at 7 s", 6e3, 10, 6.1e3),
        Explanation("the term K2", 9.9e5, 10, 9.9e5),
        Explanation("a drift", 1e6, 10, 1e6),
    ]
    statement = cause_test(tried, "recording r.csv").statement
    assert "explains all of it, most is the dwell at 7 s (chi2/dof 600 is left)" in statement
    assert "explains it; run" in cause_test(tried[1:], "recording r.csv").statement
