"""What can go wrong with a recording, method by method, through the command line: named in words,
never a silent number.
"""

import re
from dataclasses import dataclass, field

import numpy as np
import pytest
import tomli_w

from tiltcal.cli import main
from tiltcal.core.assets import folder
from tiltcal.laboratory.laboratory import SimulatedLaboratory
from tiltcal.laboratory.scenario import Scenario, load_scenario
from tiltcal.recordings.recording import Recording
from tiltcal.recordings.saving import write_recording


def scenario_of(name, **changed):
    """A claim without time steps, some parts of it replaced."""
    text = load_scenario(folder("scenarios") / f"{name}.toml").model_dump(
        by_alias=True, exclude_defaults=True
    )
    return Scenario.model_validate(text | {"schema": 1, "dynamics": None} | changed)


def slow_turns(**changed):
    """The turns by hand at a quarter of their sample rate."""
    whole = load_scenario(folder("scenarios") / "gyro_turns_by_hand.toml").model_dump(
        exclude_defaults=True
    )
    return scenario_of(
        "gyro_turns_by_hand", sensor=[s | {"rate_hz": 25} for s in whole["sensor"]], **changed
    )


def steps(name):
    return load_scenario(folder("scenarios") / f"{name}.toml").model_dump(
        by_alias=True, exclude_defaults=True
    )["sequence"]


def sweep(step, *ends):
    return [
        {"action": "sweep", "outer_deg": a, "step_deg": step, "dwell_s": 2, "rate_deg_s": 20}
        for a in ends
    ]


def hand(*turns, rest=20, dwell=5):
    return [{"action": "rest", "dwell_s": rest}] + [
        {"action": "turn", "axis": a, "angle_deg": angle, "rate_deg_s": 60, "dwell_s": dwell}
        for a, angle in turns
    ]


def stop(angle, dwell=20):
    return {"action": "move", "outer_deg": angle, "rate_deg_s": 45, "dwell_s": dwell}


def swapped(sensor, a="x", b="y"):
    """Two channels of a sensor under each other's name."""

    def change(columns, _):
        one, other = (next(n for n in columns if n.startswith(f"{sensor}_{c}_")) for c in (a, b))
        columns[one], columns[other] = columns[other], columns[one]

    return change


def clipped(channel, low, high):
    """A channel that ends somewhere between its extremes: at a share of its range, 0 the lowest
    reading, 1 the highest.
    """

    def change(columns, _):
        name = next(n for n in columns if n.startswith(f"{channel}_"))
        bottom, span = np.nanmin(columns[name]), np.ptp(columns[name])
        columns[name] = np.clip(columns[name], bottom + low * span, bottom + high * span)

    return change


def moved(channel, share, size):
    """The base (or the bias: that is one to a channel) moves at a share of the log."""

    def change(columns, time):
        name = next(n for n in columns if n.startswith(f"{channel}_"))
        columns[name] = columns[name] + size * (time > time[0] + share * (time[-1] - time[0]))

    return change


@dataclass(frozen=True)
class Case:
    """A fault: what is recorded, what is done to the columns, and what has to be said."""

    method: str
    fault: str
    scenario: Scenario
    said: str
    spoil: tuple = ()
    words: tuple = field(default=())


SIX, NORM = "six_faces_dual", "norm_by_hand"
FIELD = hand(("x", 400), ("y", 400), ("z", 400))
CASES = [
    Case(
        "six_position",
        "a missing face",
        scenario_of(SIX, sequence=[s for s in steps(SIX) if s.get("label") != "-y"]),
        "no pose within 60 deg of -y up",
    ),
    Case(
        "six_position",
        "two faces swapped",
        scenario_of("six_faces_swapped"),
        "these two are swapped",
    ),
    Case("six_position", "two channels swapped", scenario_of(SIX), "x", (swapped("accel"),)),
    Case(
        "six_position",
        "a saturated channel",
        scenario_of(SIX),
        "saturated",
        (clipped("accel_z", 0.0, 0.7),),
    ),
    Case("six_position", "a moved base", scenario_of(SIX), "fit", (moved("accel_x", 0.6, 0.02),)),
    Case(
        "six_position",
        "rest too short",
        scenario_of(SIX, sequence=[s | {"dwell_s": 0.1} for s in steps(SIX)]),
        "dwell",
    ),
    Case(
        "norm", "too few positions", scenario_of(NORM, sequence=steps(NORM)[:5]), "need at least 9"
    ),
    Case(
        "norm",
        "a saturated channel",
        scenario_of(NORM),
        "saturated",
        (clipped("accel_z", 0.0, 0.7),),
    ),
    Case(
        "norm",
        "rest too short",
        scenario_of(NORM, sequence=[s | {"dwell_s": 0.1} for s in steps(NORM)]),
        "dwell",
    ),
    Case("norm", "a bias that jumps", scenario_of(NORM), "fit", (moved("accel_x", 0.5, 0.02),)),
    Case(
        "two_position",
        "one position only",
        scenario_of("two_position_level", sequence=[stop(0)]),
        "two positions half a turn apart",
    ),
    Case(
        "two_position",
        "a moved base",
        scenario_of("two_position_moved_base"),
        "mounting changed between positions 3 and 4",
    ),
    Case(
        "two_position",
        "a saturated channel",
        scenario_of("two_position_level"),
        "saturated",
        (clipped("incl_x", 0.0, 0.3),),
    ),
    Case(
        "two_position",
        "two channels swapped",
        scenario_of("two_position_level", sequence=[stop(a) for a in (0, 90, 180, 270)]),
        "swapped",
        (swapped("incl"),),
    ),
    Case(
        "two_position",
        "rest too short",
        scenario_of("two_position_level", sequence=[stop(0, 0.1), stop(180, 0.1)]),
        "dwell",
    ),
    Case(
        "placing_table", "a one-way sweep", scenario_of("placing_table_one_way"), "one way|one-way"
    ),
    Case(
        "placing_table",
        "two channels swapped",
        scenario_of("placing_table_one_axis", sequence=sweep(6, 90, 0)),
        "mounting",
        (swapped("accel"),),
    ),
    Case(
        "placing_table",
        "a saturated channel",
        scenario_of("placing_table_one_axis", sequence=sweep(6, 90, 0)),
        "saturated",
        (clipped("accel_x", 0.3, 1.0),),
    ),
    Case(
        "placing_table",
        "a moved base",
        scenario_of("placing_table_one_axis", sequence=sweep(6, 90, 0)),
        "fit",
        (moved("accel_y", 0.7, 0.005),),
    ),
    Case(
        "placing_table",
        "rest too short",
        scenario_of(
            "placing_table_one_axis", sequence=[s | {"dwell_s": 0.1} for s in sweep(6, 90, 0)]
        ),
        "dwell",
    ),
    Case(
        "fog_scale",
        "a turn that is too short",
        scenario_of("fog_scale_by_hand", sequence=hand(("x", 400), ("y", 150), ("z", 400))),
        "turn again about y",
    ),
    Case(
        "fog_scale",
        "a turn that is missing",
        scenario_of("fog_scale_by_hand", sequence=FIELD[:3]),
        "turn again about z",
    ),
    Case(
        "fog_scale",
        "a rest that is too short",
        scenario_of("fog_scale_by_hand", sequence=[FIELD[0] | {"dwell_s": 4}, *FIELD[1:]]),
        "stand still longer",
    ),
    Case(
        "fog_scale",
        "two channels swapped",
        scenario_of("fog_scale_by_hand", sequence=FIELD),
        "columns of one of them are swapped",
        (swapped("gyro"),),
    ),
    Case(
        "fog_scale",
        "a saturated channel",
        scenario_of("fog_scale_by_hand", sequence=FIELD),
        "saturated",
        (clipped("gyro_x", 0.0, 0.8),),
    ),
    Case(
        "fog_scale",
        "moved while resting",
        scenario_of("fog_scale_by_hand", sequence=FIELD),
        "moved during the standstill",
        (moved("fog_a", 0.2, 100.0), moved("gyro_x", 0.2, 0.05)),
    ),
    Case(
        "gyro_turns",
        "too few turns",
        slow_turns(sequence=steps("gyro_turns_by_hand")[:6]),
        "found [45] turns|dwells",
    ),
    Case("gyro_turns", "two channels swapped", slow_turns(), "swapped", (swapped("gyro"),)),
    Case(
        "gyro_turns",
        "a saturated channel",
        slow_turns(),
        "saturated",
        (clipped("gyro_x", 0.0, 0.8),),
    ),
    Case(
        "gyro_turns",
        "rests too short",
        slow_turns(sequence=[s | {"dwell_s": 0.1} for s in steps("gyro_turns_by_hand")]),
        "dwell",
    ),
    Case(
        "gyro_turns",
        "the accelerometer's channels swapped",
        slow_turns(),
        "columns of one of them are swapped",
        (swapped("accel"),),
    ),
    Case(
        "gyro_rates",
        "turned one way only",
        scenario_of(
            "gyro_rates_three",
            sequence=[s for s in steps("gyro_rates_three") if s.get("angle_deg", 1) > 0],
        ),
        "both ways",
    ),
    Case(
        "gyro_rates",
        "an axis that was not turned",
        scenario_of("gyro_rates_three", sequence=steps("gyro_rates_three")[:5]),
        "turn about those axes",
    ),
    Case(
        "gyro_rates",
        "two channels swapped",
        scenario_of("gyro_rates_three"),
        "swapped",
        (swapped("gyro"),),
    ),
    Case(
        "gyro_rates",
        "a saturated channel",
        scenario_of("gyro_rates_three"),
        "saturated",
        (clipped("gyro_x", 0.0, 0.8),),
    ),
    Case(
        "gyro_rates",
        "turns too short",
        scenario_of(
            "gyro_rates_three",
            sequence=[
                s | ({"angle_deg": 5} if "angle_deg" in s else {})
                for s in steps("gyro_rates_three")
            ],
        ),
        "steady|rate",
    ),
    Case("north", "two positions", scenario_of("north_two_positions"), "sign|four"),
    Case(
        "north",
        "a rest that is too short",
        scenario_of("north_four_positions", sequence=[stop(a, 0.1) for a in (0, 90, 180, 270)]),
        "dwell",
    ),
    Case(
        "north",
        "a moved base",
        scenario_of("north_four_positions", sequence=[stop(a) for a in (0, 90, 180, 270, 0)]),
        "moved|fit",
        (moved("accel_x", 0.9, 0.02),),
    ),
    Case(
        "north",
        "a saturated channel",
        scenario_of("north_four_positions"),
        "saturated",
        (clipped("accel_x", 0.0, 0.7),),
    ),
    Case(
        "north",
        "two channels swapped",
        scenario_of("north_four_positions"),
        "swapped",
        (swapped("accel"),),
    ),
]


def outcome(case, tmp_path, capsys):
    """Exit status and everything that was said."""
    recording = SimulatedLaboratory().record(case.scenario, 11)
    columns = {n: recording.column(n).copy() for n in recording.column_names}
    for spoil in case.spoil:
        spoil(columns, recording.time)
    spoiled = Recording.from_columns(
        recording.time, columns, labels=recording.labels, metadata=recording.metadata
    )
    write_recording(spoiled, tmp_path / "run.csv")
    text = case.scenario.model_dump(by_alias=True, exclude_defaults=True, mode="json")
    (tmp_path / "s.toml").write_text(
        tomli_w.dumps({"schema": 1} | {k: v for k, v in text.items() if v is not None})
    )
    capsys.readouterr()
    status = main(
        [
            "calibrate",
            str(tmp_path / "run.csv"),
            "--scenario",
            str(tmp_path / "s.toml"),
            "--method",
            case.method,
        ]
    )
    return status, " ".join(" ".join(capsys.readouterr()).split())  # a table's cells wrap


@pytest.mark.parametrize("case", CASES, ids=lambda c: f"{c.method}: {c.fault}")
def test_a_fault_is_named_and_never_a_silent_number(case, tmp_path, capsys):
    status, said = outcome(case, tmp_path, capsys)
    assert status in (1, 2), said
    assert re.search(case.said, said), said
    assert "Traceback" not in said
