"""``tiltcal diagnose``."""

from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from tiltcal.api.diagnosing import explain, load_nominal_scenario, results_json, write_results
from tiltcal.cli.options import DEFAULT_BUDGET, DescribedBy, Json, MoreBudget
from tiltcal.cli.output import paragraph, print_json, progress_line
from tiltcal.core.files import claimed
from tiltcal.diagnosis.diagnose import read_for_diagnosis, read_static


def diagnose(
    recordings: Annotated[
        tuple[Path, ...], Parameter("REC", help="Recordings of the same set-up.")
    ],
    /,
    *,
    scenario: DescribedBy,
    static: Annotated[
        Path | None, Parameter(help="Recording at rest to estimate the noise from.")
    ] = None,
    check: Annotated[
        bool, Parameter(help="Exit with status 1 unless the verdict is match.")
    ] = False,
    output: Annotated[Path | None, Parameter(alias="-o", help="Folder for the results.")] = None,
    allowed: MoreBudget = DEFAULT_BUDGET,
    as_json: Json = False,
) -> int:
    """Locate, name and model physics that the scenario leaves out.

    Writes diagnosis.json, amended.toml and report.html to the folder of -o.
    Several recordings of the same set-up are explained together. Data faults
    (time going back, repeated or frozen samples) are reported as findings.

      tiltcal diagnose run.csv --scenario bench.toml -o out
      tiltcal diagnose run.csv --scenario out/amended.toml --check
    """
    allowed.apply()
    nominal = load_nominal_scenario(scenario)
    with claimed(output):
        with progress_line() as progress:
            data = [read_for_diagnosis(path, nominal, progress) for path in recordings]
            at_rest = read_static(static) if static else None
            found = explain(nominal, data, at_rest, progress)
        if output:
            write_results(found, output, nominal, found.recordings, recordings)
    if as_json:
        print_json(results_json(found, recordings))
    else:
        paragraph(found.headline())
    return 1 if check and found.verdict != "match" else 0
