"""Ringing after a move: it may have begun before the readout is at rest, and a diagnosis finds it
whenever it began.
"""

import numpy as np
import pytest
from diagnosis_fixtures import bench, honest, recorded

from tiltcal.core.units import ARCSEC
from tiltcal.diagnosis.diagnose import diagnose
from tiltcal.effects import CATALOGUE
from tiltcal.effects.mechanisms import Context
from tiltcal.laboratory.scenario import parse_scenario

FREQUENCY, TAU = 1.7, 0.8


def rung(early: float, amplitude: float) -> dict:
    return {
        "id": "settling_transient",
        "axis": "outer",
        "amplitude_arcsec": amplitude,
        "frequency_hz": FREQUENCY,
        "tau_s": TAU,
        "early_s": early,
    }


def one_turn(*effects: dict):
    """A rest, a turn by 20 deg at 5 deg/s and a dwell of 3 s."""
    turn = {"action": "turn", "axis": "outer", "angle_deg": 20, "rate_deg_s": 5, "dwell_s": 3}
    return parse_scenario(
        {
            "schema": 1,
            "site": {"gravity_m_s2": 9.81},
            "rig": {"table": "placing"},
            "sensor": [{"name": "accel", "kind": "accelerometer"}],
            "sequence": [{"action": "rest", "dwell_s": 0.5}, turn],
            "effect": list(effects),
        }
    )


@pytest.mark.parametrize("early", [0.0, 0.1, -0.2])
@pytest.mark.parametrize("id", ["settling_transient", "mount_resonance"])
def test_it_is_a_decaying_cosine_from_its_beginning(id, early):
    """By hand, from the end of the move on, with its first two time derivatives."""
    scenario = one_turn()
    end = scenario.schedule.times[1] - 3.0
    since = np.linspace(0.01, 2.9, 100)
    drive = scenario.schedule.drive(np.concatenate([[0.1, end / 2], end + since]))
    values = {"frequency": FREQUENCY, "tau": TAU, "early": early}
    if id == "settling_transient":
        effect = CATALOGUE[id]({"amplitude": 20 * ARCSEC, **values}, axis="outer")
        jet = effect.deviation(drive, "outer", None)
    else:
        effect = CATALOGUE[id]({"ring_x": 20 * ARCSEC, **values})
        (jet, *_) = (
            turn.angle
            for turn in effect.turns("mount", Context(drive, drive.axes, scenario.rig, 9.81, {}))
        )
    rate = -1 / TAU + 2j * np.pi * FREQUENCY
    for power, found in enumerate((jet.x, jet.v, jet.a)):
        expected = 20 * ARCSEC * (rate**power * np.exp(rate * (since + early))).real
        np.testing.assert_allclose(found[2:], expected, atol=1e-9 * np.abs(expected).max())
        assert not found[:2].any()
    assert bool(effect.dynamics(scenario.rig, 9.81)) == (early == 0)


@pytest.mark.parametrize(
    ("early", "amplitude"), [(0.0, -60.0), pytest.param(-0.06, 60.0, marks=pytest.mark.long)]
)
def test_it_is_named_whenever_it_began(early, amplitude):
    """At 25 Hz, where the readout tells the end of a move two samples late."""
    known = bench(rung(early, amplitude)).model_dump(exclude_defaults=True, by_alias=True)
    known["sensor"][0]["rate_hz"] = 25.0
    truth = parse_scenario({"schema": 1, **known})
    (finding,) = diagnose(honest(truth), [recorded(truth, 3)]).findings
    assert finding.effect == "settling_transient"
    value, sigma = finding.parameters["amplitude_arcsec"]
    assert abs(value - amplitude) < 4 * sigma
