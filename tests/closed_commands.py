"""Whether the commands are closed: what one writes, the others read.

    python -m tests.closed_commands --count 20 --seed 1 --limit 60

A random small scenario (any table, an arm, a hand; up to three causes of the catalogue, faults of
data among them) is recorded and diagnosed. No command may end in an internal error, the JSON is
finite, and the amended scenario loads, is simulated, diagnosed again, corrects and is exported.
Two recordings are diagnosed with the amended scenario: the one it was made from, and one that it
simulates. Chance alone makes findings, so that these are no broken rule: they are listed, and the
share of diagnoses without any is printed. So are the scenarios that take longer than the limit.
"""

import argparse
import contextlib
import io
import json
import shutil
import sys
import tempfile
import time
import tomllib
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import tomli_w

from tests.catalogue_cases import words
from tests.fuzz.judging import alarm
from tiltcal.cli import main
from tiltcal.cli.signals import INTERRUPTED, TERMINATED
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
    "handheld": (),
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
        rule: which.
        found: what was seen instead.
    """

    rule: str
    found: str


@dataclass(frozen=True)
class Tried:
    """What came of one scenario.

    Args:
        broken: the rules that it breaks.
        again: of each diagnosis with the amended scenario, by the name of its folder, the findings:
            effect and p-value.
    """

    broken: list[Broken] = field(default_factory=list)
    again: dict[str, list[str]] = field(default_factory=dict)


class OutOfTime(BaseException):
    """A scenario took longer than its limit: no error that a command would catch."""


@contextlib.contextmanager
def limited(seconds: float) -> Iterator[None]:
    """Raise OutOfTime after so much processor time, s."""

    def stop(*_: object) -> None:
        raise OutOfTime

    with alarm(stop, seconds, of_processor=True):
        yield


def random_scenario(rng: np.random.Generator) -> dict[str, Any]:
    """A scenario with its effects, as a file has it."""
    table = str(rng.choice(list(TABLES)))
    kinds = [k for k in SENSORS if rng.random() < 0.5] or ["accelerometer"]
    if table != "dual" and "inclinometer" in kinds and len(kinds) > 1:
        kinds.remove("inclinometer")
    if table == "handheld" and not {"accelerometer", "gyro"} & set(kinds):
        kinds = ["accelerometer", *(k for k in kinds if k != "inclinometer")]
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
        to: dict[str, Any] = {
            f"{a}_deg": float(np.round(rng.uniform(-reach, reach))) for a in TABLES[table]
        } or {"up": str(rng.normal(size=3).round(2).tolist())}
        dwell = float(rng.choice([0.5, 2.0, 4.0]))
        steps.append({"action": "move", **to, "rate_deg_s": 60.0, "dwell_s": dwell})
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
        part, size = int(rng.integers(3)), float(10 ** rng.uniform(-1, 0.5))
        sizes = words(cls, axes, 1.0 if cls.mislabels else size, part)
        if cls.mislabels:  # a column is exchanged or turned round, or it is not
            name = str(rng.choice(list(sizes)))
            sizes = {name: cls.parameters[0].plausible[part]}
        effect |= sizes
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
    if status in (INTERRUPTED, TERMINATED):
        raise KeyboardInterrupt
    return int(status or 0), out.getvalue()


def _refuse_constant(name: str) -> float:
    raise ValueError(f"{name} in JSON")


def _named(finding: dict[str, Any]) -> str:
    tested = "" if finding["p_value"] is None else f" (p {finding['p_value']:.1g})"
    return f"{finding['effect'] or 'nameless'}{tested}"


class Trial:
    """The commands that one scenario goes through.

    Args:
        scenario: with its effects, as a file has it.
        at: an empty folder.
    """

    def __init__(self, scenario: dict[str, Any], at: Path) -> None:
        self.scenario, self.at, self.tried = scenario, at, Tried()
        shutil.copy(ARM, at)
        self._write("truth", scenario)
        self._write("honest", {k: v for k, v in scenario.items() if k != "effect"})

    def run(self) -> Tried:
        """All of them."""
        if not self.simulated("it is simulated", "truth", "log"):
            return self.tried
        answer = self.diagnosed("it is diagnosed", "log", "honest.toml", "out")
        if answer is None:
            return self.tried
        self._judge(answer)
        shutil.copy(self.at / "out" / "amended.toml", self.at)
        self._diagnose_again("itself", "log")
        self.simulated("the amended scenario is simulated", "amended", "exact")
        # no recording is without noise, and the amended scenario has what the user's one had
        table = tomllib.loads((self.at / "amended.toml").read_text())
        noise = [e for e in self.scenario["effect"] if e["id"].endswith("noise")]
        self._write("noisy", {**table, "effect": [*table.get("effect", []), *noise]})
        if self.simulated("the amended scenario with noise is simulated", "noisy", "again"):
            self._diagnose_again("another", "again")
        self._correct()
        return self.tried

    def asked(self, rule: str, *command: str, allowed: tuple[int, ...] = (0,)) -> bool:
        """Whether a command ends as it may."""
        status, text = run(*command)
        if status in allowed and "internal error" not in text and "Traceback" not in text:
            return True
        self._break(rule, f"{' '.join(command)}: {status}: {text[-600:]}")
        return False

    def simulated(self, rule: str, scenario: str, log: str) -> bool:
        """Whether a scenario of the folder is simulated."""
        files = self._file(f"{scenario}.toml"), "-o", self._file(f"{log}.csv")
        return self.asked(rule, "simulate", *files)

    def diagnosed(self, rule: str, log: str, scenario: str, out: str) -> dict[str, Any] | None:
        """What a diagnosis says, as JSON; None where it does not."""
        files = self._file(f"{log}.csv"), "--scenario", self._file(scenario)
        if not self.asked(rule, "diagnose", *files, "-o", self._file(out), allowed=(0, 1)):
            return None
        try:
            text = (self.at / out / "diagnosis.json").read_text()
            answer: dict[str, Any] = json.loads(text, parse_constant=_refuse_constant)
        except (OSError, ValueError) as e:
            self._break("JSON is there and finite", str(e))
            return None
        return answer

    def _diagnose_again(self, out: str, log: str) -> None:
        answer = self.diagnosed(f"{out} is diagnosed again", log, "amended.toml", out)
        if answer is not None:
            self.tried.again[out] = [_named(f) for f in answer["findings"]]

    def _correct(self) -> None:
        amended = self._file("amended.toml")
        files = self._file("log.csv"), "-o", self._file("corrected.csv")
        if self.asked("it corrects", "correct", amended, *files):
            # what no single reading and temperature determines has no firmware
            header = self._file("firmware.h")
            self.asked("it is exported", "export", amended, "-o", header, allowed=(0, 2))

    def _judge(self, answer: dict[str, Any]) -> None:
        if answer["verdict"] == "match":
            for finding in answer["findings"]:
                if finding["effect"] is None:
                    self._break("a match has no findings", finding["statement"])
        before, after = (answer["fit"][k] for k in ("before", "after"))
        fitted = answer["findings"] and before["chi2_per_dof"] and after["chi2_per_dof"]
        likelihood = before["log_likelihood"], after["log_likelihood"]
        if fitted and likelihood[1] < likelihood[0] - 1e-6:
            self._break("an answer makes the recording more likely", f"{likelihood}")

    def _break(self, rule: str, found: str) -> None:
        self.tried.broken.append(Broken(rule, found))

    def _file(self, name: str) -> str:
        return str(self.at / name)

    def _write(self, name: str, table: dict[str, Any]) -> None:
        (self.at / f"{name}.toml").write_text(tomli_w.dumps(table))


def tell(count: int, seed: int, limit: float, place: Path | None = None) -> int:
    """Try so many scenarios and print what came of them.

    Args:
        count: how many.
        seed: of their draws.
        limit: processor time of each, s.
        place: folder that keeps their files; none are kept without.

    Returns:
        how many break a rule or the limit.
    """
    wrong, again = 0, list[bool]()
    for k in range(count):
        scenario = random_scenario(np.random.default_rng([seed, k]))
        ids = " ".join(e["id"] for e in scenario["effect"] if not e["id"].endswith("noise"))
        name = f"{seed} {k} {scenario['name']}: {ids or 'no cause'}"
        began = time.process_time()
        with tempfile.TemporaryDirectory() as folder_:
            at = Path(folder_) if place is None else place / f"{seed}_{k}"
            at.mkdir(parents=True, exist_ok=True)
            trial = Trial(scenario, at)
            try:
                with limited(limit):
                    trial.run()
            except OutOfTime:
                print(f"{name}: takes more than {limit:g} s", flush=True)
                wrong += not trial.tried.broken
        print(f"{name}: {time.process_time() - began:.0f} s", flush=True)
        for rule in trial.tried.broken:
            print(f"{name}: {rule.rule}: {rule.found}", flush=True)
        for which, findings in trial.tried.again.items():
            again.append(not findings)
            if findings:
                print(f"{name}: {which} again: {', '.join(findings)}", flush=True)
        wrong += bool(trial.tried.broken)
    print(f"{count - wrong} of {count} scenarios keep all rules within {limit:g} s")
    print(f"{sum(again)} of {len(again)} diagnoses with the amended scenario find nothing")
    return wrong


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--count", type=int, default=20)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--keep", type=Path, default=None, help="folder for all files")
    parser.add_argument("--limit", type=float, default=180.0, help="processor time of each, s")
    given = parser.parse_args()
    sys.exit(min(tell(given.count, given.seed, given.limit, given.keep), 1))
