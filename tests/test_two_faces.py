"""The two faces of what moves: algebra for the estimator, MuJoCo's mechanics for the laboratory;
and the norm law.
"""

from zlib import crc32

import numpy as np
import pytest
from builders import ACCEL, AXLED, GYRO, drive_of, read_poses, setup_of
from catalogue_cases import plausible

from tiltcal.core.frames import parse_mount
from tiltcal.effects import CATALOGUE
from tiltcal.effects.base import AngleEffect, DelayEffect, FrameEffect, SignalEffect, WritingEffect
from tiltcal.effects.mechanisms import Spring
from tiltcal.forward.kinematics import closed_form
from tiltcal.setup.trajectory import Jet
from tiltsim.motion import mujoco_motion

MOVERS = tuple(
    id
    for id, cls in CATALOGUE.items()
    if not issubclass(cls, SignalEffect | DelayEffect | WritingEffect)
)
TURNING = tuple(id for id, cls in CATALOGUE.items() if issubclass(cls, AngleEffect | FrameEffect))
MOUNT = parse_mount("Rx(20) Rz(50)")
N = 60


def setup_on(table, lever=(0.05, -0.03, 0.08)):
    return setup_of(table, ACCEL, GYRO, lever_arm_m=lever)


def springs_of(id, setup):
    """The springs that are its face in MuJoCo on this set-up."""
    effect = plausible(id, setup)
    mechanised = getattr(effect, "mechanised", False)
    return (
        [m for m in effect.mechanisms(setup.rig, setup.site.gravity) if isinstance(m, Spring)]
        if mechanised
        else []
    )


SPRUNG = tuple(id for id in MOVERS if any(springs_of(id, setup_on(table)) for table in AXLED))
EXACT = tuple(id for id in MOVERS if id not in SPRUNG)


def poses(setup, rng):
    """Random poses at rest, in slowly changing warmth, on a skew mounting."""
    zero = np.zeros(N)
    axes = {name: Jet(rng.uniform(-np.pi, np.pi, N), zero, zero) for name in setup.rig.axis_names}
    time = np.arange(N, dtype=float)
    return drive_of(
        axes, time, temperature=23 + 3 * np.sin(time / 9), rest=True, mounts=((0, MOUNT),)
    )


def streams(effect):
    """The same random numbers whenever an effect asks."""
    return np.random.default_rng(crc32(effect.address.encode()))


def both(setup, drive, *effects):
    """Closed form and MuJoCo with the same random numbers."""
    return closed_form(setup, drive, effects, streams), mujoco_motion(
        setup, drive, effects, streams
    )


def axes_of(id, setup):
    return (None, *setup.rig.axis_names) if CATALOGUE[id].axis_wise else (None,)


@pytest.mark.parametrize("table", AXLED)
@pytest.mark.parametrize("id", EXACT)
def test_a_prescribed_effect_has_one_face(id, table, rng):
    setup = setup_on(table)
    drive = poses(setup, rng)
    for axis in axes_of(id, setup):
        algebra, mechanics = both(setup, drive, plausible(id, setup, axis=axis, part=2))
        for one, other in (
            (algebra.force, mechanics.force),
            (algebra.rate, mechanics.rate),
            (algebra.up, mechanics.up),
        ):
            np.testing.assert_allclose(other, one, rtol=0, atol=1e-12)


@pytest.mark.parametrize("table", AXLED)
def test_all_prescribed_effects_together_have_one_face(table, rng):
    setup = setup_on(table)
    drive = poses(setup, rng)
    effects = [plausible(id, setup) for id in EXACT]
    algebra, mechanics = both(setup, drive, *effects)
    np.testing.assert_allclose(mechanics.force, algebra.force, rtol=0, atol=1e-12)
    np.testing.assert_allclose(mechanics.rate, algebra.rate, rtol=0, atol=1e-12)


@pytest.mark.parametrize("sign", [1, -1])
@pytest.mark.parametrize("table", AXLED)
@pytest.mark.parametrize("id", SPRUNG)
def test_a_spring_bends_as_the_algebra_says_to_second_order(id, table, sign, rng):
    """The force without a lever arm: a random walk through poses has no meaningful rate."""
    setup = setup_on(table, lever=(0, 0, 0))
    drive = poses(setup, rng)
    plain = closed_form(setup, drive).force
    errors, size = [], 0.0
    for scale in (1.0, 0.5):
        algebra, mechanics = both(setup, drive, plausible(id, setup, size=sign * 3 * scale))
        errors.append(np.abs(algebra.force - mechanics.force).max())
        size = max(size, np.abs(algebra.force - plain).max())
    if not springs_of(id, setup):  # gravity does not load a vertical axis
        assert (size, errors) == (0.0, pytest.approx([0.0, 0.0], abs=1e-13))
        return
    assert size > 1e-4
    assert errors[0] < 1e-3 * size
    assert 3 < errors[0] / errors[1] < 5


@pytest.mark.parametrize("table", AXLED)
def test_two_springs_bend_together(table, rng):
    setup = setup_on(table, lever=(0, 0, 0))
    drive = poses(setup, rng)
    algebra, mechanics = both(setup, drive, *(plausible(id, setup) for id in SPRUNG))
    np.testing.assert_allclose(
        mechanics.force,
        algebra.force,
        rtol=0,
        atol=1e-2 * np.abs(algebra.force - closed_form(setup, drive).force).max(),
    )


# --------------------------------------------------------------------------------------------------
# the norm


def norm_change(setup, drive, effect):
    """Largest change of |f| and of f."""
    plain, changed = (
        read_poses(setup, drive, seed=1)["accel"],
        read_poses(setup, drive, effect, seed=1)["accel"],
    )
    return np.abs(np.linalg.norm(changed, axis=1) - np.linalg.norm(plain, axis=1)).max(), np.abs(
        changed - plain
    ).max()


@pytest.mark.parametrize("table", AXLED)
@pytest.mark.parametrize("id", TURNING)
def test_what_turns_the_table_or_the_mount_leaves_the_norm(id, table, rng):
    setup = setup_on(table, lever=(0, 0, 0))
    for mover in (closed_form, mujoco_motion):
        effect = plausible(id, setup)
        force = mover(setup, poses(setup, rng), [effect], streams).force
        np.testing.assert_allclose(np.linalg.norm(force, axis=1), setup.site.gravity, rtol=1e-14)


@pytest.mark.parametrize(
    "id", ["acc_K2", "acc_K3", "acc_Kip", "acc_scale_asym", "acc_bias", "acc_scale"]
)
def test_what_the_sensor_does_changes_the_norm(id, rng):
    setup = setup_on("three")
    norm, change = norm_change(setup, poses(setup, rng), plausible(id, setup, setup.named("accel")))
    assert norm > 0.1 * change


def test_gravity_is_the_one_environment_that_scales_the_norm(rng):
    setup = setup_on("three")
    norm, _ = norm_change(setup, poses(setup, rng), plausible("gravity_magnitude", setup))
    assert norm == pytest.approx(100e-6 * setup.site.gravity)
