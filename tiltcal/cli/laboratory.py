"""``tiltcal simulate``; and the laboratory that commands hand to whoever simulates."""

import argparse
import sys
from contextlib import nullcontext
from importlib.metadata import entry_points
from pathlib import Path

import numpy as np

from tiltcal.cli.output import print_json, progress_line, require_output
from tiltcal.core.errors import TiltcalError
from tiltcal.core.files import replacing, write_json
from tiltcal.core.progress import Progress, silent
from tiltcal.core.units import DEG
from tiltcal.effects import to_file
from tiltcal.laboratory.laboratory import Laboratory
from tiltcal.laboratory.scenario import Scenario, load_scenario
from tiltcal.recordings.csv_files import write_csv
from tiltcal.recordings.recording import Recording
from tiltcal.recordings.recording_files import read_recording, write_recording


def simulator(progress: Progress = silent) -> Laboratory:
    """The MuJoCo laboratory, by its entry point; long runs by time steps report to ``progress``.

    Raises:
        TiltcalError: it is not installed.
    """
    for entry in entry_points(group="tiltcal.laboratories"):
        if entry.name == "mujoco":
            return entry.load()(progress=lambda done, steps: progress(f"step {done} of {steps}"))
    raise TiltcalError(
        "simulator",
        found="none installed",
        need="the package tiltsim",
        do="install tiltcal with its simulator",
    )


def simulate(args: argparse.Namespace) -> int:
    """Make a recording."""
    require_output(args, "the recording")
    scenario = load_scenario(args.scenario)
    seed = None if args.noise == "off" else scenario.seed if args.seed is None else args.seed
    with progress_line() as progress:
        laboratory = simulator(progress)
        if args.motion:
            recording = laboratory.predict(scenario, read_recording(args.motion), seed)
        else:
            recording = laboratory.record(scenario, seed)
    with replacing(Path(args.truth)) if args.truth else nullcontext() as truth:  # both or none
        if truth is not None:
            write_json(truth, truth_table(scenario, seed))
        _deliver(recording, args)
    return 0


def _deliver(recording: Recording, args: argparse.Namespace) -> None:
    """The recording to its file, or to stdout."""
    if not args.output:
        write_csv(recording, sys.stdout.buffer)
        return
    write_recording(recording, args.output)
    duration = float(np.ptp(recording.time))
    if args.json:
        print_json({"recording": args.output, "rows": len(recording), "duration_s": duration})
    else:
        print(f"{args.output}: {len(recording)} rows, {duration:.6g} s", file=sys.stderr)


def truth_table(scenario: Scenario, seed: int | None) -> dict[str, object]:
    """What was injected, and the true angles and up of each stop."""
    from tiltcal.forward.kinematics import closed_form

    truth: dict[str, object] = {
        "schema": 1,
        "scenario": scenario.name,
        "seed": seed,
        "effects": [to_file(e) for e in scenario.effects],
    }
    if scenario.sequence and scenario.dynamics is None:
        legs = [leg for leg in scenario.schedule.legs if leg.stop >= 0]
        drive = scenario.schedule.drive(np.array([(leg.t0 + leg.t1) / 2 for leg in legs]))
        geometry = [
            e
            for e in scenario.effects
            if e.stage in ("environment", "table", "mount") and not e.random
        ]
        up = closed_form(scenario, drive, geometry).up
        truth["poses"] = [
            {
                "start_s": leg.t0,
                "end_s": leg.t1,
                "label": leg.label,
                "up": up[k].tolist(),
                "readout_deg": {
                    n: float(np.asarray(jet.x)[k] / DEG) for n, jet in drive.axes.items()
                },
            }
            for k, leg in enumerate(legs)
        ]
    return truth
