"""Whether the commands are closed: what one writes, the others read.

    python -m tests.closed_commands --count 20 --seed 1

A random small scenario (any table, an arm; up to three causes of the catalogue, faults of
data among them) is recorded and diagnosed. No command may end in an internal error, the JSON is
finite, and the amended scenario loads, is simulated, diagnosed again, corrects and is exported.
"""

import argparse
import contextlib
import io
import json
import shutil
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import tomli_w

from tests.catalogue_cases import words
from tiltcal.cli import main
from tiltcal.core.assets import folder
from tiltcal.core.errors import TiltcalError
from tiltcal.effects import CATALOGUE
from tiltcal.laboratory.scenario import parse_scenario

TABLES = {
    "placing": ("outer",),
    "vertical": ("outer",),
    "dual": ("outer", "inner"),
    "three": ("outer", "middle", "inner"),
    "arm": ("pan", "lift", "elbow", "wrist"),
}
SENSORS = {
    "accelerometer": {"axes": ["x", "y", "z"], "adjustable": ["bias", "scale", "cross_axis"]},
    "inclinometer": {"axes": ["x", "y"], "adjustable": ["bias", "scale", "cross_axis"]},
    "gyro": {"axes": ["x", "y", "z"], "adjustable": ["bias", "scale", "cross_axis"]},
    "fog": {"axes": ["a"], "input_axis": [0.6, 0.0, 0.8], "adjustable": ["bias", "scale"]},
}
NOISE: dict[str, dict[str, Any]] = {
    "accelerometer": {"id": "acc_noise", "white_ug_rthz": 30.0},
    "inclinometer": {"id": "acc_noise", "white_ug_rthz": 30.0},
    "gyro": {"id": "gyr_noise", "white_deg_rth": 0.1},
    "fog": {"id": "gyr_noise", "white_deg_rth": 0.003},
}
CAUSES = [id for id, cls in CATALOGUE.items() if cls.stage != "data" and not id.endswith("noise")]
FAULTS = [id for id, cls in CATALOGUE.items() if cls.stage == "data"]
ARM = folder("scenarios") / "arm" / "arm.xml"
TRIES = 30  # draws of an effect until one stands on the table


@dataclass(frozen=True)
class Broken:
    """A rule that does not hold.

    Args:
        rule: which; found: what was seen instead.
    """

    rule: str
    found: str


def random_scenario(rng: np.random.Generator) -> dict[str, Any]:
    """A scenario with its effects, as a file has it."""
    table = str(rng.choice(list(TABLES)))
    kinds = [k for k in SENSORS if rng.random() < 0.5] or ["accelerometer"]
    if table != "dual" and "inclinometer" in kinds and len(kinds) > 1:
        kinds.remove("inclinometer")
    sensors = [
        {"name": f"{kind[:4]}", "kind": kind, "rate_hz": float(rng.choice([10, 25, 50]))}
        | SENSORS[kind]
        for kind in kinds
    ]
    scenario: dict[str, Any] = {
        "schema": 1,
        "name": f"{table} at random",
        "seed": int(rng.integers(1000)),
        "site": {"gravity_m_s2": 9.81, "latitude_deg": 45.0},
        "rig": _rig(table),
        "climate": {"start_degC": 22.0, "ramp_degC_h": float(rng.uniform(-20, 20))},
        "sensor": sensors,
        "sequence": _sequence(table, rng),
    }
    scenario["effect"] = [NOISE[s["kind"]] | {"sensor": s["name"]} for s in sensors]
    for _ in range(int(rng.integers(0, 4))):
        _conceal(scenario, rng)
    return scenario


def _rig(table: str) -> dict[str, Any]:
    if table != "arm":
        return {"table": table}
    axes = {name: name for name in TABLES["arm"]}
    return {"mjcf": ARM.name, "site": "tool", "axes": axes, "readout": "command"}


def _sequence(table: str, rng: np.random.Generator) -> list[dict[str, Any]]:
    poses = int(rng.integers(4, 16))
    reach = 60.0 if table == "arm" else 180.0
    steps: list[dict[str, Any]] = [{"action": "rest", "dwell_s": 3.0}]
    for _ in range(poses):
        angles = {f"{a}_deg": float(np.round(rng.uniform(-reach, reach))) for a in TABLES[table]}
        dwell = float(rng.choice([0.5, 2.0, 4.0]))
        steps.append({"action": "move", **angles, "rate_deg_s": 60.0, "dwell_s": dwell})
    return steps


def _conceal(scenario: dict[str, Any], rng: np.random.Generator) -> None:
    """Add an effect that the set-up can have."""
    for _ in range(TRIES):
        cls = CATALOGUE[str(rng.choice(FAULTS if rng.random() < 0.3 else CAUSES))]
        sensors = [s for s in scenario["sensor"] if s["kind"] in cls.kinds] if cls.kinds else [None]
        if not sensors:
            continue
        sensor = sensors[int(rng.integers(len(sensors)))]
        axes = tuple(sensor["axes"]) if sensor else ()
        effect: dict[str, Any] = {"id": cls.id}
        effect |= {"sensor": sensor["name"]} if sensor else {}
        effect |= words(cls, axes, float(10 ** rng.uniform(-1, 0.5)), int(rng.integers(3)))
        with contextlib.suppress(TiltcalError, ValueError):
            table = {**scenario, "effect": [*scenario["effect"], effect]}
            parse_scenario(table, folder=ARM.parent)
            scenario["effect"].append(effect)
            return


def run(*words_: str) -> tuple[int, str]:
    """Exit status of a command, and what it printed."""
    out = io.StringIO()
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(out):
        try:
            status = main(list(words_))
        except SystemExit as end:
            status = end.code
    return int(status or 0), out.getvalue()


def _refuse_constant(name: str) -> float:
    raise ValueError(f"{name} in JSON")


def broken_rules(scenario: dict[str, Any], at: Path) -> list[Broken]:
    """The rules that one scenario breaks. at: an empty folder."""
    truth, honest, log = at / "truth.toml", at / "honest.toml", at / "log.csv"
    shutil.copy(ARM, at)
    truth.write_text(tomli_w.dumps(scenario))
    honest.write_text(tomli_w.dumps({k: v for k, v in scenario.items() if k != "effect"}))
    found: list[Broken] = []

    def asked(rule: str, *command: str, allowed: tuple[int, ...] = (0,)) -> bool:
        status, text = run(*command)
        if status not in allowed or "internal error" in text or "Traceback" in text:
            found.append(Broken(rule, f"{' '.join(command)}: {status}: {text[-600:]}"))
            return False
        return True

    if not asked("it is simulated", "simulate", str(truth), "-o", str(log)):
        return found
    out = at / "out"
    command = "diagnose", str(log), "--scenario", str(honest), "-o", str(out)
    if not asked("it is diagnosed", *command, allowed=(0, 1)) or not out.exists():
        return found
    try:
        text = (out / "diagnosis.json").read_text()
        answer = json.loads(text, parse_constant=_refuse_constant)
    except ValueError as e:
        return [*found, Broken("JSON is finite", str(e))]
    amended = str(out / "amended.toml")
    again, more = str(at / "again.csv"), str(at / "again")
    if asked("the amended scenario is simulated", "simulate", amended, "-o", again):
        asked("and diagnosed", "diagnose", again, "--scenario", amended, "-o", more, allowed=(0, 1))
    corrected = str(at / "corrected.csv")
    if asked("it corrects", "correct", amended, str(log), "-o", corrected):
        # what no single reading and temperature determines has no firmware
        header = str(at / "firmware.h")
        asked("it is exported", "export", amended, "-o", header, allowed=(0, 2))
    if answer["verdict"] == "match":
        unnamed = [f for f in answer["findings"] if f["effect"] is None]
        found += [Broken("a match has no findings", f["statement"]) for f in unnamed]
    before, after = (answer["fit"][k]["chi2_per_dof"] for k in ("before", "after"))
    likelihood = [answer["fit"][k]["log_likelihood"] for k in ("before", "after")]
    if answer["findings"] and before and after and likelihood[1] < likelihood[0] - 1e-6:
        found.append(Broken("an answer makes the recording more likely", f"{likelihood}"))
    return found


def tell(count: int, seed: int, place: Path | None = None) -> int:
    """Try so many scenarios and print what broke; their number."""
    wrong = 0
    for k in range(count):
        scenario = random_scenario(np.random.default_rng([seed, k]))
        with tempfile.TemporaryDirectory() as name:
            at = Path(name) if place is None else place / f"{seed}_{k}"
            at.mkdir(parents=True, exist_ok=True)
            rules = broken_rules(scenario, at)
        ids = [e["id"] for e in scenario["effect"]]
        for rule in rules:
            print(f"{seed} {k} {ids}: {rule.rule}: {rule.found}", flush=True)
        wrong += bool(rules)
    print(f"{count - wrong} of {count} scenarios keep all rules", flush=True)
    return wrong


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--count", type=int, default=20)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--keep", type=Path, default=None, help="folder for all files")
    given = parser.parse_args()
    sys.exit(min(tell(given.count, given.seed, given.keep), 1))
