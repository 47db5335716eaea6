"""Moments that the joints and the base of a user's own model carry as it moves: inverse dynamics of
its links.

Newton's and Euler's equations of each link, outward for the motion and inward for the loads, in the
links' own frames.  Source: Featherstone 2008, *Rigid Body Dynamics Algorithms*, 5.3.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from tiltcal.core.arrays import Array
from tiltcal.setup.chain import BASE, Chain, Link
from tiltcal.setup.tables import bearing
from tiltcal.setup.trajectory import Jet, sampled_jet

Moments = dict[str, Array]
DIFFERENCE_S = 1e-3  # s before and after, from which the rate of a load follows


@dataclass(frozen=True)
class Mass:
    """A point mass on a link, in addition to those of the model; negative: the model's is too
    large.

    Args:
        axis: of the link.
        mass: kg.
        at: its position in the link's frame, m, (3,).
    """

    axis: str
    mass: float
    at: tuple[float, float, float]


@dataclass(frozen=True)
class _Motion:
    """How a frame moves, in its own components, (n, 3) each.

    Args:
        rate, spin: angular rate and acceleration, rad/s and rad/s2.
        force: proper acceleration of its origin, m/s2.
    """

    rate: Array
    spin: Array
    force: Array

    def at(self, r: Array) -> Array:
        """Proper acceleration of points that are fixed in the frame, m/s2, (n, 3). r: m, (3,) or
        (n, 3).
        """
        centripetal = np.cross(self.rate, _crossed(self.rate, r))
        return np.asarray(self.force + _crossed(self.spin, r) + centripetal)


@dataclass
class _Load:
    """What acts on a link: a force at its origin, N, and a moment about it, N m, (n, 3) each."""

    force: Array
    moment: Array

    def add(self, force: Array, moment: Array, r: Array) -> None:
        """Add a force at a point r, m, (3,), and a moment about that point."""
        self.force = self.force + force
        self.moment = self.moment + moment - _crossed(force, r)


def moments(
    chain: Chain, axes: Mapping[str, Jet], gravity: float, masses: Sequence[Mass] = ()
) -> Moments:
    """Moment of the weight and of the inertia of all that an axis carries, about the origin of its
    link, N m, (n, 3) each: under the axis' name in the link's frame, under that of its bearing in
    this frame before it turns; that of everything that moves, about the base's origin, under
    ``BASE``.

    Args:
        chain: the links.
        axes: their angles or positions with rates and accelerations, (n,) each.
        gravity: m/s2; the base is taken as level and at standstill.
        masses: on the links, in addition to theirs.
    """
    n = max(np.size(jet.x) for jet in axes.values())
    zero = np.zeros((n, 3))
    motion = {BASE: _Motion(zero, zero, np.broadcast_to([0.0, 0.0, gravity], (n, 3)))}
    load = {BASE: _Load(zero, zero)}
    for link in chain.link:
        motion[link.axis] = _outward(motion[link.on], link, axes[link.axis])
        load[link.axis] = _of_link(motion[link.axis], link)
    for mass in masses:
        r = np.array(mass.at)
        load[mass.axis].add(-mass.mass * motion[mass.axis].at(r), zero, r)
    found: Moments = {}
    for link in reversed(chain.link):
        found[link.axis] = load[link.axis].moment
        force, moment = _before(load[link.axis], link, axes[link.axis])
        found[bearing(link.axis)] = moment
        load[link.on].add(force @ link.R.T, moment @ link.R.T, link.offset)
    return {BASE: load[BASE].moment, **found}


def _before(load: _Load, link: Link, jet: Jet) -> tuple[Array, Array]:
    """Force at the origin of a link's bearing, N, and moment about it, N m, in that frame, (n, 3)
    each.
    """
    if link.slides:
        return load.force, load.moment - _crossed_z(load.force, jet.x)
    return _about_z(load.force, jet, 1), _about_z(load.moment, jet, 1)


def _outward(motion: _Motion, link: Link, jet: Jet) -> _Motion:
    """The motion of a link from that of what it stands on."""
    before = motion.rate, motion.spin, motion.at(link.offset)
    rate, spin, force = (u @ link.R for u in before)
    v, a = (_along_z(part, len(rate)) for part in (jet.v, jet.a))
    if link.slides:
        force = _Motion(rate, spin, force).at(_along_z(jet.x, len(rate)))
        return _Motion(rate, spin, force + 2 * _crossed_z(rate, jet.v) + a)
    rate, spin, force = (_about_z(u, jet, -1) for u in (rate, spin, force))
    return _Motion(rate + v, spin + _crossed_z(rate, jet.v) + a, force)


def _of_link(motion: _Motion, link: Link) -> _Load:
    """The load by a link's own mass and inertia."""
    centre, inertia = np.array(link.centre_m), link.inertia
    force = -link.mass_kg * motion.at(centre)
    turning = -(motion.spin @ inertia + np.cross(motion.rate, motion.rate @ inertia))
    return _Load(force, turning - _crossed(force, centre))


def _crossed(u: Array, r: Array) -> Array:
    """Vectors crossed with others, (n, 3), or, at a tenth of the time, with one by its matrix."""
    return np.cross(u, r) if r.ndim > 1 else u @ np.cross(np.eye(3), r)


def _along_z(size: Array | float, n: int) -> Array:
    """Vectors along z, (n, 3). size: (n,), or a number."""
    return np.multiply.outer(np.broadcast_to(size, n), np.array([0.0, 0.0, 1.0]))


def _crossed_z(u: Array, size: Array | float) -> Array:
    """Vectors crossed with ones along z, (n, 3). size: (n,), or a number."""
    return np.column_stack([u[:, 1] * size, -u[:, 0] * size, np.zeros(len(u))])


def _about_z(u: Array, jet: Jet, sign: int) -> Array:
    """Vectors turned about z by an angle, or back, (n, 3)."""
    c, s = jet.cos_sin
    s = sign * s
    return np.column_stack([c * u[:, 0] - s * u[:, 1], s * u[:, 0] + c * u[:, 1], u[:, 2]])


def load_jet(time: Array, weight: Array, inertia: Array, error: Array) -> Jet:
    """A moment as a jet, N m.

    A spring's rate and acceleration ask for those of its load, which are the third and the fourth
    derivative of the angles where the load is of inertia: noise, where the angles are a readout, or
    where a move begins at once. The rate and the acceleration of the moment by inertia therefore
    pass a filter, that of the least estimated risk among all that fall with the frequency (Beran
    2000, J. American Statistical Association 95, 155). The moment itself is taken as it is.

    Args:
        time: s, (n,).
        weight, inertia: the parts of the moment, N m, (n,) each.
        error: of the second, by what its accelerations and second differences of the angles
            disagree about, N m, (n,).
    """
    jet = sampled_jet(time, weight)
    return jet + _of_least_risk(time, inertia, error) if np.any(inertia) else jet


class Loads:
    """The moments along a motion, worked out when they are first asked for.

    Args:
        chain: the links; None: there are none, and no moments.
        time: s, (n,).
        axes: true angles of the axes.
        gravity: m/s2.
        masses: on the links, in addition to theirs.
        rows_apart: whether the rows are no course in time: see ``Drive``.
    """

    def __init__(
        self,
        chain: Chain | None,
        time: Array,
        axes: Mapping[str, Jet],
        gravity: float,
        masses: Sequence[Mass] = (),
        rows_apart: bool = False,
    ) -> None:
        self.chain, self.time, self.gravity, self.masses = chain, time, gravity, tuple(masses)
        self.axes, self.rows_apart = axes, rows_apart
        self._kept: dict[str, tuple[Jet, Jet, Jet]] = {}

    def along(self, slot: str) -> tuple[Jet, Jet, Jet]:
        """Moment on a link, a bearing or ``BASE`` (see ``moments``), along x, y and z of that
        frame, as jets, N m.
        """
        if slot not in self._kept:
            if self.rows_apart:
                parts = tuple(part[slot] for part in self._by_row)
                x, y, z = (Jet(*(part[:, k] for part in parts)) for k in range(3))
            else:
                weight, inertia, error = (part[slot] for part in self._parts)
                x, y, z = (
                    load_jet(self.time, weight[:, k], inertia[:, k], error[:, k]) for k in range(3)
                )
            self._kept[slot] = x, y, z
        return self._kept[slot]

    @cached_property
    def _by_row(self) -> tuple[Moments, Moments, Moments]:
        """Moments, their rates and their accelerations by the motion of each row alone, were its
        accelerations to stay.
        """
        before, here, after = (
            self._moments({a: _later(jet, by) for a, jet in self._rows.items()})
            for by in (-DIFFERENCE_S, 0.0, DIFFERENCE_S)
        )
        rate = {a: (after[a] - before[a]) / (2 * DIFFERENCE_S) for a in here}
        return here, rate, {a: (after[a] - 2 * here[a] + before[a]) / DIFFERENCE_S**2 for a in here}

    @cached_property
    def _rows(self) -> dict[str, Jet]:
        """The axes with a value for each row."""
        n = len(self.time)
        return {
            a: Jet(*(np.broadcast_to(part, n) for part in (jet.x, jet.v, jet.a)))
            for a, jet in self.axes.items()
        }

    @cached_property
    def _parts(self) -> tuple[Moments, Moments, Moments]:
        """Moments of the weight, those of inertia, and the estimated error of the latter."""
        n, axes = len(self.time), self._rows
        weight = self._moments({a: Jet(jet.x) for a, jet in axes.items()})
        if not any(np.any(jet.v) or np.any(jet.a) for jet in axes.values()):
            none = {a: np.zeros((n, 3)) for a in weight}
            return weight, none, none
        total = self._moments(axes)
        other = self._moments(
            {a: replace(j, a=sampled_jet(self.time, np.asarray(j.x)).a) for a, j in axes.items()}
        )
        inertia = {a: total[a] - weight[a] for a in weight}
        return weight, inertia, {a: total[a] - other[a] for a in weight}

    def _moments(self, axes: Mapping[str, Jet]) -> Moments:
        assert self.chain is not None
        return moments(self.chain, axes, self.gravity, self.masses)


def _later(jet: Jet, by: float) -> Jet:
    """A jet a time ``by`` from now, s, were its acceleration to stay."""
    return Jet(jet.x + by * (jet.v + by / 2 * jet.a), jet.v + by * jet.a, jet.a)


def _of_least_risk(time: Array, moment: Array, error: Array) -> Jet:
    """A moment as a jet, its rate and acceleration each through the filter of the least risk.

    Args:
        time: s, (n,).
        moment: N m, (n,).
        error: an estimate of what is wrong in it, N m, (n,).
    """
    from scipy.fft import dct, idct
    from scipy.optimize import isotonic_regression

    plain, n = sampled_jet(time, moment), len(moment)
    wave, wrong = (dct(part, norm="ortho") for part in (moment, error))
    energy = wave**2 + np.finfo(float).tiny
    passed = (
        np.sin(np.pi * (np.arange(n) + 0.5) / n) ** 2
    )  # energy that a central difference passes
    parts = []
    for order, part in enumerate(("v", "a"), 1):
        share, weights = 1 - wrong**2 / energy, energy * passed**order
        filtered = wave * np.clip(
            isotonic_regression(share, weights=weights, increasing=False).x, 0.0, 1.0
        )
        still = np.equal(getattr(plain, part), 0.0)  # a standstill stays one
        slow = sampled_jet(time, idct(filtered, norm="ortho"))
        parts.append(np.where(still, 0.0, getattr(slow, part)))
    return Jet(moment, *parts)
