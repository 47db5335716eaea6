"""The single causes that a misfit may have, one list for all methods: a part of the recording that
does not belong, a limiter, a step of bias or scale factor, and further terms of the catalogue.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np

from tiltcal.calibration.methods.terms import columns_under
from tiltcal.calibration.screen.explanations import Explanation, in_words
from tiltcal.calibration.validity import Test, threshold_test
from tiltcal.core.arrays import Array, Index, Mask
from tiltcal.effects import CATALOGUE
from tiltcal.effects.base import TermEffect
from tiltcal.effects.sense import Sense
from tiltcal.instrument.temperature import held
from tiltcal.recordings.means_table import MeansTable
from tiltcal.recordings.recording import Recording
from tiltcal.recordings.static_poses import Poses
from tiltcal.setup.sensor import Sensor
from tiltcal.statistics.least_squares import SINGULAR, CommonErrors

SCENARIO_FILE = "SCENARIO"  # in a statement: only a command knows the path
LITTLE = 0.1  # of chi2, that a cause leaves which takes most of it
DRIFT = "the bias drifts over the recording"
COARSE = 60  # instants of a step that are tried at first; then all about the best
# sigmas from the extreme to the least of the readings at a limit: 4 each side, 3e-5 of them beyond
NEAR = 8.0
REFITTED = 8  # causes that a non-linear model is fitted with: the best by its linear form
ROUNDS = 4  # in which the inputs of a term, and by them its errors, are corrected by the fit


@dataclass(frozen=True)
class Term:
    """Errors that readings may have.

    Args:
        words: what makes them.
        of: the errors under a fit, one column each, SI, (q, r, k).
        tried: places at which the cause was looked for.
    """

    words: str
    of: "Callable[[Misfit], Array]"
    tried: int = 1


Respond = Callable[[Array], Array]
"""Errors of the readings (q, r, k), SI -> what they add to the residuals (n, q)."""


@dataclass(frozen=True)
class Misfit:
    """What the fit of a method leaves, and how it would change by errors of the readings.

    Args:
        channels: names of the channels, (k,).
        time: of each reading, s, (r,).
        readings: SI, (r, k); inputs: what acts along each channel, SI, (r, k).
        sigma: standard deviation of each reading, SI, (r, k).
        part: number of the dwell, turn or stretch of each reading, (r,).
        parts: these in words.
        residuals: of the fit, in units of their noise, (n,).
        design: their derivatives by the parameters, (n, p).
        respond: their derivatives by errors of the readings.
        terms: errors that the model may lack, by what makes them, SI: their courses, of which one
            holds, (c, q, r, k).
        allowed: variance of the residuals with slow noise over that without.
        freedom: degrees of freedom of the noise.
        cuts: first readings after which a step is looked for; every one unless given.
        refit: where the model is not linear: the misfit with some errors (q, r, k) of the readings
            fitted beside its parameters, of the readings that are kept (r,).
    """

    channels: Sequence[str]
    time: Array
    readings: Array
    inputs: Array
    sigma: Array
    part: Index
    parts: Sequence[str]
    residuals: Array
    design: Array
    respond: Respond
    terms: Mapping[str, Array]
    allowed: float = 1.0
    freedom: float = 1e9
    cuts: Index | None = None
    refit: "Callable[[Array, Mask], Misfit] | None" = None

    def sharing(self, common: CommonErrors) -> "Misfit":
        """With errors that the residuals share, as further parameters of which a prior is known:
        one more residual each, so that those of some readings can be left out. The residuals were
        weighted by their covariance.
        """
        shared = common.columns[:, common.fitted]
        count = shared.shape[1]
        none = np.zeros((count, self.design.shape[1]))
        return replace(
            self,
            residuals=np.append(common.unweighted(self.residuals), np.zeros(count)),
            design=np.block([[self.design, shared], [none, np.eye(count)]]),
            respond=lambda errors: np.vstack(
                [self.respond(errors), np.zeros((count, len(errors)))]
            ),
        )

    @property
    def chi2(self) -> float:
        """Of what no parameter takes up of the residuals, in units of what slow noise allows."""
        left = _rest(self.residuals, _basis(self.design))
        return float(left @ left) / self.allowed

    def explanations(self) -> list[Explanation]:
        """Every single cause that was tried, and what it leaves."""
        basis = _basis(self.design)
        found = [*self._parts(basis), *self._limiters(basis)]
        lacking = (self._best(words, basis) for words in self.terms)
        found += [t for term in (*lacking, *self._steps(basis)) for t in self._with(term, basis)]
        if self.refit is None:
            return [tried.by_line for tried in found]
        found.sort(key=lambda tried: tried.by_line.bic)
        return [self._refitted(tried) for tried in found[:REFITTED]]

    def _refitted(self, tried: "Trial") -> Explanation:
        """The explanation by the model itself rather than by its linear form: the errors follow
        from the inputs, and these from the fit.
        """
        assert self.refit is not None
        fitted, term = self, tried.term
        for _ in range(ROUNDS):
            columns = np.zeros((0, *self.readings.shape)) if term is None else term.of(fitted)
            _, new = _new_to(_basis(self.design), self.respond(columns))
            fitted = self.refit(np.tensordot(new, columns, axes=1), tried.kept)
        chi2 = fitted.chi2 + tried.apart / self.allowed
        line = tried.by_line
        return replace(line, chi2=chi2, bic=line.bic + chi2 - line.chi2)

    def _explanation(self, words: str, chi2: float, rank: int, tried: int) -> Explanation:
        n = len(self.residuals)
        found = Explanation.of(words, max(chi2, 0.0) / self.allowed, n - rank, n, tried)
        return replace(found, freedom=self.freedom)

    def _best(self, words: str, basis: Array) -> Term:
        """A term that the model may lack; of several courses the one that explains most."""
        courses = self.terms[words]
        if len(courses) == 1:
            return Term(words, partial(_lacking, words, 0))
        gains = [_gains(self.residuals, basis, self.respond(c))[0] for c in courses]
        return Term(words, partial(_lacking, words, int(np.argmax(gains))), len(courses))

    def _with(self, term: Term, basis: Array) -> "Iterator[Trial]":
        """A term beside the parameters; nothing where these hold it already."""
        gain, rank = _gains(self.residuals, basis, self.respond(term.of(self)))
        if rank:
            left = _rest(self.residuals, basis)
            chi2, rank = float(left @ left) - gain, basis.shape[1] + rank
            found = self._explanation(term.words, chi2, rank, term.tried)
            yield Trial(found, np.ones(len(self.time), bool), term)

    def _parts(self, basis: Array) -> "Iterator[Trial]":
        """A part that does not belong to the others: its residuals are parameters; or one with a
        bias of its own.
        """
        for k, words in enumerate(self.parts):
            kept, stated = self.part != k, f"{words} does not fit the others"
            out = np.tile(~kept[:, None], len(self.channels))
            chi2, rank, lost = self._without(out, basis)
            yield Trial(self._explanation(stated, chi2, rank + lost, len(self.parts)), kept)
            if np.sum(~kept) > 1:
                stated = f"{words} is off by a constant: another bias, attitude or rate than stated"
                yield from self._with(Term(stated, partial(_own_bias, k), len(self.parts)), basis)

    def _limiters(self, basis: Array) -> "Iterator[Trial]":
        """The readings at an end of a range, or at both, show nothing but a limit."""
        for i, name in enumerate(self.channels):
            ends = [self._limited(i, extreme) for extreme in (np.max, np.min)]
            for some in ends[:1], ends[1:], ends:
                at_end = np.any([rows for rows, _, _ in some], axis=0)
                if at_end.all():
                    continue
                out = at_end | self._beside(at_end)
                apart = sum(chi2 for _, _, chi2 in some)
                chi2, rank, lost = self._without(out[:, None] * _one(i, self.channels), basis)
                # a limit is one parameter; further residuals that these readings enter are lost
                rank += lost - int(at_end.sum()) + len(some)
                limits = " and ".join(f"{limit:.5g}" for _, limit, _ in some)
                words = f"{name} is limited at {limits} m/s2 or rad/s (saturated)"
                found = self._explanation(words, chi2 + apart, rank, 3 * len(self.channels))
                yield Trial(found, ~out, apart=apart)

    def _beside(self, rows: Mask) -> Mask:
        """Readings next to some of their own part: means that may hold a part of those. (r,)"""
        same = np.diff(self.part) == 0
        after, before = np.zeros_like(rows), np.zeros_like(rows)
        after[1:], before[:-1] = rows[:-1] & same, rows[1:] & same
        return (after | before) & ~rows

    def _limited(self, channel: int, extreme: Callable[[Array], Any]) -> tuple[Mask, float, float]:
        """Readings at an extreme of a channel, (r,), their mean, and their chi-square about it."""
        values, sigma = self.readings[:, channel], self.sigma[:, channel]
        at_end = np.abs(values - extreme(values)) < NEAR * sigma
        limit = float(np.average(values[at_end], weights=sigma[at_end] ** -2))
        return at_end, limit, float(np.sum(((values - limit) / sigma)[at_end] ** 2))

    def _without(self, out: Array, basis: Array) -> tuple[float, int, int]:
        """Some readings left out: chi-square of the residuals that they do not enter, its rank, and
        how many residuals they do enter.

        Args:
            out: which, 0 or 1, (r, k).
            basis: of the design, orthonormal, (n, rank).
        """
        # one channel at a time: errors of two may cancel in a residual
        each = out * self.sigma * np.eye(len(self.channels))[:, None]
        rows = np.abs(self.respond(each)).max(axis=1) < SINGULAR
        lost, left = basis[~rows], self.residuals[rows]
        values, vectors = np.linalg.eigh(np.eye(basis.shape[1]) - lost.T @ lost)
        kept = values > SINGULAR
        along = (vectors[:, kept] / np.sqrt(values[kept])).T @ (basis[rows].T @ left)
        return float(left @ left - along @ along), int(kept.sum()), int(np.sum(~rows))

    def _steps(self, basis: Array) -> Iterator[Term]:
        """A step of the bias or of the scale factor of one channel, or of the bias of all, at the
        instant that explains most.
        """
        for i, name in enumerate(self.channels):
            yield self._step(f"the bias of {name}", partial(_bias, [i]), basis)
            yield self._step(f"the scale factor of {name}", partial(_scale, [i]), basis)
        if len(self.channels) > 1:
            every = list(range(len(self.channels)))
            yield self._step("the bias of all channels", partial(_bias, every), basis)

    def _step(self, words: str, shapes: "Callable[[Misfit], Array]", basis: Array) -> Term:
        """The step of errors of some shapes, (q, r, k), that explains most."""
        rows = np.arange(len(self.time))
        cuts = rows[1:] if self.cuts is None else self.cuts

        def after(cut: int, fitted: Misfit) -> Array:
            return np.asarray(shapes(fitted) * (rows >= cut)[:, None])

        def best(some: Index) -> int:
            columns = (self.respond(after(cuts[k], self)) for k in some)
            gains = [_gains(self.residuals, basis, c)[0] for c in columns]
            return int(some[int(np.argmax(gains))])

        coarse = np.unique(np.linspace(0, len(cuts) - 1, COARSE).astype(np.intp))
        at = best(coarse)
        stride = int(np.max(np.diff(coarse), initial=1))
        cut = int(cuts[best(np.arange(max(at - stride, 0), min(at + stride + 1, len(cuts))))])
        between = f"{self.time[cut - 1]:.6g} and {self.time[cut]:.6g} s"
        words += f" changes by a step between {between}"
        return Term(words, partial(after, cut), len(cuts))


@dataclass(frozen=True)
class Trial:
    """A cause that was tried on the linear form of a model.

    Args:
        by_line: what it leaves.
        kept: readings that the model is fitted to, (r,).
        term: errors that are fitted beside it.
        apart: chi-square of the readings that are not kept.
    """

    by_line: Explanation
    kept: Mask
    term: Term | None = None
    apart: float = 0.0


def _one(channel: int, channels: Sequence[str]) -> Array:
    """1 at one channel, (k,)."""
    return np.asarray(np.eye(len(channels))[channel])


def _lacking(words: str, course: int, misfit: Misfit) -> Array:
    return misfit.terms[words][course]


def _own_bias(part: int, misfit: Misfit) -> Array:
    """Errors of all channels in one part, (k, r, k)."""
    every = range(len(misfit.channels))
    return np.asarray(_bias(every, misfit) * (misfit.part == part)[:, None])


def _bias(channels: Sequence[int], misfit: Misfit) -> Array:
    """Errors of some channels alike at all readings, (q, r, k)."""
    one = np.eye(len(misfit.channels))[list(channels), None]
    return np.broadcast_to(one, (len(one), *misfit.readings.shape))


def _scale(channels: Sequence[int], misfit: Misfit) -> Array:
    """Errors of some channels in proportion to their inputs, (q, r, k)."""
    return np.asarray(_bias(channels, misfit) * misfit.inputs)


def _basis(design: Array) -> Array:
    """Orthonormal columns of the space of a design, (n, rank)."""
    scale = np.linalg.norm(design, axis=0)
    u, s, _ = np.linalg.svd(design / np.where(scale > 0, scale, 1.0), full_matrices=False)
    return np.asarray(u[:, s > SINGULAR * max(float(s.max(initial=0.0)), 1e-300)])


def _rest(columns: Array, basis: Array) -> Array:
    """What lies outside of a space, (n,) or (n, q). basis: of it, orthonormal, (n, rank)."""
    return np.asarray(columns - basis @ (basis.T @ columns))


def _new_to(basis: Array, columns: Array) -> tuple[Array, Array]:
    """What further columns, (n, q), add to the space of a fit: orthonormal, (n, rank), and the
    combinations of the columns that do, (rank, q).
    """
    size = np.linalg.norm(columns, axis=0)
    scaled = columns / np.where(size > 0, size, 1.0)
    u, s, vt = np.linalg.svd(_rest(scaled, basis), full_matrices=False)
    new = s > np.sqrt(SINGULAR)
    return u[:, new], vt[new] / np.where(size > 0, size, np.inf)


def _gains(residuals: Array, basis: Array, columns: Array) -> tuple[float, int]:
    """By how much further columns, (n, q), lower the chi-square of a fit, and how many of them are
    new to its parameters.
    """
    new, _ = _new_to(basis, columns)
    return float(np.sum((new.T @ residuals) ** 2)), new.shape[1]


def cause_test(found: Sequence[Explanation], source: str, name: str = "cause") -> Test:
    """The test that names the cause of a misfit.

    Args:
        found: causes that were tried.
        source: of the recording.
        name: of the test.
    """
    nothing = (
        f"no single cause that was tried explains {_most(found)}; run"
        f" `tiltcal diagnose {source.removeprefix('recording ')} --scenario {SCENARIO_FILE}`"
    )
    return threshold_test(name, len(found), False, in_words(found, nothing))


def _most(found: Sequence[Explanation]) -> str:
    """What no cause explains: all of it, where one takes most; else it."""
    tried = [e for e in found if e.dof > 0]
    if not tried:
        return "it"
    best = min(tried, key=lambda e: e.bic)
    if best.chi2 > LITTLE * max(e.chi2 for e in tried):
        return "it"
    return f"all of it, most is {best.words} (chi2/dof {best.chi2 / best.dof:.3g} is left)"


def lacking_terms(sensor: Sensor, sense: Sense, channels: int | None = None) -> dict[str, Array]:
    """Errors by terms of the catalogue that a model of a sensor may lack, and by a drift, SI, of
    one course each, (1, q, r, k), by what makes them.

    Args:
        sensor: which.
        sense: what it senses at each reading.
        channels: of the errors; further ones than those of the sensor have none.
    """
    found = {}
    for cls in CATALOGUE.values():
        if issubclass(cls, TermEffect) and cls.linear and cls.row_wise and cls.senses(sensor.kind):
            name = cls.calibration_term or cls.id.partition("_")[2]
            columns = columns_under([cls.id], sensor, sense)[2]
            found[f"the term {name} ({cls.title})"] = columns
    elapsed = (sense.time - sense.time[0])[:, None]
    found[DRIFT] = np.eye(len(sensor.axes))[:, None, :] * elapsed[None]
    further = (channels or len(sensor.axes)) - len(sensor.axes)
    pad = ((0, 0), (0, 0), (0, further))
    return {words: np.pad(c, pad)[None] for words, c in found.items() if c.any()}


def part_words(noun: str, start: float, end: float, label: str | None = None) -> str:
    """A part of a recording, such as ``the dwell from 12 to 18 s (+x)``."""
    stated = f" ({label})" if label else ""
    return f"the {noun} from {start:.6g} to {end:.6g} s{stated}"


def at_poses(
    poses: Poses,
    recording: Recording,
    gravity: float,
    force: Array,
    residuals: Array,
    design: Array,
    respond: Respond,
    refit: Callable[[Array, Mask], Misfit] | None = None,
) -> Misfit:
    """What a fit of the means of poses leaves.

    Args:
        poses: that were fitted.
        recording: that they are of.
        gravity: m/s2.
        force: that acts at each, m/s2, (m, 3).
        residuals, design, respond, refit: as of a misfit.
    """
    sensor, spans = poses.sensor, poses.spans
    middle = np.array([(s.start_s + s.end_s) / 2 for s in spans])
    sense = replace(
        Sense.at_rest(sensor, gravity, force),
        time=middle,
        elapsed=middle - middle[0],
        temperature=_temperature(recording, poses),
    )
    return Misfit(
        [f"{sensor.name}_{a}" for a in sensor.axes],
        middle,
        poses.means,
        force[:, list(sensor.axis_indices)],
        np.sqrt(np.diagonal(poses.covariances, axis1=1, axis2=2)),
        np.arange(len(poses)),
        [part_words("dwell", s.start_s, s.end_s, s.label) for s in spans],
        residuals,
        design,
        respond,
        lacking_terms(sensor, sense),
        refit=refit,
    )


def _temperature(recording: Recording, poses: Poses) -> Array:
    """Mean temperature of each pose less that of all, K, (m,); 0 where there is none."""
    column = recording.channel("temperature")
    if column is None or isinstance(recording, MeansTable):
        return np.zeros(len(poses))
    values = held(recording.column(column))
    inside = [(recording.time >= s.start_s) & (recording.time <= s.end_s) for s in poses.spans]
    found = np.array([np.nanmean(values[rows]) if rows.any() else np.nan for rows in inside])
    return np.nan_to_num(found - np.nanmean(found))
