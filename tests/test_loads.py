"""Moments that the links of a model carry as it moves: what is made of accelerations that are only
roughly known.
"""

import numpy as np
import pytest
from model_rig import GRAVITY
from statistics_helpers import rng_of

from tiltcal.core.units import ARCSEC
from tiltcal.recordings.differentiation import differentiate
from tiltcal.recordings.table_standstills import standstills
from tiltcal.setup.chain import BASE, Chain, Link
from tiltcal.setup.loads import Loads, Mass, moments
from tiltcal.setup.trajectory import Jet, sampled_jet

HALF = float(np.sqrt(0.5))
ARM = Chain(
    link=(
        Link(axis="pan", mass_kg=3.0, centre_m=(0.1, 0.0, 0.2), inertia_kg_m2=(1, 1, 1, 0, 0, 0)),
        Link(
            axis="lift",
            on="pan",
            offset_m=(0.0, 0.1, 0.5),
            rotation=(HALF, HALF, 0.0, 0.0),
            mass_kg=5.0,
            centre_m=(0.4, 0.0, 0.1),
            inertia_kg_m2=(0.2, 0.3, 0.3, 0.01, 0.02, 0.0),
        ),
    )
)
REACH = {"pan": 1.2, "lift": -0.8}


def swing(time):
    """Both axes rest for a second, move for two, rest, and come back."""
    found = {}
    for name, reach in REACH.items():
        x, v, a = np.zeros((3, len(time)))
        for start, way in ((1.0, reach), (4.0, -reach)):
            s = np.clip((time - start) / 2, 0, 1)
            x += way * s**3 * (10 - 15 * s + 6 * s**2)
            v += way * (30 * s**2 - 60 * s**3 + 30 * s**4) / 2
            a += way * (60 * s - 180 * s**2 + 120 * s**3) / 4
        found[name] = Jet(x, v, a)
    return found


def read(time, noise):
    """The swing as a readout with white noise, rad, tells it."""
    rng = rng_of(f"swing {len(time)} {noise}")
    axes = {}
    for name, jet in swing(time).items():
        x = jet.x + noise * rng.standard_normal(len(time))
        axes[name] = Jet(x, *differentiate(time, x, *standstills(time, x[:, None]))[:2])
    return axes


def by_inertia(axes):
    """Moment of inertia on the base, N m, (n, 3)."""
    still = {a: Jet(j.x) for a, j in axes.items()}
    return moments(ARM, axes, GRAVITY)[BASE] - moments(ARM, still, GRAVITY)[BASE]


@pytest.mark.parametrize(
    ("rate", "noise", "within"),
    [(50, 0.05, 0.1), (200, 0.05, 0.3), (200, 2.0, 0.7), (1000, 1.0, 0.8)],
)
def test_the_acceleration_of_a_load_is_not_made_of_noise(rate, noise, within):
    """Against that of the true motion, without the instants at which its jerk jumps."""
    time = np.arange(0, 8, 1 / rate)
    smooth = np.all([np.abs(time - k) > 0.06 for k in (1, 3, 4, 6)], axis=0)
    true, axes = by_inertia(swing(time)), read(time, noise * ARCSEC)
    raw = by_inertia(axes)
    loads = Loads(ARM, time, axes, GRAVITY).along(BASE)
    weight = Loads(ARM, time, {a: Jet(j.x) for a, j in axes.items()}, GRAVITY).along(BASE)
    found = np.column_stack([one.a - other.a for one, other in zip(loads, weight, strict=True)])
    wanted, plain = (
        np.column_stack([sampled_jet(time, part[:, k]).a for k in range(3)]) for part in (true, raw)
    )
    size = np.linalg.norm(wanted[smooth])
    error, by_difference = (
        np.linalg.norm((part - wanted)[smooth]) / size for part in (found, plain)
    )
    print(rate, noise, error, by_difference)
    assert error < within
    assert rate < 1000 or by_difference > 100  # what a plain difference would make of it


def test_the_load_itself_is_that_of_the_accelerations():
    time = np.arange(0, 8, 0.01)
    loads = Loads(ARM, time, swing(time), GRAVITY)
    for axis, moment in moments(ARM, swing(time), GRAVITY).items():
        found = np.column_stack([jet.x for jet in loads.along(axis)])
        np.testing.assert_allclose(found, moment, rtol=0, atol=1e-12 * np.abs(moment).max())


def test_rows_apart_have_the_load_of_their_own_motion():
    """While accelerations stay, against samples so close that differences of them are exact."""
    time = (np.arange(801) - 400) * 1e-4
    axes = {
        a: Jet(1 + (2 + k * time) * time, 2 + 2 * k * time, 2.0 * k) for k, a in enumerate(REACH)
    }
    course = Loads(ARM, time, axes, GRAVITY)
    apart = Loads(ARM, time, axes, GRAVITY, rows_apart=True)
    order = rng_of("rows apart").permutation(len(time))
    shuffled = {a: Jet(j.x[order], j.v[order], j.a) for a, j in axes.items()}
    other = Loads(ARM, time, shuffled, GRAVITY, rows_apart=True)
    for axis in (*REACH, BASE):
        moment = moments(ARM, axes, GRAVITY)[axis]
        for k, (jet, mixed) in enumerate(zip(apart.along(axis), other.along(axis), strict=True)):
            np.testing.assert_allclose(jet.x, course.along(axis)[k].x, rtol=0, atol=1e-10)
            wanted = sampled_jet(time, moment[:, k])
            for part in "va":
                found, true = getattr(jet, part), getattr(wanted, part)
                within = 1e-4 * np.abs(true).max() + 1e-5
                np.testing.assert_allclose(found[3:-3], true[3:-3], rtol=0, atol=within)
                np.testing.assert_allclose(getattr(mixed, part), found[order], rtol=0, atol=1e-7)
    assert np.abs(apart.along(BASE)[0].a).max() > 10


def test_a_mass_on_a_link_is_like_a_link_with_that_mass():
    time = np.arange(0, 8, 0.05)
    first, last = ARM.link
    mass, at = 2.0, np.array([0.3, -0.2, 0.1])
    total = last.mass_kg + mass
    centre = (last.mass_kg * np.array(last.centre_m) + mass * at) / total
    inertia = last.inertia.copy()
    for m, r in ((last.mass_kg, np.array(last.centre_m) - centre), (mass, at - centre)):
        inertia += m * (r @ r * np.eye(3) - np.outer(r, r))
    heavier = Link.model_validate(
        last.model_dump()
        | {
            "mass_kg": total,
            "centre_m": tuple(centre),
            "inertia_kg_m2": (*np.diag(inertia), inertia[0, 1], inertia[0, 2], inertia[1, 2]),
        }
    )
    axes = swing(time)
    expected = moments(Chain(link=(first, heavier)), axes, GRAVITY)
    found = moments(ARM, axes, GRAVITY, [Mass("lift", mass, tuple(at))])
    for axis, moment in expected.items():
        np.testing.assert_allclose(found[axis], moment, rtol=0, atol=1e-11)
