"""Small turns by first-order response agree with the whole closed form, place by place."""

import numpy as np
import pytest
from builders import ACCEL, GYRO, effect_of, setup_of, tossed

from tiltcal.forward.kinematics import force_and_rate
from tiltcal.forward.nominal_motion import Responses, moves_smoothly

SMALL = 1e-5
CASES = {
    "table_levelling": {"tilt_east_arcsec": 2.0, "tilt_north_arcsec": -1.0},
    "axis_nonorthogonality": {"outer_inner_arcsec": 2.0},
    "mount_misalignment": {"tilt_x_arcsec": 1.0, "tilt_z_arcsec": -2.0},
    "table_encoder_eccentricity": {"cos_arcsec": 2.0, "sin_arcsec": 1.0},
    "servo_lag": {"tau_ms": 1e-3},
}


@pytest.mark.parametrize("lever", [(0.0, 0.0, 0.0), (0.05, -0.02, 0.1)])
@pytest.mark.parametrize("id", CASES)
def test_a_small_effect_changes_force_and_rate_as_the_whole_chain_says(id, lever, rng):
    setup = setup_of("dual", ACCEL, GYRO, heading=20.0, lever_arm_m=lever)
    drive = tossed(setup, rng, 50, moving=True)
    effect = effect_of(id, setup, **CASES[id])
    assert moves_smoothly(effect)
    responses = Responses(setup, drive)
    told = responses.to(responses.turns(effect))
    with_it, without = force_and_rate(setup, drive, [effect]), force_and_rate(setup, drive)
    for change, a, b in zip(told, with_it, without, strict=True):
        assert np.abs(change).max() > 0
        # the turns are 1e-5 rad: second order
        np.testing.assert_allclose(change, a - b, atol=2e-4 * np.abs(a - b).max())


def test_no_turn_changes_nothing(rng):
    setup = setup_of("vertical", ACCEL)
    force, rate = Responses(setup, tossed(setup, rng, 7, moving=True)).to({})
    assert force.shape == rate.shape == (7, 3)
    assert not force.any()
    assert not rate.any()
