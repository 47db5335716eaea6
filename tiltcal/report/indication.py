"""Error of indication of each axis against its inclination, before and after calibration, and how
far repeated poses agree.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from tiltcal.calibration.result import Calibration
from tiltcal.core.arrays import Array
from tiltcal.core.units import ARCSEC, COLUMN_UNITS, DEG, G0, unit_sign
from tiltcal.effects.sense import Sense
from tiltcal.recordings.static_poses import group_directions
from tiltcal.report.certificate_tables import rounded
from tiltcal.report.plots import Plot, Trace, axes, colour, line, points
from tiltcal.report.pose_residuals import PoseRow, is_force
from tiltcal.setup.sensor import Sensor
from tiltcal.setup.setup import Setup
from tiltcal.validation.uncertainty_budget import COVERAGE

ROWS = 9  # of the table of an axis; of more poses evenly chosen inclinations
CURVE = np.linspace(-90, 90, 61)  # deg, of the curve by the model
TABULATED = np.linspace(-90, 90, 7)  # deg, without poses
ONE_DIRECTION = 1 * DEG  # poses within it are visits of one; their own readouts are taken off


@dataclass(frozen=True)
class Indication:
    """One axis.

    Args:
        axis: of the channel.
        unit: of the errors, as printed.
        angle: inclination of the axis above the horizontal, deg, (n,).
        before: error of indication as it reads, (n,).
        after: of the corrected readings, (n,); None where no pose was measured.
        U: expanded uncertainty of the correction (k = 2), (n,).
        curve: inclination, deg, error before by the model, and U, (3, m).
    """

    axis: str
    unit: str
    angle: Array
    before: Array
    after: Array | None
    U: Array
    curve: Array

    @property
    def rows(self) -> list[tuple[str, str, str, str]]:
        """Inclination, error before, after, and U as text."""
        order = np.argsort(self.angle, kind="stable")
        shown = order[np.unique(np.linspace(0, len(order) - 1, ROWS).round().astype(int))]
        return [
            (
                f"{round(self.angle[k], 3) + 0.0:.3f}",
                rounded(self.before[k], self.U[k])[0],
                "-" if self.after is None else rounded(self.after[k], self.U[k])[0],
                rounded(0.0, self.U[k])[1],
            )
            for k in shown
        ]


@dataclass(frozen=True)
class _Scale:
    """How an error of a sensor's force is shown: as it is, or as one of an inclinometer's angle.

    Args:
        unit: as printed.
        factor: from m/s2, or from rad.
        gravity: m/s2, of an angle; None: a force is shown.
    """

    unit: str
    factor: float
    gravity: float | None

    def error(self, force: Array, delta: Array) -> Array:
        """The error in its unit. force, delta: along the axis, m/s2, (n,) each."""
        if self.gravity is None:
            return delta * self.factor
        both = np.clip(np.array([force + delta, force]) / self.gravity, -1, 1)
        return np.asarray(np.subtract(*np.arcsin(both)) * self.factor)

    def spread(self, force: Array, sigma: Array) -> Array:
        """The same of an uncertainty: half of what plus and minus make. Both (n,)."""
        return (self.error(force, sigma) - self.error(force, -sigma)) / 2


def _scale(calibration: Calibration, sensor: Sensor, axis: str, gravity: float) -> _Scale:
    """Arcsec where the user's columns are angles, else the unit in which the bias is shown."""
    column = COLUMN_UNITS.get(calibration.provenance.get("columns", {}).get(sensor.name, ""))
    if column is not None and column.quantity == "angle":
        return _Scale("arcsec", 1 / ARCSEC, gravity)
    factor, unit = calibration.shown_in(f"{sensor.name}.bias_{axis}", "m_s2")
    return _Scale(unit_sign(unit), factor, None)


def indications(
    calibration: Calibration, setup: Setup, poses: Sequence[PoseRow]
) -> list[Indication]:
    """The error of indication of each axis; none where the result is not a sensor's force.

    Args:
        calibration: of an accelerometer or inclinometer.
        setup: of the recording.
        poses: measured ones; without any the model alone.
    """
    if not is_force(calibration, setup):
        return []
    sensor, g = setup.named(calibration.sensors()[0]), setup.site.gravity
    known = [p for p in poses if p.up is not None and set(sensor.axes) <= set(p.residuals)]
    found = []
    for k, axis in enumerate(sensor.axes):
        scale, i = _scale(calibration, sensor, axis, g), sensor.axis_indices[k]
        reach = max((abs(p.inclination(i)) for p in known), default=90.0)
        curve = CURVE * max(reach, 1.0) / 90
        along = _model(calibration, setup, sensor, k, _turned(i, curve))
        drawn = np.array([curve, scale.error(*along[:2]), scale.spread(along[0], along[2])])
        up = np.array([p.up for p in known]) if known else _turned(i, TABULATED)
        force, error, spread = _model(calibration, setup, sensor, k, up)
        angle = np.degrees(np.arcsin(np.clip(up[:, i], -1, 1)))
        U, after = scale.spread(force, spread), None
        if known:
            error = np.array([p.uncorrected[axis] for p in known]) * 1e-6 * G0
            left = np.array([p.residuals[axis] for p in known]) * 1e-6 * G0
            after = scale.error(force, left)
        before = scale.error(force, error)
        found.append(Indication(axis, scale.unit, angle, before, after, U, drawn))
    return found


def _turned(i: int, angle: Array) -> Array:
    """Up in the body frame with the axis i inclined towards it, deg, (n, 3)."""
    up = np.zeros((len(angle), 3))
    up[:, i], up[:, 0 if i == 2 else 2] = np.sin(angle * DEG), np.cos(angle * DEG)
    return up


def _model(
    calibration: Calibration, setup: Setup, sensor: Sensor, channel: int, up: Array
) -> tuple[Array, Array, Array]:
    """Force along a channel, error of its reading by the model, and U of that, m/s2, (n,) each.
    up: in the body frame, (n, 3).
    """
    g = setup.site.gravity
    model = calibration.with_assumed.instrument((sensor,), g)
    sense = Sense.at_rest(sensor, g, g * up)
    ideal = sense.true_input()[:, channel]
    J = model.sensitivity(sensor, sense)[:, :, channel]
    variance = np.einsum("pn,pq,qn->n", J, model.covariance, J)
    error = model.predict(sensor, sense)[:, channel] - ideal
    return ideal, error, COVERAGE * np.sqrt(np.maximum(variance, 0.0))


def indication_plots(found: Sequence[Indication]) -> list[Plot]:
    """The error of indication over the inclination: before, and after with U."""
    if not found:
        return []
    unit, title = found[0].unit, "inclination of the axis, °"
    before: list[Trace] = []
    after: list[Trace] = []
    for k, one in enumerate(found):
        angle, error, U = one.curve
        before.append(line(angle, error, one.axis, k))
        if one.after is not None:
            before.append(points(one.angle, one.before, one.axis, k, showlegend=False))
            after.append(points(one.angle, one.after, one.axis, k))
        band = {"showlegend": False, "line": {"color": colour(k), "width": 1, "dash": "dot"}}
        after += [line(angle, U, one.axis, k, **band), line(angle, -U, one.axis, k, **band)]
    return [
        Plot(
            before,
            "Before: lines by the model, points as measured.",
            "Error of indication before calibration over the inclination of each axis",
            axes(title, f"error, {unit}", showlegend=True),
            height=180,
        ),
        Plot(
            after,
            "After: points as measured; dotted: U (k = 2) of the correction.",
            "Error of indication after calibration over the inclination of each axis, and U",
            axes(title, f"error, {unit}", showlegend=found[0].after is not None),
            height=180,
        ),
    ]


def repeatability(found: Sequence[Indication], poses: Sequence[PoseRow]) -> str:
    """How far repeated poses agree, as a sentence; empty where no pose was measured.

    The standard deviation of one visit about the mean of its direction, pooled over the directions
    that were visited more than once.
    """
    known = [p for p in poses if p.up is not None]
    if not found or not known or found[0].after is None:
        return ""
    group = group_directions(np.array([p.up for p in known]), ONE_DIRECTION)
    visits = np.bincount(group)
    dof = int(np.sum(visits - 1))
    if not dof:
        return "No pose was repeated: the repeatability was not measured."
    parts = []
    for one in found:
        assert one.after is not None
        mean = np.bincount(group, one.after) / visits
        spread = np.sqrt(np.sum((one.after - mean[group]) ** 2) / dof)
        parts.append(f"{one.axis} {spread:.2g} {one.unit}")
    several = int(np.sum(visits > 1))
    return (
        f"Repeatability (standard deviation of one visit): {', '.join(parts)}; {several}"
        f" direction{'s' if several > 1 else ''} visited {visits[visits > 1].min()} to"
        f" {visits.max()} times, {dof} degrees of freedom."
    )
