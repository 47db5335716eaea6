"""S2: attitudes unknown. At rest the length of the true specific force is g."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from tiltcal.calibration.methods.common import pick_sensor, require_triad, wrap_up
from tiltcal.calibration.methods.known_attitude_model import without_drift
from tiltcal.calibration.methods.norm_checks import (
    compared_with_iteration,
    leave_directions_out,
    misfit_of_norm,
    norm_notes,
    norm_tests,
    plausibility_tests,
    solve_with_drift,
    without_slope,
)
from tiltcal.calibration.methods.norm_iteration import product_and_sum
from tiltcal.calibration.methods.norm_model import mirrored, solve
from tiltcal.calibration.result import Calibration
from tiltcal.calibration.screen.causes import cause_test
from tiltcal.calibration.screen.data import data_tests
from tiltcal.calibration.screen.drift import slope_test
from tiltcal.calibration.screen.outliers import outlier_tests
from tiltcal.calibration.validity import Test, verdict_of
from tiltcal.core.errors import TiltcalError
from tiltcal.recordings.recording import Recording
from tiltcal.recordings.segmentation import Segment
from tiltcal.recordings.static_poses import Poses, find_poses
from tiltcal.setup.sensor import Sensor
from tiltcal.setup.setup import Setup

NAME = "norm"
EQUATION = "{}_i = bias_i + (1 + scale_i) f_i + sum_j cross_ij f_j, cross_ij = cross_ji, |f| = g"


def norm(
    recording: Recording,
    setup: Setup,
    *,
    segments: Sequence[Segment] | None = None,
    sensor: str | None = None,
    terms: int | None = None,
    drift: bool = False,
) -> Calibration:
    """Bias, scale factor and (9 parameters) symmetric cross-axis terms from ``|f| = g`` at rest.

    Model: ``reading = b + M f`` with M symmetric, |f| = g; the direction of f is free at every
    pose. Maximum likelihood: only the radial noise enters, with standard deviation
    sqrt(v' C v), v = M^-T f/|f|.

    Args:
        recording: a continuous log; the dwells are found, or given as ``segments``.
        setup: with an accelerometer triad.
        segments: dwells to use.
        sensor: which, when several fit.
        terms: 6 (bias, scale) or 9 (with cross-axis). Unless given: 9 where the scenario lets
            cross_axis be adjusted or says nothing, else 6.
        drift: fit a linear drift of each bias as well; the bias is then that at the first stamp.

    Raises:
        TiltcalError: terms is neither 6 nor 9, or there are fewer poses than parameters.

    Errors:
        Six poses and six parameters leave no residual: a wrong model cannot be detected. The
            mounting has no effect on |f|.

    Source: doi 10.3969/j.issn1672-9730.2014.01.018 (docs/sources.md, "Six arbitrary positions");
    Won and Golnaraghi, IEEE TIM 59(8) 2010; docs/physics.md, "Unknown attitudes".
    """
    used = pick_sensor(setup, recording, ("accelerometer",), sensor, NAME)
    require_triad(used, NAME, "use six_position")
    live = data_tests(recording, used)
    terms = number_of_terms(terms, used)
    poses = find_poses(recording, setup, used, segments)
    _require_poses(poses, terms, recording)
    live += outlier_tests(recording, poses)
    if drift:
        _require_slopes(poses)
    return _solved(poses, recording, setup, terms, live, drift=drift)


def _require_slopes(poses: Poses) -> None:
    """Refuse means without the readings that they were taken of."""
    if np.isnan(poses.slopes).any():
        raise TiltcalError(
            f"method {NAME}, option drift",
            found="a table of means",
            need="the readings inside the dwells",
            do="give the log, or leave drift out",
        )


def _solved(
    poses: Poses,
    recording: Recording,
    setup: Setup,
    terms: int,
    live: Sequence[Test],
    *,
    drift: bool,
) -> Calibration:
    """The calibration by the norms of these poses."""
    used, g = poses.sensor, setup.site.gravity
    span = float(recording.time[0]), float(np.ptp(recording.time))
    if drift:
        fit, converged = solve_with_drift(poses, g, terms, *span)
        level = without_slope(poses, fit, *span)
    else:
        fit, converged = solve(poses, g, terms)
        level = poses
    heldout, prediction = leave_directions_out(level, g, terms, fit)
    tests, determined = norm_tests(level, fit, converged, prediction, terms)
    tests += [*live, *plausibility_tests(level, fit, terms, recording.sensor(used).units[0])]
    if not drift:
        tests.append(slope_test(poses))
    if any(t.name == "fit" and not t.passed for t in tests):
        tried = misfit_of_norm(level, fit, g, terms, recording).explanations()
        tests.append(cause_test(tried, recording.source))
    warnings, record = norm_notes(level, fit, g, terms), {}
    if terms == 6:
        iteration = product_and_sum(level.means, g)
        record = {"product_and_sum": iteration.record}
        warnings.append(compared_with_iteration(iteration, fit, used.name, g))
    fit = mirrored(fit)
    units = ["1" if ".scale_" in n or ".cross_" in n else "m_s2" for n in fit.names]
    if drift:
        fit, units, words = without_drift(fit, units, used)
        warnings.append(words)
    result = wrap_up(
        NAME,
        verdict_of(tests, determined),
        fit,
        units,
        tests,
        warnings,
        poses,
        recording,
        equation=EQUATION.format(used.name),
        inverse="f = M^-1 (reading - bias)",
        heldout={} if heldout is None else {used.name: heldout},
    )
    return replace(result, own_frame=True, provenance={**result.provenance, **record})


def number_of_terms(terms: int | None, sensor: Sensor) -> int:
    """6 or 9: as asked for, else as the scenario lets cross_axis be adjusted.

    Args:
        terms: asked for; None: nothing was.
        sensor: a triad.

    Raises:
        TiltcalError: it is another number.
    """
    if terms is None:
        return 9 if not sensor.adjustable or "cross_axis" in sensor.adjustable else 6
    if terms not in (6, 9):
        raise TiltcalError(
            f"method {NAME}, option terms", found=str(terms), need="6 or 9", do="correct it"
        )
    return terms


def _require_poses(poses: Poses, terms: int, recording: Recording) -> None:
    """Refuse fewer poses than parameters."""
    if len(poses) >= terms:
        return
    fewer_terms = ", or use --option terms=6" if terms == 9 and len(poses) >= 6 else ""
    raise TiltcalError(
        recording.source,
        found=f"{len(poses)} dwells",
        need=f"at least {terms} for {terms} parameters (12 are better)",
        do=f"record more positions{fewer_terms}",
    )
