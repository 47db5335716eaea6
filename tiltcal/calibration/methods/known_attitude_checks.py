"""Poses of known attitude: tests of the fit, columns, units and faces; the fixture's rotation.

Poses of known attitude that do not fit: the single causes that would explain them, compared.
"""

from collections.abc import Iterator
from dataclasses import replace
from functools import partial
from itertools import combinations

import numpy as np

from tiltcal.calibration.methods.common import fitted_sensitivity, whitening_of_means
from tiltcal.calibration.methods.known_attitude_model import (
    DRIFT,
    Model,
    Turned,
    design_of,
    solve,
    solve_about_errors,
)
from tiltcal.calibration.screen.causes import Misfit, at_poses, cause_test
from tiltcal.calibration.screen.columns import (
    column_orders,
    common_gain,
    exchanged_words,
    order_test,
    unit_tests,
)
from tiltcal.calibration.screen.drift import slope_test
from tiltcal.calibration.screen.explanations import Explanation, explanation
from tiltcal.calibration.validity import Test, chi2_test, threshold_test
from tiltcal.core.arrays import Array
from tiltcal.core.frames import AXES, angle_between
from tiltcal.core.units import ARCSEC, DEG
from tiltcal.effects.table.readout import EncoderZero, zero_of
from tiltcal.recordings.recording import Recording
from tiltcal.recordings.static_poses import Poses, group_directions
from tiltcal.setup.sensor import Sensor
from tiltcal.setup.sources import SourceTable
from tiltcal.statistics.least_squares import Fit

SUSPECTS = 8  # dwells that are tried at other attitudes: those that spoil the fit most
OTHER = 10 * DEG  # from the stated direction: another face
PLAUSIBLE = 0.5  # a sensitivity matrix further from its gain times 1 is that of other columns
FACES = {
    f"{'+' if s > 0 else '-'}{a}": s * np.eye(3)[i] for i, a in enumerate(AXES) for s in (1, -1)
}


def is_plausible(M: Array) -> bool:
    """Whether every channel senses its own axis, whatever the unit. M: (k, k)."""
    return bool(np.abs(M / common_gain(M) - np.eye(len(M))).max() < PLAUSIBLE)


def causes(
    poses: Poses,
    model: Model,
    fit: Fit,
    recording: Recording,
    turned: Turned,
    *,
    fits: bool,
) -> list[Explanation]:
    """Every single cause that was tried: attitudes and columns, and those that all methods try of
    what a fit leaves.

    Attitudes, columns and zeros that leave an implausible sensitivity of a triad are left out.

    Args:
        poses: of known attitude.
        model, fit: of their means.
        recording: that the poses are of.
        turned: the poses under other references, and with errors of the table.
        fits: whether the fit leaves nothing, and only its sensitivity is implausible.
    """
    tried, sensor = [*_attitudes(poses, model), *_zeros(poses, model, turned)], poses.sensor
    if len(sensor.axes) == 3:
        tried += _columns(poses, model)
        tried = [t for t in tried if is_plausible(fitted_sensitivity(t[1], sensor.name))]
    found = [e for e, _ in tried]
    if fits:
        return found
    return [*found, *misfit_of_poses(poses, model, fit, recording).explanations()]


def misfit_of_poses(poses: Poses, model: Model, fit: Fit, recording: Recording) -> Misfit:
    """What a fit of poses of known attitude leaves. recording: that the poses are of."""
    whiten, gravity = whitening_of_means(poses), model.setup.site.gravity
    return at_poses(
        poses,
        recording,
        gravity,
        gravity * poses.up,
        fit.residuals,
        design_of(poses, model)[2],
        lambda errors: np.einsum("mij,qmj->miq", whiten, errors).reshape(-1, len(errors)),
    ).sharing(poses.references.whitened(whiten))


def _attitudes(poses: Poses, model: Model) -> Iterator[tuple[Explanation, Fit]]:
    """Two dwells exchanged; one dwell at another face."""
    suspects = _suspects(poses, model)
    pairs = list(combinations(suspects, 2))
    for i, j in pairs:
        if angle_between(poses.up[i], poses.up[j]) > OTHER:
            up = poses.up.copy()
            up[[i, j]] = up[[j, i]]
            part, _ = solve(replace(poses, up=up), model)
            first, second = sorted(poses.spans[k].start_s for k in (i, j))
            times = f"{first:.6g} s and {second:.6g} s"
            yield explanation(f"these two are swapped: {times}", part, len(pairs)), part
    for k in suspects:
        span, stated = poses.spans[k], poses.spans[k].label or "by the readout"
        others = [f for f, e in FACES.items() if angle_between(e, poses.up[k]) > OTHER]
        for face in others:
            up = poses.up.copy()
            up[k] = FACES[face]
            part, _ = solve(replace(poses, up=up), model)
            words = f"the dwell at {span.start_s:.6g} s is stated {stated} but reads {face}"
            yield explanation(words, part, len(poses) * len(others)), part


def _zeros(poses: Poses, model: Model, turned: Turned) -> Iterator[tuple[Explanation, Fit]]:
    """The zero of an angle readout is off, by a size that a table may have at most."""
    stated = {name for s in poses.references.sources for e in s.effects for name in e.values}
    axes = [a for a in model.setup.rig.kind.turning if zero_of(a) not in stated]
    for axis in axes if poses.angles else ():
        (largest,) = {p.plausible[-1] for p in EncoderZero.parameters if p.name == zero_of(axis)}
        table = SourceTable.model_validate(
            {"id": EncoderZero.id, f"{zero_of(axis)}_arcsec": largest}
        )
        setup = model.setup.model_copy(update={"budget": (*model.setup.budget, table)})
        _, part, _ = solve_about_errors(turned(setup, ()), model, partial(turned, setup))
        value, sigma = largest * part.posterior[:, -1]
        words = (
            f"the zero of the readout of axis {axis} is off by {value:.5g} +- {sigma:.2g} arcsec"
            f" (fit it: state {EncoderZero.id} in [[budget]])"
        )
        yield explanation(words, part, len(axes), further=1), part


def _suspects(poses: Poses, model: Model) -> list[int]:
    """The dwells without which the others fit best."""
    left = []
    for k in range(len(poses)):
        rest, _ = solve(poses.subset(np.arange(len(poses)) != k), model)
        left.append(rest.chi2)
    return [int(k) for k in np.argsort(left)[:SUSPECTS]]


def _columns(poses: Poses, model: Model) -> Iterator[tuple[Explanation, Fit]]:
    """Columns in another order, or with another sign."""
    for order, signs in column_orders():
        if order == (0, 1, 2) and signs == (1, 1, 1):
            continue
        columns = list(order)
        other = replace(
            poses,
            means=poses.means[:, columns] * np.array(signs),
            noise=poses.noise[np.ix_(columns, columns)] * np.outer(signs, signs),
            rounding=poses.rounding[:, columns],
            references=poses.references.of(columns, signs),
        )
        part, _ = solve(other, model)
        yield explanation(exchanged_words(order, signs), part, 47), part


def known_attitude_tests(
    poses: Poses,
    model: Model,
    fit: Fit,
    recording: Recording,
    turned: Turned,
    stated: bool,
) -> list[Test]:
    """Consistency of the poses with its most probable cause, second order, drift; for a triad
    unit, columns and faces.

    Args:
        poses: of known attitude.
        model, fit: of their means.
        recording: that the poses are of.
        turned: the poses under other references, and with errors of the table.
        stated: whether the dwells are stated: a face that the recording never comes near was not
            to be recorded.
    """
    unit = recording.sensor(poses.sensor).units[0]
    words = f"residuals of {fit.dof} redundant equations against the noise of the means"
    tests = [chi2_test("fit", fit.chi2, fit.dof, words), *_second_order(poses, model, fit)]
    if DRIFT not in model.terms:
        tests.append(slope_test(poses))
    triad = len(poses.sensor.axes) == 3
    plausible = True
    if {"scale", "cross_axis"} <= set(model.terms) and not fit.dropped:
        M = fitted_sensitivity(fit, poses.sensor.name, poses.sensor.axes)
        plausible = is_plausible(M)
        tests += [*unit_tests(poses.sensor, M, unit), order_test(M)]
    if not tests[0].passed or not plausible:
        tried = causes(poses, model, fit, recording, turned, fits=tests[0].passed)
        tests.append(cause_test(tried, recording.source))
    return [*tests, _faces_complete(poses, recording if stated else None)] if triad else tests


def _second_order(poses: Poses, model: Model, fit: Fit) -> list[Test]:
    """Does a quadratic term explain what the redundant equations leave?"""
    terms = model.terms
    if "K2" in terms or "bias" not in terms or fit.dof < 3 or fit.dropped:
        return []
    wider, _ = solve(poses, replace(model, terms=[*terms, "K2"]))
    gained = len(wider.names) - len(fit.names)
    # otherwise these poses cannot separate K2 from the linear terms
    if gained <= 0 or not set(fit.names) <= set(wider.names):
        return []
    drop = fit.chi2 - wider.chi2
    sizes = ", ".join(f"{n} {wider.value(n):.3g}" for n in wider.names if ".K2_" in n)
    words = f"a quadratic term (ug/g2: {sizes}) reduces chi2 by {drop:.3g}"
    return [chi2_test("second order", drop, gained, words)]


def _faces_complete(poses: Poses, of_stated: Recording | None) -> Test:
    """Whether every face was recorded. of_stated: the recording, where its dwells are stated."""
    missing = [face for face, e in FACES.items() if np.max(poses.up @ e) < 0.5]
    left_out = []
    if of_stated is not None:
        felt = of_stated.sensor(poses.sensor).values
        toward = felt / np.maximum(np.linalg.norm(felt, axis=1), np.finfo(float).tiny)[:, None]
        left_out = [face for face in missing if np.nanmax(toward @ FACES[face]) >= 0.5]
    words = "every axis was recorded up and down"
    if missing:
        words = f"no pose within 60 deg of {', '.join(missing)} up"
    group = group_directions(poses.up)
    first = np.unique(group, return_index=True)[1]
    repeated = [
        f"{_face(poses.up[k])} {n} times"
        for k, n in zip(first, np.bincount(group), strict=True)
        if n > 1
    ]
    wrong = missing if of_stated is None else left_out
    if left_out:
        words += f"; the recording comes near {', '.join(left_out)}: a dwell left out?"
    elif missing and not wrong:
        words += ", nor any reading of the recording: the model is not tested there"
    elif missing and repeated:
        words += f", but {', '.join(repeated)}: recorded twice instead?"
    return threshold_test("faces complete", len(missing), not wrong, words, dof=6)


def _face(direction: Array) -> str:
    """The axis nearest to a direction, such as ``+x``."""
    i = int(np.argmax(np.abs(direction)))
    return ("+" if direction[i] > 0 else "-") + AXES[i]


def fixture_rotation(fit: Fit, sensor: Sensor) -> str:
    """The rotation of the fixture that would give the same antisymmetric cross-axis terms, in
    words.
    """
    words = (
        "a rotation common to all poses (fixture or mounting) cannot be distinguished from the"
        " antisymmetric part of the cross-axis terms"
    )
    pairs = [("yz", "zy"), ("zx", "xz"), ("xy", "yx")]
    names = [[f"{sensor.name}.cross_{ij}" for ij in pair] for pair in pairs]
    if not all(n in fit.names for pair in names for n in pair):
        return words
    sizes = []
    for axis, pair in zip(AXES, names, strict=True):
        i, j = (fit.names.index(n) for n in pair)
        C = fit.covariance
        angle = (fit.values[i] - fit.values[j]) / 2 / ARCSEC
        sigma = np.sqrt(C[i, i] + C[j, j] - 2 * C[i, j]) / 2 / ARCSEC
        sizes.append(f"{axis} {angle:.4g} +- {sigma:.2g}")
    return (
        f"{words}: here it would be a rotation of {', '.join(sizes)} arcsec; the symmetric part,"
        " scale and bias do not depend on it"
    )
