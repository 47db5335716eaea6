"""One trial: draw a case, hand over copies of two files, wait for the answer, only then write the
truth and judge.
"""

import csv
import json
import os
import shutil
import signal
import subprocess
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from blind.cases import KINDS, TYPES, Case, channel_names, make
from blind.catalogue import AUTHORS
from blind.faults import Rows
from blind.files import UNITS, write_recording, write_scenario
from blind.judge import judge

Plain = dict[str, Any]
# by somebody else: not finished
STOPPED = tuple(f"exit {-number}:" for number in (signal.SIGINT, signal.SIGTERM))
KEPT = ("diagnosis.json", "amended.toml", "report.html")


def trial(
    folder: Path,
    kind: str,
    type_: str,
    k: int,
    seed: int,
    command: Sequence[str],
    limit_s: float,
    author: str = "first",
) -> Plain:
    """Run one trial, or take its result from ``folder`` where it is finished."""
    own = AUTHORS.index(author)
    name = f"{kind}-{type_}-{k:03d}" + f"-{author}" * (own > 0)
    done = folder / "truth" / name / "result.json"
    if done.exists():
        return json.loads(done.read_text(encoding="utf-8"))
    key = [seed, KINDS.index(kind), TYPES.index(type_), k]
    key += [own + 1] * (own > 0)  # cases of the first author keep the seeds they always had
    case = make(kind, type_, 1 if k % 2 == 0 else 4, key, author)
    rng = np.random.default_rng([*key, 1])
    with tempfile.TemporaryDirectory(prefix="blind-") as place:
        desk = Path(place)
        write_recording(desk / "recording.csv", case.lab, case.rows, rng)
        write_scenario(desk / "scenario.toml", case.lab)
        answer, note, seconds = _ask(desk, command, limit_s)
        rms = _predict(desk, case, rng, command, limit_s) if answer else None
        result = {
            "name": name,
            "seconds": round(seconds, 2),
            "note": note,
            **judge(case.truth, answer, rms),
        }
        if not note.startswith(STOPPED):
            _keep(folder, name, desk, case, result)
    return result


def _run(command: Sequence[str], limit_s: float) -> tuple[int, str]:
    """Exit status and the last words, -1 when it took too long."""
    clean = {k: v for k, v in os.environ.items() if k != "PYTHONPATH"} | {
        "OMP_NUM_THREADS": "1",
        "OPENBLAS_NUM_THREADS": "1",
    }
    with subprocess.Popen(
        command,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        env=clean,
        start_new_session=True,
    ) as process:
        try:
            _, words = process.communicate(timeout=limit_s)
        except BaseException as error:  # its own session only; an interrupt goes on
            os.killpg(process.pid, signal.SIGKILL)
            if not isinstance(error, subprocess.TimeoutExpired):
                raise
            return -1, f"took more than {limit_s:.0f} s"
    last = words.decode(errors="replace").strip().splitlines()[-1:]
    return process.returncode, last[0] if last else ""


def _ask(desk: Path, command: Sequence[str], limit_s: float) -> tuple[Plain | None, str, float]:
    start = time.perf_counter()
    status, words = _run(
        [
            *command,
            "diagnose",
            str(desk / "recording.csv"),
            "--scenario",
            str(desk / "scenario.toml"),
            "-o",
            str(desk / "out"),
        ],
        limit_s,
    )
    seconds = time.perf_counter() - start
    if status != 0:
        return None, f"exit {status}: {words}", seconds
    return json.loads((desk / "out" / "diagnosis.json").read_text(encoding="utf-8")), "", seconds


def _predict(
    desk: Path, case: Case, rng: np.random.Generator, command: Sequence[str], limit_s: float
) -> float | None:
    """Rms of the amended model's prediction of the other recording, in units of a sample's noise;
    None where there is none.
    """
    if case.other is None or case.rows_other is None or case.clean_other is None:
        return None
    write_recording(desk / "heldout.csv", case.other, case.rows_other, rng)
    status, _ = _run(
        [
            *command,
            "simulate",
            str(desk / "out" / "amended.toml"),
            "--motion",
            str(desk / "heldout.csv"),
            "--noise",
            "off",
            "-o",
            str(desk / "out" / "predicted.csv"),
        ],
        limit_s,
    )
    if status != 0:
        return None
    return distance(desk / "out" / "predicted.csv", case, case.clean_other)


def distance(path: Path, case: Case, clean: Rows) -> float | None:
    """Pooled rms over the channels; None where the rows do not fit."""
    with path.open(encoding="utf-8", newline="") as file:
        reader = csv.reader(line for line in file if not line.startswith("#"))
        head = next(reader)
        rows = list(reader)
    if len(rows) != len(clean.t):
        return None
    squares = []
    for c, (name, (s, _)) in enumerate(
        zip(channel_names(case.lab), case.lab.channels, strict=True)
    ):
        column = next(j for j, h in enumerate(head) if h.startswith(name + "_"))
        unit = UNITS[head[column].removeprefix(name + "_")]
        told = np.array([float(r[column]) if r[column] else np.nan for r in rows]) * unit
        squares.append(np.nanmean(((told - clean.y[:, c]) / case.lab.sensors[s].sigma) ** 2))
    return float(np.sqrt(np.mean(squares)))


def _keep(folder: Path, name: str, desk: Path, case: Case, result: Plain) -> None:
    """Inputs and answers in one folder, the truth in another."""
    seen, truth = folder / "cases" / name, folder / "truth" / name
    for place in (seen, truth):
        place.mkdir(parents=True, exist_ok=True)
    for file in ("recording.csv", "scenario.toml", "heldout.csv"):
        if (desk / file).exists():
            shutil.copy(desk / file, seen / file)
    for file in KEPT:
        if (desk / "out" / file).exists():
            shutil.copy(desk / "out" / file, seen / file)
    (truth / "truth.json").write_text(
        json.dumps(case.truth, indent=1, default=float) + "\n", encoding="utf-8"
    )
    if case.other is not None and case.clean_other is not None:
        write_recording(truth / "heldout_clean.csv", case.other, case.clean_other, None)
    part = truth / "result.part"
    part.write_text(json.dumps(result, indent=1, default=float) + "\n", encoding="utf-8")
    part.rename(truth / "result.json")
