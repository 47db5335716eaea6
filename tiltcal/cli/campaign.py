"""``tiltcal campaign``, ``sweep`` and ``merge``, and what they print."""

import importlib
from pathlib import Path
from typing import Annotated, Any

from cyclopts import Parameter

from tiltcal.api.simulating import simulator
from tiltcal.cli.options import (
    DEFAULT_BUDGET,
    SEVERAL,
    WHOLE,
    AllowCommands,
    EngineName,
    Jobs,
    Json,
    MoreBudget,
    ScenarioFile,
)
from tiltcal.cli.output import paragraph, print_json, print_line, print_table, progress_line
from tiltcal.core.errors import TiltcalError
from tiltcal.core.files import write_json
from tiltcal.core.read_back import checked
from tiltcal.core.tasks.engines import open_engine
from tiltcal.core.tasks.outcome import Limits
from tiltcal.validation.campaign.campaign_file import (
    Campaign,
    CampaignTable,
    campaign_of,
    load_campaign,
)
from tiltcal.validation.campaign.factors import Factor
from tiltcal.validation.campaign.folder import (
    CampaignFiles,
    Shard,
    forget_faults,
    make_runs,
    merge_shards,
    write_campaign,
)
from tiltcal.validation.campaign.points import check_levels, require_allowed, require_countable
from tiltcal.validation.campaign.results import Results, known_summary, write_results

HEADER = ("method", "runs", "verdicts", "NEES/dof", "95 %", "tilt after, arcsec", "95 %", "bound")
ALL_PARAMETERS = ("tilt_after_arcsec", "nees_per_dof")
"""Results with all parameters together."""


def print_summary(summary: dict[str, Any]) -> None:
    """Print a row per combination of levels and method, sensitivities, and what failed."""
    cells = summary["cells"]
    names = list(cells[0]["values"]) if cells else []
    rows = [
        [*(_text(v) for v in cell["values"].values()), *_row(method, found)]
        for cell in cells
        for method, found in cell["methods"].items()
    ]
    print_table((*names, *HEADER), rows, title=summary["name"], spare=["95 %", "NEES/dof", "bound"])
    for cell in cells:
        for method, found in cell["methods"].items():
            _print_sensitivity(method, cell["values"], found.get("sensitivity", {}))
    for failed in summary["failed"]:
        where = ", ".join(f"{k} = {_text(v)}" for k, v in failed["values"].items())
        paragraph(
            f"no result: {failed['method']}, {where}, seed {failed['seed']}: {failed['error']}"
        )
    for fault, count in summary["faults"].items():
        paragraph(f"{count} runs lost their process ({fault})")
    missing = summary["runs_planned"] - summary["runs"]
    paragraph(f"{summary['runs']} of {summary['runs_planned']} runs" + _missing(missing))


def _missing(count: int) -> str:
    return f"; {count} are not made yet" if count else ""


def _row(method: str, found: dict[str, Any]) -> list[str]:
    verdicts = ", ".join(f"{v} x{shown['count']}" for v, shown in found["verdicts"].items())
    nees, tilt = found["nees_per_dof"], found["tilt_arcsec"]
    row = [method, str(found["runs"]), verdicts]
    row += [_text(nees["value"]), _interval(nees["interval_95"])] if nees else ["", ""]
    if tilt:
        row += [_text(tilt["after_rms"]), _interval(tilt["after_rms_interval_95"])]
        row += [_text(tilt["bound_rms"])]
    return row + [""] * (len(HEADER) - len(row))


def _print_sensitivity(method: str, values: dict[str, Any], found: dict[str, Any]) -> None:
    rows = [  # those of each parameter's error are in the report
        [name, factor, *_index(first), *_index(indices["total"][factor])]
        for name, indices in found.items()
        if "total" in indices and name in ALL_PARAMETERS
        for factor, first in indices["first_order"].items()
    ]
    where = ", ".join(f"{k} = {_text(v)}" for k, v in values.items())
    if rows:
        header = ("result", "factor", "first-order index", "95 %", "total index", "95 %")
        print_table(header, rows, title=f"sensitivity: {method} {where}".rstrip())
    for name, indices in found.items():
        if "reason" in indices:
            paragraph(f"{method}, {name}: no sensitivity indices, {indices['reason']}")


def _index(index: dict[str, Any]) -> list[str]:
    value, low, high = (round(x, 2) + 0.0 for x in (index["value"], *index["interval_95"]))
    return [f"{value:.2f}", f"{low:.2f} ... {high:.2f}"]


def _interval(ends: list[float]) -> str:
    return " ... ".join(_text(x) for x in ends)


def _text(value: Any) -> str:
    return f"{value:.4g}" if isinstance(value, float) else str(value)


Output = Annotated[
    Path,
    Parameter(
        "--output",
        alias="-o",
        help="Folder for the results, or FILE.parquet for files FILE.* in one folder.",
    ),
]
ShardName = Annotated[str, Parameter(help="i/n: only every n-th run, for `tiltcal merge`.")]
TimeLimit = Annotated[float, Parameter(help="Longest time of one run, s.")]
MemoryLimit = Annotated[int, WHOLE, Parameter(help="Most memory of one run, MiB.")]
Again = Annotated[
    bool,
    Parameter("--again", help="Make runs again that took too long, too much memory, or ended."),
]


def campaign(
    file: Annotated[Path, Parameter("CAMPAIGN", help="Campaign file.")],
    /,
    *,
    output: Output,
    jobs: Jobs = 1,
    engine: EngineName = "processes",
    shard: ShardName = "1/1",
    time_limit: TimeLimit = 600.0,
    memory_limit: MemoryLimit = 4096,
    again: Again = False,
    allow_commands: AllowCommands = False,
    budget: MoreBudget = DEFAULT_BUDGET,
    as_json: Json = False,
) -> int:
    """Run a scenario over seeds, grids and distributions of its fields.

    Results are a row a run and method in results.parquet, a summary and a report.
    Every finished run is in a journal: the same command after an interruption, or
    with further levels, makes only the runs that are missing.

      tiltcal campaign grades.toml -o grades -j 2
      tiltcal campaign grades.toml -o part1 --shard 1/4

    Exit status: 0 all runs are made, those without a result are named; 2 unusable input.
    """
    budget.apply()
    limits = Limits(time_limit, memory_limit)
    found = load_campaign(file)
    return _made(
        found, output, Shard.of(shard), limits, jobs, engine, again, allow_commands, as_json
    )


def sweep(
    scenario: ScenarioFile,
    /,
    *,
    effect: Annotated[
        tuple[str, ...],
        SEVERAL,
        Parameter(help="EFFECT.PARAMETER=START:STOP:COUNT, COUNT values with both ends."),
    ] = (),
    field: Annotated[
        tuple[str, ...],
        SEVERAL,
        Parameter(help="The same of any other field, as sensor.accel.rate_hz=10:100:4."),
    ] = (),
    seeds: Annotated[int, WHOLE, Parameter(help="Runs at each point.")] = 20,
    output: Output,
    jobs: Jobs = 1,
    engine: EngineName = "processes",
    time_limit: TimeLimit = 600.0,
    memory_limit: MemoryLimit = 4096,
    again: Again = False,
    allow_commands: AllowCommands = False,
    budget: MoreBudget = DEFAULT_BUDGET,
    as_json: Json = False,
) -> int:
    """Run a scenario over sizes of an effect.

      tiltcal sweep bench.toml --effect acc_K2.k2_x_ug_g2=0:3000:5 --seeds 200 -o x.parquet

    Exit status: 0 all runs are made, those without a result are named; 2 unusable input.
    """
    budget.apply()
    factors = [_range(text, "effect.") for text in effect] + [_range(text) for text in field]
    if not factors:
        raise TiltcalError(
            "command line of `tiltcal sweep`",
            found="nothing to vary",
            need="--effect or --field",
            do="add --effect acc_K2.k2_x_ug_g2=0:3000:5",
        )
    table = checked(
        CampaignTable,
        {
            "schema": 1,
            "scenario": str(scenario),
            "name": f"sweep of {scenario.name}",
            "runs": seeds,
            "factor": factors,
        },
        "command line of `tiltcal sweep`",
        "a campaign",
    )
    return _made(
        campaign_of(table, scenario),
        output,
        Shard(),
        Limits(time_limit, memory_limit),
        jobs,
        engine,
        again,
        allow_commands,
        as_json,
    )


def merge(
    parts: Annotated[tuple[Path, ...], Parameter("PART", help="Outputs of shards.")],
    /,
    *,
    output: Output,
    as_json: Json = False,
) -> int:
    """Merge the shards of a campaign.

      tiltcal merge part1 part2 part3 part4 -o whole

    Exit status: 0 merged, and runs that are missing are counted; 2 unusable input.
    """
    files = CampaignFiles.of(output)
    with files.claimed(), files.whole_or_not_at_all():
        found = merge_shards([CampaignFiles.of(part) for part in parts], files)
        return _finished(found, files, as_json)


def _made(
    found: Campaign,
    output: Path,
    shard: Shard,
    limits: Limits,
    jobs: int,
    engine: str,
    again: bool,
    allow_commands: bool,
    as_json: bool,
) -> int:
    require_countable(found)
    require_allowed(found, allow_commands)
    check_levels(found)
    files = CampaignFiles.of(output)
    with files.claimed():
        with files.journal() as journal:
            write_campaign(found, files)
            if again:
                forget_faults(found, journal)
            with progress_line() as progress, open_engine(engine, jobs) as opened:
                made = make_runs(
                    found, shard, journal, opened, limits, simulator, progress, _load_libraries
                )
        known = None if made or again else known_summary(found, files)
        return _shown(known, files, as_json) if known else _finished(found, files, as_json)


def _load_libraries() -> None:
    """Import what results are written with: not after the last run, when every process waits."""
    for name in ("scipy.stats", "pyarrow.parquet", "tiltcal.report.campaign"):
        importlib.import_module(name)
    importlib.import_module("pyarrow").array([0.0])  # imports pandas, where it is installed


def _finished(found: Campaign, files: CampaignFiles, as_json: bool) -> int:
    """Write what the journal has, and print it."""
    from tiltcal.report.campaign import write_campaign_report
    from tiltcal.validation.campaign.summary import summary_of

    with files.journal() as journal:
        results = Results(found, journal)
        write_results(results, files.results)
        summary = summary_of(results)
        write_json(files.sibling(".summary.json"), summary)
        write_campaign_report(results, summary, files.sibling(".html"))
    return _shown(summary, files, as_json)


def _shown(summary: dict[str, Any], files: CampaignFiles, as_json: bool) -> int:
    """Print a summary, and return the exit status."""
    if as_json:
        print_json(summary)
        return 0
    print_summary(summary)
    for name in (files.results, files.sibling(".summary.json"), files.sibling(".html")):
        print_line(f"written: {name}")
    return 0


def _range(message: str, prefix: str = "") -> Factor:
    """A factor from ``PATH=START:STOP:COUNT``."""
    path, _, text = message.partition("=")
    try:
        start, stop, count = text.split(":")
        found: dict[str, Any] = {"start": float(start), "stop": float(stop), "count": int(count)}
        return Factor(field=prefix + path, **found)
    except ValueError as error:
        raise TiltcalError(
            "command line of `tiltcal sweep`",
            found=message,
            need="PATH=START:STOP:COUNT",
            do="write acc_K2.k2_x_ug_g2=0:3000:5 for 5 values from 0 to 3000",
        ) from error
