"""Cost of `tiltcal diagnose`, report and re-simulation included, by rows: in dwells and always
moving, with an effect and without.

Each run is a process of its own, as a user starts it; CPU seconds are what a shared machine cannot
spoil.

The limit is a ratio to forward selection by BIC (`baselines greedy`) on the same files, in the same
run. That prepares the same data and makes the columns of the same 3700 or so hypotheses, which no
diagnosis over this catalogue can do without; the search, its probabilities, the tests of what is
left and the re-simulation may take as much again. Seconds are no limit: each effect, form and curve
that is added to the catalogue adds columns.
"""

import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import tomli_w

from tests.benchmarks import sized
from tiltcal.laboratory.scenario import Scenario, parse_scenario
from tiltcal.recordings.saving import write_recording

ROWS = sized((15000, 30000, 60000), (1500,))
CASES = sized([(m, h) for m in (False, True) for h in (True, False)], [(False, False)])
RATE = 100.0  # Hz
LIMIT, LIMIT_MiB = 2.0, 600
ROOT = Path(__file__).parents[2]
DIAGNOSERS = {
    "tiltcal": [sys.executable, "-m", "tiltcal"],
    "greedy": [sys.executable, "-m", "tests.benchmarks.baselines", "greedy"],
}
TERMS = ["bias", "scale", "cross_axis"]
HONEST: dict[str, Any] = {
    "schema": 1,
    "name": "cost",
    "site": {"gravity_m_s2": 9.81, "latitude_deg": 48.0},
    "rig": {"table": "three"},
    "sensor": [
        {"name": "accel", "kind": "accelerometer", "rate_hz": RATE, "adjustable": TERMS},
        {"name": "gyro", "kind": "gyro", "rate_hz": RATE, "adjustable": TERMS},
        {
            "name": "fog",
            "kind": "fog",
            "axes": ["a"],
            "input_axis": [1, 1, 1],
            "rate_hz": RATE,
            "adjustable": ["bias", "scale"],
        },
    ],
}
NOISE = [
    {"id": "acc_noise", "sensor": "accel", "white_ug_rthz": 25.0, "walk_ug_rts": 0.2},
    {"id": "gyr_noise", "sensor": "gyro", "white_deg_rth": 0.3, "flicker_deg_h": 2.0},
    {"id": "gyr_noise", "sensor": "fog", "white_deg_rth": 0.02},
]
HIDDEN = {"id": "acc_K2", "sensor": "accel", "k2_x_ug_g2": 200.0}


def laboratory(rows: int, moving: bool, hidden: bool) -> Scenario:
    """What is recorded: about so many rows, with noise and the hidden effect."""
    if moving:
        axes = ("inner", "middle", "outer")
        cycles = 5 * max(round(rows / RATE / 25.0), 1)
        steps: list[dict[str, Any]] = [
            {
                "action": "oscillate",
                "axis": axes[k % 3],
                "amplitude_deg": 60.0,
                "frequency_hz": 0.2,
                "cycles": 5,
            }
            for k in range(cycles // 5)
        ]
    else:
        steps = [
            {
                "action": "move",
                "outer_deg": 137.5 * k % 360 - 180,
                "middle_deg": 77.5 * k % 180 - 90,
                "inner_deg": 222.5 * k % 360 - 180,
                "rate_deg_s": 90.0,
                "dwell_s": 20.0,
            }
            for k in range(max(round(rows / RATE / 22.6), 1))
        ]
    return parse_scenario(
        {**HONEST, "sequence": steps, "effect": [*NOISE, *([HIDDEN] if hidden else [])]}
    )


def write(folder: Path, rows: int, moving: bool, hidden: bool) -> int:
    """Write recording and scenario; how many rows they have."""
    from tiltsim.laboratory import MujocoLaboratory

    recording = MujocoLaboratory().record(laboratory(rows, moving, hidden), rows)
    write_recording(recording, folder / "recording.csv")
    (folder / "scenario.toml").write_text(tomli_w.dumps(HONEST), encoding="utf-8")
    return len(recording)


def measure(folder: Path, diagnoser: str) -> dict[str, Any]:
    """Wall and CPU seconds, peak RSS in MiB and the verdict of one run of a diagnoser."""
    given = ["diagnose", folder / "recording.csv", "--scenario", folder / "scenario.toml"]
    command = [*DIAGNOSERS[diagnoser], *map(str, given), "-o", str(folder / diagnoser)]
    start = time.perf_counter()
    with subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True, cwd=ROOT
    ) as process:
        assert process.stdout is not None
        words = process.stdout.read()
        _, status, used = os.wait4(process.pid, 0)
        process.returncode = os.waitstatus_to_exitcode(status)
    if process.returncode:
        raise RuntimeError(f"{' '.join(command)} ended with {process.returncode}")
    return {
        "wall_s": time.perf_counter() - start,
        "cpu_s": used.ru_utime + used.ru_stime,
        "peak_MiB": used.ru_maxrss / 1024,
        "verdict": words.split(":")[0],
    }


def main() -> None:
    """A table with the ratio to the run of half as many rows, and of the longest to `greedy`."""
    print(
        "diagnose 7 channels on a three-axis table (limits of the longest:"
        f" {LIMIT:g} x the CPU time of greedy, {LIMIT_MiB} MiB)"
    )
    print(
        f"{'motion':<8} {'effect':<7} {'rows':>6} {'wall s':>7} {'CPU s':>7} {'by rows':>7}"
        f" {'by greedy':>9} {'peak MiB':>9}  verdict"
    )
    for moving, hidden in CASES:
        before = float("nan")
        for rows in ROWS:
            with tempfile.TemporaryDirectory() as name:
                count = write(Path(name), rows, moving, hidden)
                r = measure(Path(name), "tiltcal")
                simple = measure(Path(name), "greedy")["cpu_s"] if rows == ROWS[-1] else None
            ratio = r["cpu_s"] / simple if simple else float("nan")
            above = ratio > LIMIT or (simple and r["peak_MiB"] > LIMIT_MiB)
            print(
                f"{'moving' if moving else 'dwells':<8} {'K2' if hidden else 'none':<7}"
                f" {count:>6} {r['wall_s']:>7.1f} {r['cpu_s']:>7.1f}"
                f" {r['cpu_s'] / before:>7.2f} {ratio:>9.2f} {r['peak_MiB']:>9.0f}"
                f"  {r['verdict']}{'  ABOVE' if above else ''}",
                flush=True,
            )
            before = r["cpu_s"]
