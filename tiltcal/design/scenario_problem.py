"""The design problem of a scenario: its table's times and limits, and the terms of its sensor."""

from collections.abc import Mapping
from dataclasses import replace

from tiltcal.core.errors import TiltcalError, one_of
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
) -> Clock:
    """Speed, times and limits of a scenario's table.

    Args:
        scenario: rig, sensors and effects.
        budget_s: table time.
        rate_deg_s: of moves.
        settle_s: after each.
        dwell_s: shortest and longest reading.
        angles_deg: axis -> lowest and highest angle; axes that are not named have the range of
            their joint in a user's own model, and zero, or turn without end.
        step_deg: angles are its multiples; 0: any angle.

    Raises:
        TiltcalError: the table has no such axis, or a value is out of range.
    """
    axes = Still(scenario, budget_s).axes
    # every run starts with all axes at zero
    ranges = {
        axis: (min(low, 0.0), max(high, 0.0))
        for axis, (low, high) in scenario.rig.ranges.items()
        if axis in axes
    }
    stated = ranges | dict(angles_deg or {})
    limits = {
        one_of(axis, axes, "design, allowed angles", "axis"): (low * DEG, high * DEG)
        for axis, (low, high) in stated.items()
    }
    return Clock(
        budget_s,
        rate_deg_s * DEG,
        settle_s,
        *dwell_s,
        tuple(limits.get(name) for name in axes),
        step_deg * DEG,
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
