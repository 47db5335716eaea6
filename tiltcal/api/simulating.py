"""Simulating: the MuJoCo laboratory, recordings of a scenario, and their truth."""

from collections.abc import Callable, Iterator, Mapping
from importlib.metadata import entry_points

import numpy as np

from tiltcal.core.errors import TiltcalError
from tiltcal.core.progress import Progress, Rate, report_pieces, silent
from tiltcal.effects import to_file
from tiltcal.forward.kinematics import closed_form
from tiltcal.laboratory.laboratory import Laboratory, SimulatedLaboratory
from tiltcal.laboratory.scenario import Scenario
from tiltcal.recordings.recording import Recording
from tiltcal.setup.tables import Table

MOST_ROWS = 1e15  # of which progress is told
STAGES = ("environment", "table", "mount")  # of the effects that change the true attitude


def simulator(progress: Progress = silent) -> Laboratory:
    """The MuJoCo laboratory, found by its entry point; time-stepped runs report to ``progress``.

    Raises:
        TiltcalError: it is not installed.
    """
    for entry in entry_points(group="tiltcal.laboratories"):
        if entry.name == "mujoco":
            return entry.load()(progress=_in_steps(progress))
    raise TiltcalError(
        "simulator",
        found="none installed",
        need="the package tiltsim",
        do="install tiltcal with its simulator",
    )


def _in_steps(progress: Progress) -> Callable[[int, int], None]:
    """Report the steps done, and the total; fewer than before begin another run."""
    rate, before = Rate(0), 0

    def report(done: int, steps: int) -> None:
        nonlocal rate, before
        if rate.made + before >= done or not before:
            rate, before = Rate(steps, "steps"), done
        progress(rate.after(done - before, before))

    return report


def seed_used(scenario: Scenario, noise: bool, seed: int | None) -> int | None:
    """The seed of a simulation: the given one or the scenario's; None without noise."""
    if not noise:
        return None
    return scenario.seed if seed is None else seed


def pieces_of(
    scenario: Scenario, motion: Recording | None, seed: int | None, progress: Progress = silent
) -> Iterator[Recording]:
    """A recording of the scenario, or what it predicts of another one's motion, piece by piece.

    Args:
        scenario: the model.
        motion: recording with the stamps and the readout; None: the scenario's own sequence.
        seed: of the random effects; None: without them and without quantisation.
        progress: receives what is being done.
    """
    laboratory = simulator(progress)
    if motion is not None:
        return iter([laboratory.predict(scenario, motion, seed)])
    if isinstance(laboratory, SimulatedLaboratory):
        pieces = laboratory.record_pieces(scenario, seed)
        return report_pieces(pieces, _rows_of(scenario), progress)
    return iter([laboratory.record(scenario, seed)])


def _rows_of(scenario: Scenario) -> int:
    """About how many rows a scenario's sequence has; 0 where time steps make it, or a hand."""
    if not scenario.sequence or scenario.dynamics is not None:
        return 0
    start, end = scenario.schedule.times
    rows = (end - start) * max((s.rate_hz for s in scenario.sensor), default=0.0)
    return int(min(rows, MOST_ROWS))


def truth_table(scenario: Scenario, seed: int | None) -> dict[str, object]:
    """The injected effects; for each stop the true table angles and the true up direction."""
    truth: dict[str, object] = {
        "schema": 1,
        "scenario": scenario.name,
        "seed": seed,
        "effects": [to_file(e) for e in scenario.effects],
    }
    if scenario.sequence and scenario.dynamics is None:
        truth["poses"] = _true_poses(scenario)
    return truth


def _readout(table: Table, positions: Mapping[str, float]) -> dict[str, dict[str, float]]:
    """Places of the axes, rad or m, as ``readout_<unit>`` by axis."""
    found: dict[str, dict[str, float]] = {"readout_deg": {}}
    for name, position in positions.items():
        of_unit = found.setdefault(f"readout_{table.unit(name)}", {})
        of_unit[name] = float(position / table.size(name))
    return found


def _true_poses(scenario: Scenario) -> list[dict[str, object]]:
    legs = [leg for leg in scenario.schedule.legs if leg.stop >= 0]
    drive = scenario.schedule.drive(np.array([(leg.t0 + leg.t1) / 2 for leg in legs]))
    geometry = [e for e in scenario.effects if e.stage in STAGES and not e.random]
    up = closed_form(scenario, drive, geometry).up
    return [
        {
            "start_s": leg.t0,
            "end_s": leg.t1,
            "label": leg.label,
            "up": up[k].tolist(),
            **_readout(scenario.rig.kind, {n: np.asarray(j.x)[k] for n, j in drive.axes.items()}),
        }
        for k, leg in enumerate(legs)
    ]
