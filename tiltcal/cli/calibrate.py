"""``tiltcal calibrate``."""

import tomllib
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any

from cyclopts import Parameter

from tiltcal.api.calibrating import estimate, estimate_for_certificate, one_recording
from tiltcal.calibration.result import Calibration
from tiltcal.calibration.screen.causes import SCENARIO_FILE
from tiltcal.cli.certificate import (
    DccFile,
    ReportFile,
    Statements,
    require_statements,
    write_reports,
)
from tiltcal.cli.options import DEFAULT_BUDGET, DescribedBy, Json, MoreBudget, SegmentsFile
from tiltcal.cli.output import paragraph, print_json, print_table, progress_line
from tiltcal.core.errors import TiltcalError
from tiltcal.laboratory.scenario import load_scenario
from tiltcal.recordings.segment_files import read_segments
from tiltcal.recordings.span_means import read_averaged
from tiltcal.report.stated import NOTHING_STATED
from tiltcal.report.tables import BUDGET_COLUMNS, budget_rows, parameter_rows
from tiltcal.validation.uncertainty_budget import UncertaintyBudget

BUDGET_HEADER = ("parameter", "source", "type", *BUDGET_COLUMNS[3:])


def calibrate(
    recording_file: Annotated[
        Path, Parameter("REC", help="Recording, or a CSV table of means with sigma columns.")
    ],
    /,
    *more: Annotated[Path, Parameter("REC", help="Further recordings of the same set-up.")],
    scenario: DescribedBy,
    method: Annotated[
        str, Parameter(help="Name of a method, or package.module:function of your own.")
    ],
    option: Annotated[
        tuple[str, ...], Parameter(help="KEY=VALUE for the method; may be repeated.")
    ] = (),
    segments: SegmentsFile = None,
    budget: Annotated[
        bool,
        Parameter(
            help="Add an uncertainty budget: the [[budget]] sources of the scenario, or defaults."
        ),
    ] = False,
    output: Annotated[
        Path | None, Parameter(alias="-o", help="File of the calibration, JSON.")
    ] = None,
    report: ReportFile = None,
    dcc: DccFile = None,
    stated: Statements = NOTHING_STATED,
    allowed: MoreBudget = DEFAULT_BUDGET,
    as_json: Json = False,
) -> int:
    """Estimate parameters with covariance, tests and a verdict.

    `tiltcal methods` lists the methods. Your own function is called with the
    Recording and the Setup and returns a Calibration.

      tiltcal calibrate run.csv --scenario bench.toml --method norm -o CAL.json
      tiltcal calibrate run.csv --scenario bench.toml --method norm --option terms=9
      tiltcal calibrate mon.csv tue.csv --scenario bench.toml --method six_position

    A table of means has one row a pose: label or table angles, the sensor's
    columns, and their standard deviations as accel_sigma_m_s2.

    --report and --dcc write a certificate, with the uncertainty budget.

    Exit status: 0 good; 1 suspect or cannot_tell; 2 unusable input.
    """
    allowed.apply()
    require_statements(stated, dcc)
    described = load_scenario(scenario)
    with progress_line() as progress:
        read = [read_averaged(file, progress) for file in (recording_file, *more)]
        recording = one_recording(described, read)
        options = parse_options(option)
        if segments:
            options["segments"] = read_segments(segments, recording)
        data = (method, recording, described, options)
        progress(f"calibrating by {method}")
        if budget or (report is None and dcc is None):
            calibration, found = estimate(*data, budget)
        else:
            calibration, found = estimate_for_certificate(*data)
    calibration = _with_path(calibration, scenario)
    if output:
        calibration.save(output)
    dwells = options.get("segments")
    write_reports(calibration, recording, found, dwells, stated, report, dcc)
    if as_json:
        print_json(calibration.to_json() | ({"budget": found.to_json()} if found else {}))
    else:
        print_calibration(calibration)
        if found is not None and budget:
            print_budget(found, calibration)
    return 0 if calibration.verdict == "good" else 1


def _with_path(calibration: Calibration, scenario: Path) -> Calibration:
    """The calibration with the path of its scenario in the commands that its tests advise."""
    tests = [
        replace(t, statement=t.statement.replace(f" {SCENARIO_FILE}`", f" {scenario}`"))
        for t in calibration.tests
    ]
    return replace(calibration, tests=tests)


def parse_options(arguments: tuple[str, ...]) -> dict[str, Any]:
    """``("terms=9", "estimator=median")`` -> values as TOML reads them, otherwise text."""
    options: dict[str, Any] = {}
    for argument in arguments:
        key, equals, value = argument.partition("=")
        if not equals or not key:
            raise TiltcalError(
                f"--option {argument}",
                found="no KEY=VALUE",
                need="for example terms=9",
                do="correct it",
            )
        if key == "segments":
            raise TiltcalError(
                f"--option {argument}",
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
    """Print parameters, tests and verdict."""
    print_table(
        ["parameter", "value", "sigma", "unit", "95 % interval"],
        [
            [r["name"], r["value"], r["sigma"], r["unit"], r["interval"]]
            for r in parameter_rows(c, {})
        ],
        spare=["95 % interval"],
    )
    tests = [[t.name, "passed" if t.passed else "FAILED", t.statement] for t in c.tests]
    if tests:
        print_table(["test", "", "statement"], tests)
    for name, (rms, unit) in c.heldout_shown.items():
        paragraph(f"held-out residual of {name}: {rms:.4g} {unit} (whole directions held out)")
    for w in c.warnings:
        paragraph(f"note: {w}")
    paragraph(
        f"{c.method}: {len(c.poses)} dwells, chi2/dof {c.chi2_per_dof:.3g} with {c.dof} degrees of"
        f" freedom; verdict: {c.verdict}{'' if c.tests else ' (no test of its own)'}"
    )


def print_budget(budget: UncertaintyBudget, calibration: Calibration) -> None:
    """Print the significant lines of each parameter and the combined uncertainty."""
    print_table(
        BUDGET_HEADER,
        [[r[key] for key in BUDGET_COLUMNS] for r in budget_rows(budget, calibration)],
        title="uncertainty budget (GUM); lines below 1 % of the combined uncertainty are omitted",
        spare=["type", "distribution", "sensitivity", "size", "standard"],
    )
