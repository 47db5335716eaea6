"""Slow noise that may be a listed law: it is named with its probability, and no match where it is
the more probable.
"""

import numpy as np
import pytest
from diagnosis_fixtures import bench, honest, recorded

from tiltcal.diagnosis.diagnose import diagnose
from tiltcal.diagnosis.hypotheses.hypothesis import Hypothesis
from tiltcal.diagnosis.search.slow_laws import SlowLaw, probabilities
from tiltcal.effects import CATALOGUE
from tiltcal.effects.learned import LearnedReading
from tiltcal.laboratory.scenario import parse_scenario
from tiltcal.statistics.noise_spectrum import NoiseFit, white_noise

WARMUP = {"id": "acc_warmup", "sensor": "accel", "tau_s": 120.0}


def resting():
    """The same bench, which only stands."""
    table = bench().model_dump(exclude_defaults=True, by_alias=True)
    return parse_scenario(
        {"schema": 1, **table, "sequence": [{"action": "rest", "dwell_s": 200.0}]}
    )


def diagnosed(*left_out, seed=1):
    truth = bench(*left_out)
    return diagnose(honest(truth), [recorded(truth, seed)])


@pytest.mark.parametrize(
    ("size", "verdict", "least", "most"),
    [(120.0, "match", 0.05, 0.5), (200.0, "cannot_tell", 0.5, 0.99)],
)
def test_a_warmup_that_noise_explains_as_well_stands_beside_it(size, verdict, least, most):
    found = diagnosed(WARMUP | {"warmup_x_ug": size})
    (law,) = found.noise.channels["accel_x"].to_json()["may_be"]
    assert law["effect"] == "acc_warmup"
    assert least < law["probability"] < most
    assert found.verdict == verdict
    assert f"(acc_warmup, probability {law['probability']:.2f})" in found.statement
    assert "at rest for as long" in found.statement
    assert not found.noise.channels["accel_y"].may_be


def test_a_random_walk_is_more_probably_noise():
    """A law takes up part of most walks; it is the more probable one in few."""
    walk = {"id": "acc_noise", "sensor": "accel", "walk_ug_rts": 12.0}
    found = [diagnosed(walk, seed=seed) for seed in range(1, 7)]
    assert [f.verdict for f in found].count("match") >= 5
    for one in found:
        for channel in one.noise.channels.values():
            assert sum(channel.may_be.values()) < 0.5 or one.verdict != "match"


def test_a_channel_s_laws_are_held_against_its_own_noise():
    """By hand: at costs of -2 and 1 beside that of the noise the odds are e^2 : e^-1 : 1. A law of
    another channel takes nothing from them, and one effect on two sensors counts once.
    """

    def law(id, sensor, channels, more):
        return SlowLaw(Hypothesis(CATALOGUE[id]({}, sensor, None, "found"), ()), channels, more)

    found = [
        law("acc_warmup", "accel", (0,), -2.0),
        law("floor_tilt_drift", None, (0, 1), 1.0),
        law("acc_warmup", "incl", (1,), 1.0),
        law("acc_warmup", "incl", (0,), 2.0),
    ]
    total = np.exp(2) + np.exp(-1) + 1
    assert list(probabilities(found, 0)) == ["acc_warmup", "floor_tilt_drift"]
    assert probabilities(found, 0)["acc_warmup"] == pytest.approx(np.exp(2) / total)
    assert sum(probabilities(found, 1).values()) == pytest.approx(2 / (2 + np.e))
    assert probabilities(found, 2) == {}


def test_a_law_that_is_a_curve_of_any_form_stands_under_its_name():
    curve = LearnedReading({"c0": 1e-5}, "accel", "x", coordinate="time", knots=(0.0, 1.0))
    law = Hypothesis(curve, ("c0",), alias="acc_drift")
    assert probabilities([SlowLaw(law, (0,), 0.0)], 0) == {"acc_drift": 0.5}


def test_noise_of_a_record_at_rest_hides_nothing():
    truth = bench(WARMUP | {"warmup_x_ug": 120.0})
    found = diagnose(honest(truth), [recorded(truth, 1)], static=recorded(resting(), 3))
    assert all(channel.may_be == {} for channel in found.noise.channels.values())


def test_white_noise_hides_nothing():
    assert NoiseFit.known(white_noise(1.0)).slow_gain == 0.0
    found = diagnosed()
    assert found.verdict == "match"
    assert all(channel.may_be == {} for channel in found.noise.channels.values())
