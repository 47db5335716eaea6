"""``tiltcal lab``."""

import zlib
from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from tiltcal.api.simulating import simulator
from tiltcal.cli.options import DEFAULT_BUDGET, SEED, Json, MoreBudget
from tiltcal.cli.output import print_json, progress_line
from tiltcal.effects import to_file
from tiltcal.laboratory.scenario import Scenario, fresh, load_scenario
from tiltcal.laboratory.scenario_tables import EffectTable
from tiltcal.recordings.saving import write_recording
from tiltcal.setup.sequence_files import read_sequence


def lab(
    scenario_file: Annotated[
        Path, Parameter("SCENARIO", help="Scenario with the concealed effects.")
    ],
    sequence: Annotated[Path, Parameter("SEQUENCE", help="Sequence file, CSV.")],
    recording_file: Annotated[Path, Parameter("RECORDING", help="File of the recording.")],
    /,
    *,
    seed: Annotated[int | None, SEED, Parameter(help="Seed instead of the scenario's own.")] = None,
    budget: MoreBudget = DEFAULT_BUDGET,
    as_json: Json = False,
) -> int:
    """Record a sequence file in a simulated laboratory.

    MuJoCo simulates the sequence with the effects of the scenario. Events of the
    scenario (steps, slips) happened before this recording. The seed follows from
    the sequence and the scenario's seed.
    """
    budget.apply()
    scenario = load_scenario(scenario_file)
    steps = read_sequence(sequence)
    used = zlib.crc32(sequence.read_bytes()) ^ (scenario.seed if seed is None else seed)
    again = fresh(scenario, sequence=steps, effect=past_effects(scenario), grade=None)
    with progress_line() as progress:
        recording = simulator(progress).record(again, used)
    write_recording(recording, recording_file)
    if as_json:
        print_json({"recording": str(recording_file), "rows": len(recording)})
    return 0


def past_effects(scenario: Scenario) -> tuple[EffectTable, ...]:
    """The effects of a scenario, with its events before the recording."""
    tables = [
        {**to_file(e), **({"seen_in": "another recording"} if "time" in e.values else {})}
        for e in scenario.effects
    ]
    return tuple(EffectTable.model_validate(table) for table in tables)
