"""The design problem of a scenario: its table's times and limits, and the terms of its sensor."""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from tiltcal.core.errors import TiltcalError
from tiltcal.core.units import DEG
from tiltcal.design.gradient_search import Problem
from tiltcal.design.static_instrument import Still
from tiltcal.design.terms import Wanted, scenario_model
from tiltcal.design.time_budget import LONGEST, SHORTEST, Clock
from tiltcal.laboratory.scenario import Scenario
from tiltcal.setup.sensor import Sensor

USUAL = ("bias", "scale", "cross_axis")  # where the scenario names no terms


def clock_of(
    scenario: Scenario,
    budget_s: float,
    rate_deg_s: float = 20.0,
    settle_s: float = 5.0,
    dwell_s: tuple[float, float] = (SHORTEST, LONGEST),
    angles_deg: Mapping[str, tuple[float, float]] | None = None,
    step_deg: float = 0.0,
    returns: bool = False,
) -> Clock:
    """Speed, times and limits of a scenario's table.

    Args:
        scenario: rig, sensors and effects.
        budget_s: table time.
        rate_deg_s: of moves.
        settle_s: after each.
        dwell_s: shortest and longest reading.
        angles_deg: axis -> lowest and highest angle, in addition to the limits of the rig and the
            ranges of a model's joints; axes without any turn without end.
        step_deg: angles are its multiples; 0: any angle.
        returns: whether the budget has the way back to the start.

    Raises:
        TiltcalError: the table has no such axis, or a value is out of range.
    """
    axes = Still(scenario, budget_s).axes
    reach = scenario.rig.narrowed(angles_deg or {}, {}).reach
    limits = {axis: ends for axis in axes if (ends := reach.limits(axis)) is not None}
    for axis, (low, high) in limits.items():
        if step_deg > 0 and np.ceil(low / step_deg - 1e-9) > np.floor(high / step_deg + 1e-9):
            raise TiltcalError(
                f"design, axis {axis}",
                found=f"no multiple of {step_deg:g} deg from {low:.9g} to {high:.9g} deg",
                need="at least one",
                do="correct --step-deg or the limits",
            )
    start = reach.start[[reach.table.axis_names.index(axis) for axis in axes]] * DEG
    return Clock(
        budget_s,
        rate_deg_s * DEG,
        settle_s,
        *dwell_s,
        tuple(
            (limits[axis][0] * DEG, limits[axis][1] * DEG) if axis in limits else None
            for axis in axes
        ),
        step_deg * DEG,
        tuple(start),
        returns,
    )


def scenario_problem(
    scenario: Scenario, sensor: Sensor, wanted: Wanted, clock: Clock, criterion: str = "both"
) -> tuple[Problem, tuple[str, ...]]:
    """The design problem, and the effects that poses cannot show.

    Args:
        scenario: site, rig and noise.
        sensor: to design for.
        wanted: terms; without terms of interest those of the sensor's adjustable list and of
            [[effect]] tables with fit = true.
        clock: of the table.
        criterion: tilt (or I), D, A, or both.

    Raises:
        TiltcalError: a term is unknown, or asked for by name though poses cannot show it.
    """
    terms = wanted.interest or (
        *sensor.adjustable,
        *(t.id for t in scenario.effect if t.fit and t.sensor in (None, sensor.name)),
    )
    wanted = replace(wanted, interest=terms or USUAL)
    model, unseen = scenario_model(scenario, sensor, wanted, clock.budget)
    return Problem(model, clock, criterion), unseen


def sensor_of(scenario: Scenario, wanted: str | None) -> Sensor:
    """The accelerometer or inclinometer to design for.

    Raises:
        TiltcalError: there is none.
    """
    fitting = [s for s in scenario.sensor if s.is_accelerometer and wanted in (None, s.name)]
    if not fitting:
        raise TiltcalError(
            f"scenario {scenario.name}",
            found=(f"no accelerometer or inclinometer{f' named {wanted}' if wanted else ''}"),
            need="an accelerometer or inclinometer: dwells measure only gravity",
            do="add one, or correct --sensor (a gyro is calibrated by turns)",
        )
    return fitting[0]
