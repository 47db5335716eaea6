"""``tiltcal calibrate``, ``correct``, ``check``, ``segments``."""

import argparse
import csv
import sys
import tomllib
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Any, TextIO

from tiltcal.calibration.methods.registry import calibrate as run_method
from tiltcal.calibration.result import Calibration, load_calibration
from tiltcal.cli.output import print_json, print_table, require_output
from tiltcal.core.errors import TiltcalError
from tiltcal.core.files import replacing, require_file
from tiltcal.core.units import ARCSEC
from tiltcal.laboratory.scenario import load_scenario
from tiltcal.recordings.recording import Recording
from tiltcal.recordings.recording_files import read_recording
from tiltcal.recordings.segmentation import Segment, dwells, find_segments, majority
from tiltcal.report.budget import BUDGET_COLUMNS, budget_rows
from tiltcal.report.html import parameter_rows
from tiltcal.validation.uncertainty_budget import Budget, make_budget


def calibrate(args: argparse.Namespace) -> int:
    """Recover parameters."""
    scenario = load_scenario(args.scenario)
    recording = read_recording(args.recording).require_increasing()
    options = parse_options(args.option)
    if args.segments:
        options["segments"] = read_segments(Path(args.segments), recording)
    budget: Budget | None = None
    if args.budget:
        calibration, budget = make_budget(
            args.method, recording, scenario, scenario.budget, **options
        )
    else:
        calibration = run_method(args.method, recording, scenario, **options)
    strange = recording.unknown(scenario.sensor)
    if strange:
        note = "columns that are no sensor of the scenario are not used: " + ", ".join(strange)
        calibration = replace(calibration, warnings=[*calibration.warnings, note])
    if args.output:
        calibration.save(Path(args.output))
    if args.json:
        print_json(calibration.to_json() | ({"budget": budget.to_json()} if budget else {}))
    else:
        print_calibration(calibration)
        if budget is not None:
            print_budget(budget)
    return 0 if calibration.verdict == "good" else 1


def parse_options(words: list[str]) -> dict[str, Any]:
    """``["terms=9", "estimator=median"]`` -> values as TOML would read them, else text."""
    options: dict[str, Any] = {}
    for word in words:
        key, equals, value = word.partition("=")
        if not equals or not key:
            raise TiltcalError(
                f"--option {word}",
                found="no KEY=VALUE",
                need="for example terms=9",
                do="correct it",
            )
        if key == "segments":
            raise TiltcalError(
                f"--option {word}",
                found="segments",
                need="a file of them",
                do="use --segments SEG.csv",
            )
        try:
            options[key] = tomllib.loads(f"value = {value}")["value"]
        except tomllib.TOMLDecodeError:
            options[key] = value
    return options


def print_calibration(c: Calibration) -> None:
    """Parameters, tests and verdict for people."""
    print_table(
        ["parameter", "value", "sigma", "unit", "95 % interval"],
        [
            [r["name"], r["value"], r["sigma"], r["unit"], r["interval"]]
            for r in parameter_rows(c, {})
        ],
    )
    print_table(
        ["test", "", "in words"],
        [[t.name, "passed" if t.passed else "FAILED", t.statement] for t in c.tests],
    )
    for name, rms in c.heldout_rms.items():
        print(f"held-out residual of {name}: {rms:.4g} (SI, whole directions left out)")
    for w in c.warnings:
        print(f"note: {w}")
    print(
        f"{c.method}: {len(c.poses)} dwells, chi2/dof {c.chi2_per_dof:.3g} with {c.dof} degrees of"
        f" freedom; verdict: {c.verdict}"
    )


def print_budget(budget: Budget) -> None:
    """Every line that matters of every parameter, and what they make together."""
    print_table(
        [
            "parameter",
            "source",
            "type",
            "size",
            "distribution",
            "standard",
            "sensitivity",
            "contribution",
            "unit",
        ],
        [[r[key] for key in BUDGET_COLUMNS] for r in budget_rows(budget)],
        title="uncertainty budget (GUM); lines below 1 % of the combined uncertainty are left out",
    )


def correct(args: argparse.Namespace) -> int:
    """Correct a recording."""
    from tiltcal.calibration.correction import correct_stream

    require_output(args, "the corrected recording")
    calibration = load_calibration(args.calibration)
    if not args.output:
        done = correct_stream(Path(args.recording), calibration, sys.stdout.buffer)
        _tell(done.notes)
        return 0
    with replacing(Path(args.output)) as temporary, temporary.open("wb") as out:
        done = correct_stream(Path(args.recording), calibration, out)
    _tell(done.notes)
    if args.json:
        print_json({"output": args.output, "rows": done.rows, "notes": done.notes})
    else:
        print(f"{args.output}: {done.rows} rows corrected", file=sys.stderr)
    return 0


def _tell(notes: list[str]) -> None:
    for note in notes:
        print(f"note: {note}", file=sys.stderr)


def check(args: argparse.Namespace) -> int:
    """Judge a calibration on another recording."""
    from tiltcal.validation.cross_check import check as judge

    recording = read_recording(args.recording).require_increasing()
    segments = read_segments(Path(args.segments), recording) if args.segments else None
    limit = None if args.limit_arcsec is None else args.limit_arcsec * ARCSEC
    result = judge(
        load_calibration(args.calibration), recording, load_scenario(args.scenario), limit, segments
    )
    if args.json:
        print_json(
            {
                "accepted": result.accepted,
                "judged_by": result.judged_by,
                "rms_arcsec": result.rms / ARCSEC,
                "worst_arcsec": result.worst / ARCSEC,
                "expected_arcsec": result.expected / ARCSEC,
                "poses": [
                    {"start_s": a, "end_s": b, "error_arcsec": float(e / ARCSEC)}
                    for (a, b), e in zip(result.spans, result.poses, strict=False)
                ],
                "tests": [vars(t) for t in result.tests],
                "statement": result.statement,
            }
        )
    else:
        print(result.statement)
        for t in result.tests:
            print(
                f"{t.name}: {'yes' if t.passed else 'NO'} (chi2 {t.statistic:.4g}, {t.dof} degrees"
                f" of freedom, p {t.p_value:.2g})"
            )
        print("accepted" if result.accepted else "not accepted")
    return 0 if result.accepted else 1


def segments(args: argparse.Namespace) -> int:
    """Find dwells and moves."""
    if not 0 < args.window < float("inf"):
        raise TiltcalError(
            "--window",
            found=f"{args.window:g} s",
            need="a time above zero",
            do="leave it out, or try 0.5",
        )
    found = find_segments(read_recording(args.recording), window=args.window)
    if args.output:
        with (
            replacing(Path(args.output)) as temporary,
            temporary.open("w", newline="", encoding="utf-8") as out,
        ):
            write_segments(found, out)
    if args.json:
        print_json([vars(s) for s in found])
    elif args.output:
        still = len(dwells(found))
        print(f"{args.output}: {still} dwells, {len(found) - still} moves", file=sys.stderr)
    else:
        write_segments(found, sys.stdout)
    return 0


def write_segments(found: list[Segment], out: TextIO) -> None:
    """Segments as CSV: start_s, end_s, kind, label."""
    rows = [[repr(s.start), repr(s.end), s.kind, s.label or ""] for s in found]
    csv.writer(out, lineterminator="\n").writerows([["start_s", "end_s", "kind", "label"], *rows])


def read_segments(path: Path, recording: Recording) -> list[Segment]:
    """An edited list of segments: start_s, end_s, kind and an optional label.

    Raises:
        TiltcalError: a column is missing, a cell is wrong, or two dwells overlap.
    """
    with require_file(path, "segments").open(
        newline="", encoding="utf-8-sig", errors="replace"
    ) as lines:
        reader = csv.DictReader(lines)
        missing = {"start_s", "end_s"} - set(reader.fieldnames or ())
        if missing:
            raise TiltcalError(
                f"segments {path.name}",
                found="no column " + ", ".join(sorted(missing)),
                need="start_s, end_s, kind, label",
                do="start from `tiltcal segments -o`",
            )
        found = [
            _segment(row, number, path.name, recording)
            for number, row in enumerate(reader, start=2)
        ]
    for before, after in pairwise(sorted(dwells(found), key=lambda s: s.start)):
        if after.first < before.last:
            raise TiltcalError(
                f"segments {path.name}",
                found=f"dwells that overlap from {after.start:g} to {before.end:g} s",
                need="each sample in one dwell",
                do="correct their times",
            )
    return found


def _segment(row: dict[str, str], line: int, source: str, recording: Recording) -> Segment:
    import numpy as np

    kind = (row.get("kind") or "dwell").strip()
    try:
        start, end = float(row["start_s"]), float(row["end_s"])
    except (TypeError, ValueError) as error:
        raise TiltcalError(
            f"segments {source}, line {line}",
            found=str(error),
            need="two times in s",
            do="correct that line",
        ) from error
    if kind not in ("dwell", "move") or not end >= start:  # a move may be one sample
        raise TiltcalError(
            f"segments {source}, line {line}",
            found=f"{kind} from {start:g} to {end:g} s",
            need="dwell or move, end after start",
            do="correct that line",
        )
    first, last = (
        int(i) for i in np.searchsorted(recording.time, [start, np.nextafter(end, np.inf)])
    )
    if last == first:
        raise TiltcalError(
            f"segments {source}, line {line}",
            found=f"no sample from {start:g} to {end:g} s",
            need=f"times within the recording, {recording.time[0]:g} to {recording.time[-1]:g} s",
            do="correct that line",
        )
    label = (row.get("label") or "").strip() or majority(recording, first, last)
    return Segment(start, end, first, last, kind, label)
