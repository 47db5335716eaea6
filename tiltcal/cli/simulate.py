"""``tiltcal simulate``."""

from collections.abc import Iterator, Mapping, Sequence
from contextlib import nullcontext
from itertools import combinations
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from cyclopts import Parameter

from tiltcal.api.simulating import pieces_of, seed_used, truth_table
from tiltcal.cli.options import DEFAULT_BUDGET, SEED, Json, MoreBudget, ScenarioFile
from tiltcal.cli.output import print_json, print_note, progress_line, require_output, stdout_bytes
from tiltcal.core.errors import TiltcalError
from tiltcal.core.files import replacing, write_json
from tiltcal.effects.base import Effect
from tiltcal.effects.learned import Learned
from tiltcal.laboratory.scenario import load_scenario
from tiltcal.recordings.csv_files import csv_writer
from tiltcal.recordings.pieces import writing
from tiltcal.recordings.recording import Recording
from tiltcal.recordings.recording_files import read_recording


def simulate(
    scenario_file: ScenarioFile,
    /,
    *,
    output: Annotated[
        Path | None, Parameter(alias="-o", help="File of the recording; stdout if not given.")
    ] = None,
    motion: Annotated[
        Path | None,
        Parameter(help="Replay the time stamps and the table readout of this recording."),
    ] = None,
    noise: Annotated[
        Literal["on", "off"],
        Parameter(help="off: without random effects and quantisation."),
    ] = "on",
    seed: Annotated[
        int | None,
        SEED,
        Parameter(help="Seed of the random effects; the scenario's if not given."),
    ] = None,
    truth: Annotated[
        Path | None, Parameter(help="File for the injected values and true attitudes, JSON.")
    ] = None,
    budget: MoreBudget = DEFAULT_BUDGET,
    as_json: Json = False,
) -> int:
    """Simulate a recording of a scenario in MuJoCo.

    The suffix of -o sets the format: .csv, .parquet or .npz. Without -o, CSV goes
    to stdout. The recording contains no truth; --truth writes it to a separate
    file.

      tiltcal simulate bench.toml -o run.csv --seed 7 --truth truth.json
      tiltcal simulate model.toml --motion real.csv --noise off -o predicted.csv
    """
    budget.apply()
    require_output("simulate", output, as_json, "the recording")
    _require_different({"-o": output, "--motion": motion, "--truth": truth})
    scenario = load_scenario(scenario_file)
    used = seed_used(scenario, noise == "on", seed)
    replayed = read_recording(motion) if motion else None
    with progress_line() as progress:
        pieces = pieces_of(scenario, replayed, used, progress)
        with replacing(truth) if truth else nullcontext() as truth_file:  # both files or none
            if truth_file is not None:
                write_json(truth_file, truth_table(scenario, used))
            _write(pieces, output, as_json)
    if replayed is not None and replayed.temperature() is None:
        _note_temperature(scenario.effects, replayed.source)
    return 0


def _note_temperature(effects: Sequence[Effect], motion: str) -> None:
    """Note which effects a recording without temperatures leaves out."""
    learned = [e for e in effects if isinstance(e, Learned)]
    curves = [e for e in learned if "temperature" in (e.coordinate, e.times)]
    following = [e for e in effects if e.needs == "temperature"] + curves
    if following:
        ids = ", ".join(dict.fromkeys(e.id for e in following))
        print_note(f"{motion}: no column temperature_degC, so nothing is predicted of {ids}")


def _require_different(files: Mapping[str, Path | None]) -> None:
    """Refuse options that name one file: one would overwrite the other."""
    named = [(option, path) for option, path in files.items() if path is not None]
    for (one, path), (other, second) in combinations(named, 2):
        if path.absolute() == second.absolute():
            raise TiltcalError(
                f"simulate {one} {path}",
                found=f"the file of {other} as well",
                need="a file for each",
                do=f"give {one} another name",
            )


def _write(pieces: Iterator[Recording], output: Path | None, as_json: bool) -> None:
    """Write the pieces of a recording to its file or to stdout."""
    if output is None:
        with stdout_bytes() as out, csv_writer(out) as write:
            for piece in pieces:
                write(piece)
        return
    rows, first, last = 0, np.inf, -np.inf
    with writing(output) as write:
        for piece in pieces:
            write(piece)
            rows += len(piece)
            first, last = min(first, piece.time.min()), max(last, piece.time.max())
    if as_json:
        print_json({"recording": str(output), "rows": rows, "duration_s": float(last - first)})
    else:
        print_note(f"{output}: {rows} rows, {last - first:.6g} s")
