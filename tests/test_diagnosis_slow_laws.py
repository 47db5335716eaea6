"""Slow noise that may be a listed law: it is named with its probability, and no match where it is
the more probable.
"""

import pytest
from diagnosis_fixtures import bench, honest, recorded

from tiltcal.diagnosis.diagnose import diagnose
from tiltcal.statistics.noise_spectrum import NoiseFit, white_noise

WARMUP = {"id": "acc_warmup", "sensor": "accel", "tau_s": 120.0}


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


def test_white_noise_hides_nothing():
    assert NoiseFit.known(white_noise(1.0)).slow_gain == 0.0
    found = diagnosed()
    assert found.verdict == "match"
    assert all(channel.may_be == {} for channel in found.noise.channels.values())
