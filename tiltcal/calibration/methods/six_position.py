"""S1: poses of known attitude: six positions, and every other set of labelled or table-read poses
(8, 12, 24 positions, tumble).
"""

from collections.abc import Sequence
from functools import partial

import numpy as np

from tiltcal.calibration.methods.common import (
    pick_sensor,
    undetermined_test,
    with_equation,
    wrap_up,
)
from tiltcal.calibration.methods.known_attitude_checks import (
    fixture_rotation,
    known_attitude_tests,
)
from tiltcal.calibration.methods.known_attitude_model import (
    DRIFT,
    Model,
    leave_directions_out,
    solve_about_errors,
    without_drift,
)
from tiltcal.calibration.methods.terms import LINEAR, require_names
from tiltcal.calibration.result import Calibration
from tiltcal.calibration.screen.data import data_tests
from tiltcal.calibration.screen.outliers import outlier_tests
from tiltcal.calibration.validity import verdict_of
from tiltcal.core.errors import TiltcalError
from tiltcal.effects.base import Effect
from tiltcal.recordings.recording import Recording
from tiltcal.recordings.segmentation import Segment
from tiltcal.recordings.static_poses import Poses, find_poses
from tiltcal.recordings.table_columns import other_tables
from tiltcal.setup.sensor import Sensor
from tiltcal.setup.setup import Setup

NAME = "six_position"


def six_position(
    recording: Recording,
    setup: Setup,
    *,
    segments: Sequence[Segment] | None = None,
    sensor: str | None = None,
    terms: Sequence[str] = LINEAR,
) -> Calibration:
    """Bias, scale factor and cross-axis terms from poses whose attitude is known.

    Model: ``reading_i = b_i + (1 + S_i) f_i + sum_j C_ij f_j`` with f = g up; further linear
    effects of the catalogue can be named in ``terms``. Weighted least squares on pose means. With
    ``drift`` among the terms the bias of each channel may drift linearly, ``+ d_i t / T``. The
    drift is a nuisance parameter: it is reported in a warning and not kept; the bias is that at
    the first stamp.

    Args:
        recording: a continuous log; the dwells are found, or given as ``segments``.
        setup: with an accelerometer or inclinometer; attitudes from the table's readout, else from
            labels.
        segments: dwells to use.
        sensor: which, when several fit.
        terms: to estimate.

    Raises:
        TiltcalError: no pose has a known attitude, or a term is unknown.

    Errors:
        A pose error e enters scale as e^2/2 and cross-axis as e. A rotation common to all poses
            (fixture, mounting) is the antisymmetric part of the cross-axis matrix: the two cannot
            be distinguished. K3 is absorbed by the scale factor. A zero of the readout that is
            stated as an uncertain reference is fitted, where it is no such rotation.

    Source: patent CN 113295887 A (docs/sources.md, "Six-position calibration"); docs/physics.md,
    "Six positions".
    """
    require_names(terms, NAME)
    used = pick_sensor(setup, recording, ("accelerometer", "inclinometer"), sensor, NAME)
    live = data_tests(recording, used)

    def turned(where: Setup, errors: tuple[Effect, ...]) -> Poses:
        return _poses_of_known_attitude(recording, where, used, segments, errors)[0]

    poses, warnings = _poses_of_known_attitude(recording, setup, used, segments)
    start, end = float(recording.time[0]), float(recording.time[-1])
    model = Model(setup, terms, start, end - start)
    poses, fit, units = solve_about_errors(poses, model, partial(turned, setup))
    live += outlier_tests(recording, poses)
    stated = segments is not None
    tests = [*known_attitude_tests(poses, model, fit, recording, turned, stated), *live]
    warnings.append(fixture_rotation(fit, used))
    determined = not fit.dropped and fit.dof > 0
    if not determined:
        tests.append(undetermined_test(fit.dropped))
    heldout = leave_directions_out(poses, model) if not fit.dropped else {}
    if DRIFT in terms:
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
        equation="",
        inverse="f by Newton's iteration from M^-1 (reading - bias)",
        heldout=heldout,
    )
    return with_equation(result, used, setup)


def _poses_of_known_attitude(
    recording: Recording,
    setup: Setup,
    sensor: Sensor,
    segments: Sequence[Segment] | None,
    errors: tuple[Effect, ...] = (),
) -> tuple[Poses, list[str]]:
    """The poses whose attitude is known, and a warning where there are others."""
    poses = find_poses(recording, setup, sensor, segments, errors)
    known = np.asarray(~np.isnan(poses.up).any(axis=1))
    if not known.any():
        raise TiltcalError(
            recording.source,
            found=f"{len(poses)} dwells without table readout or direction label",
            need="attitudes: table columns, or labels such as +x, -z, [0, 1, 1]",
            do="label the dwells, or use --method norm" + other_tables(recording, setup.rig.table),
        )
    if known.all():
        return poses.subset(known), []
    unknown = f"{np.sum(~known)} of {len(known)}"
    return poses.subset(known), [f"{unknown} dwells have no known attitude and are not used"]
