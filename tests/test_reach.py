"""Plans stay where the axes may stand: ranges of joints, stated limits, rates."""

import os
from dataclasses import dataclass

import numpy as np
import pytest
from statistics_helpers import rng_of

from tiltcal.core.units import DEG
from tiltcal.design.gym.rigs import AxisLimits, AxisMotion
from tiltcal.design.plan import design
from tiltcal.design.recording_blocks import candidates, within
from tiltcal.design.scenario_problem import clock_of, scenario_problem
from tiltcal.design.search import Effort
from tiltcal.design.steps import steps_of
from tiltcal.design.terms import Wanted
from tiltcal.diagnosis.investigation.discriminating_blocks import come_to
from tiltcal.diagnosis.investigation.next_block import Limits, table_of
from tiltcal.laboratory.scenario import narrowed, parse_scenario
from tiltcal.setup.schedule import build_schedule

RIGS = int(os.environ.get("TILTCAL_RIGS", "100"))  # a release is tried with 500
STEPS = (0.0, 0.5, 1.0)  # deg, of the angles of a plan
QUICK = Effort(starts=1, first=2, then=2, kept=1, rounds=1, trials=2)
BUDGET = 60.0  # s
FROM_OUTSIDE = {
    "placing": ("outer",),
    "dual": ("outer", "inner"),
    "three": ("outer", "middle", "inner"),
}


@dataclass(frozen=True)
class Drawn:
    """A random rig, and what this file itself says its axes may do, deg, (axes,) each."""

    rig: dict
    limits: dict
    low: np.ndarray
    high: np.ndarray
    rate: float

    @property
    def scenario(self):
        """On which plans are made."""
        sensor = {"name": "accel", "kind": "accelerometer", "rate_hz": 5.0}
        text = {"schema": 1, "site": {"gravity_m_s2": 9.8}, "rig": self.rig, "sensor": [sensor]}
        return narrowed(parse_scenario(text), self.limits)

    def holds(self, degrees):
        """Whether all positions are allowed, to a billionth of a degree. degrees: (n, axes)."""
        return (degrees >= self.low - 1e-9).all() and (degrees <= self.high + 1e-9).all()


def ends_of(rng, low=-300.0, high=300.0):
    """Two angles, often far from zero."""
    middle, width = rng.uniform(low, high), rng.choice([2.0, 20.0, 90.0, 300.0])
    return max(low, middle - width / 2), min(high, middle + width / 2)


def drawn(number):
    """The rig of a number: a table, or links with random axes and ranges."""
    rng = rng_of(f"reach {number}")
    if number % 3 == 0:
        table = rng.choice(list(FROM_OUTSIDE))
        names, rig = FROM_OUTSIDE[str(table)], {"table": str(table)}
        ranges = [None] * len(names)
    else:
        axes = int(rng.integers(1, 4))
        names = tuple(f"j{k}" for k in range(axes))
        ranges = [ends_of(rng) if rng.random() < 0.8 else None for _ in names]
        rig = {"link": [_link(rng, names, ranges, k) for k in range(axes)]}
        rig["instrument"] = {"on": names[-1]}
    limits = {}
    for name, ends in zip(names, ranges, strict=True):
        if rng.random() < 0.5:
            limits[name] = ends_of(rng, *(ends or (-300.0, 300.0)))
    every = (-np.inf, np.inf)
    low, high = np.array(
        [
            (max(a, c), min(b, d))
            for (a, b), (c, d) in zip(
                [ends or every for ends in ranges],
                [limits.get(name, every) for name in names],
                strict=True,
            )
        ]
    ).T
    return Drawn(rig, limits, low, high, float(rng.uniform(5, 60)))


def _link(rng, names, ranges, k):
    q = rng.normal(size=4)
    link = {"axis": names[k], "joint": f"joint{k}", "rotation": list(q / np.linalg.norm(q))}
    link["on"] = names[k - 1] if k else ""
    return link | ({} if ranges[k] is None else {"range_deg": list(ranges[k])})


def positions(steps, rig, every=0.05):
    """Angles and rates all along a sequence, deg and deg/s, (n, axes) each."""
    schedule = build_schedule(steps, rig)
    drive = schedule.drive(np.arange(0, schedule.times[1] + every, every))
    jets = [drive.axes[name] for name in rig.axis_names]
    return tuple(np.column_stack([part(j) for j in jets]) / DEG for part in (_x, _v))


def _x(jet):
    return jet.x


def _v(jet):
    return jet.v


@pytest.mark.parametrize("part", range(5))
def test_no_plan_of_any_rig_leaves_the_limits(part):
    kept = 0
    for number in range(part, RIGS, 5):
        rig = drawn(number)
        kept += _designed(rig, STEPS[number // 5 % len(STEPS)]) + _proposed(rig)
        _demanded(rig)
    assert kept > 3 * RIGS / 5  # plans, not refusals


def _designed(rig, step):
    """Poses, moves and the way home of a design, as it is written down."""
    scenario = rig.scenario
    clock = clock_of(scenario, BUDGET, rig.rate, step_deg=step, returns=True)
    wanted = Wanted(("bias",), ())
    problem, _ = scenario_problem(scenario, scenario.sensor[0], wanted, clock)
    plan = design(problem, scenario.rig.kind, effort=QUICK)
    steps = steps_of(plan, np.tile([0.0, 0.0, 1.0], (len(plan.angles), 1)))
    angles, rates = positions(steps, scenario.rig)
    assert rig.holds(angles)
    if step:
        np.testing.assert_allclose(_off_steps(plan.angles / DEG, step), 0, atol=1e-9)
    assert np.abs(rates).max() <= rig.rate * (1 + 1e-6)
    np.testing.assert_allclose(angles[-1], angles[0], atol=1e-6)
    assert plan.forecast.total_s <= BUDGET + 1e-9
    return 1


def _off_steps(degrees, step):
    return degrees - np.round(degrees / step) * step


def _proposed(rig):
    """Blocks, and from where an imagined recording of the first comes."""
    scenario = rig.scenario
    table = table_of(scenario, [], Limits(rate=rig.rate))
    blocks = [block for block in candidates(table) if within(block, table)]
    for block in blocks:
        legs = build_schedule(block.steps, scenario.rig).legs  # straight, from end to end
        assert rig.holds(np.array([(leg.q0 + leg.dq) / DEG for leg in legs]))
        rates = [np.abs(leg.dq).max() / DEG / (leg.t1 - leg.t0 - leg.ramp) for leg in legs]
        assert max(rates) <= rig.rate * (1 + 1e-6)
    sides = dict.fromkeys(scenario.rig.axis_names, 1.0)
    come = come_to(blocks[0], scenario, sides)
    columns = [come.table(name) / DEG for name in scenario.rig.axis_names]
    # its readout has noise of 0.05 arcsec
    assert (np.column_stack(columns) >= rig.low - 1e-3).all()
    assert (np.column_stack(columns) <= rig.high + 1e-3).all()
    return len(blocks)


def _demanded(rig):
    """An agent that asks for the largest rates."""
    scenario, rng = rig.scenario, rng_of(f"agent {rig.rate}")
    rate = {"deg": rig.rate, "mm": 1.0}
    limits = AxisLimits.of(scenario.rig.reach, rate, rate)
    motion = AxisMotion.at_rest(limits, 0.02, 8)
    for k in range(90):
        if k % 30 == 0:
            demand = limits.rate * rng.choice([-1.0, 1.0], motion.position.shape)
        motion.move(demand, np.ones(8, bool))
        assert rig.holds(motion.position / DEG)
        assert np.abs(motion.rate).max() <= rig.rate * DEG * (1 + 1e-9)
