"""By hand no table tells the angle: an error of a rate sensor that follows what it turned about its
own axis.
"""

import numpy as np
import pytest
from diagnosis_fixtures import bench, rewritten
from test_hand_motion import FOG, scenario, turned

from tiltcal.core.errors import TiltcalError
from tiltcal.diagnosis.diagnose import diagnose
from tiltcal.effects.curve_coordinates import turned_by


def test_an_angle_is_the_sum_of_trapezoids():
    """From 1 to 3 rad/s in 2 s, then 3 rad/s for 1 s: 4 and 3 rad."""
    time, rate = np.array([0.0, 2.0, 3.0]), np.array([1.0, 3.0, 3.0])
    assert turned_by(rate, time) == pytest.approx([0.0, 4.0, 7.0])
    both = turned_by(np.column_stack([rate, -rate]), time)
    assert both == pytest.approx(np.array([[0, 0], [4, -4], [7, -7]]))


def test_a_twisted_fibre_is_a_curve_over_the_angle():
    """An offset that is a sine of the angle, as large as the noise of a sample."""
    recording, _, fog = turned(4, seconds=150.0)
    angle = turned_by(fog, recording.time)
    twisted = recording.column("fog_a_rad_s") + FOG * np.sin(angle / 0.4)
    found = diagnose(scenario(), [rewritten(recording, fog_a_rad_s=twisted)])
    assert found.verdict == "unlisted"
    (finding,) = found.findings
    assert finding.sensors == ("fog",)
    assert "the angle that it turned about its axis" in finding.statement
    assert found.after.chi2_per_dof < 1.1


@pytest.mark.parametrize(
    ("coordinate", "need"),
    [("turned", "a gyro or a FOG"), ("transverse", "a FOG"), ("coning", "a FOG")],
)
def test_only_a_rate_sensor_follows_how_it_turned(coordinate, need):
    curve = {"id": "learned", "on": "reading", "sensor": "accel", "axis": "x"}
    over = {"coordinate": coordinate, "knots": [0.0, 1.0], "coefficients": [0.0, 1e-3]}
    with pytest.raises(TiltcalError, match=need):
        bench(curve | over)


def test_a_recording_by_hand_without_it_has_none():
    recording, *_ = turned(4, seconds=150.0)
    assert diagnose(scenario(), [recording]).verdict == "match"
