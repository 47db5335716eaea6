"""Coning: an error of a rate sensor that follows rate times angular acceleration along its axis."""

from dataclasses import replace

import numpy as np
import pytest
from diagnosis_fixtures import rewritten
from test_hand_motion import AXIS, FOG, scenario, turned

from tiltcal.diagnosis.diagnose import diagnose
from tiltcal.effects.curve_coordinates import coordinate_of
from tiltcal.effects.sense import Sense


def test_an_axis_of_turn_that_goes_round_a_cone_has_a_steady_one():
    """w = (0.6 cos 5t, 0.6 sin 5t, 0.2) rad/s: w x dw/dt = (-0.6 cos 5t, -0.6 sin 5t, 1.8)."""
    time = np.linspace(0.0, 2.0, 9)
    c, s, one = np.cos(5 * time), np.sin(5 * time), np.ones_like(time)
    still = Sense.at_rest(scenario().named("fog"), 9.81, np.zeros((9, 3)))
    sense = replace(
        still,
        input_vector=AXIS,
        rate=np.column_stack([0.6 * c, 0.6 * s, 0.2 * one]),
        angular_acceleration=np.column_stack([-3 * s, 3 * c, 0 * one]),
    )
    coning = np.column_stack([-0.6 * c, -0.6 * s, 1.8 * one])
    assert sense.coning == pytest.approx(coning)
    assert coordinate_of("coning", sense, 0 * time) == pytest.approx(coning @ AXIS)
    assert coordinate_of("coning_z", sense, 0 * time) == pytest.approx(coning[:, 2])


def test_by_hand_it_is_found():
    """A case that twists in proportion to the angular acceleration turns the FOG's axis."""
    recording, gyro, _ = turned(4, seconds=150.0)
    coning = np.cross(gyro, np.gradient(gyro, recording.time, axis=0)) @ AXIS
    twisted = recording.column("fog_a_rad_s") + FOG * coning / np.std(coning)
    found = diagnose(scenario(), [rewritten(recording, fog_a_rad_s=twisted)])
    assert found.verdict == "unlisted"
    (finding,) = found.findings
    assert finding.sensors == ("fog",)
    assert "coning" in finding.statement
    assert found.after.chi2_per_dof < 1.1
