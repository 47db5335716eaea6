"""Seconds and peak memory of commands on long recordings, each in a process of its own.
LONG_HOURS="24" takes other lengths.
"""

import json
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from tests.benchmarks import sized

HOURS = tuple(map(float, os.environ.get("LONG_HOURS", sized("3 6 12 24", "0.5")).split()))
HEAD = """schema = 1
name = "long"
seed = 5
[site]
gravity_m_s2 = 9.80123
latitude_deg = 40
[rig]
table = "dual"
[climate]
ramp_degC_h = 0.3
[[sensor]]
name = "accel"
kind = "accelerometer"
rate_hz = 100
adjustable = ["bias", "scale", "cross_axis"]
"""
TRUTH = """[[effect]]
id = "acc_bias"
bias_x_ug = 500
[[effect]]
id = "acc_K2"
k2_x_ug_g2 = 60
[[effect]]
id = "acc_noise"
white_ug_rthz = 40
flicker_ug = 5
walk_ug_rts = 0.05
"""
MEASURED = """
import sys
from tiltcal.cli import main
sys.exit(main(sys.argv[1:]))
"""


def sequence(hours: float) -> str:
    """Thirty moves an hour between the poses of a tumble, each with a label: eight columns."""
    return "".join(
        f'[[sequence]]\naction = "move"\nouter_deg = {(-90, 0, 90, 180, 45, -45, 135)[k % 7]}\n'
        f"inner_deg = {(0, 90, 180, 270, 30)[k % 5]}\nrate_deg_s = 40\ndwell_s = 113.5\n"
        f'label = "pose {k + 1}"\n'
        for k in range(round(30 * hours))
    )


def run(words: list[str], folder: Path) -> tuple[float, float]:
    """Seconds, and peak resident memory, MiB, of a command."""
    code = (
        "import json, resource, subprocess, sys\n"
        f"done = subprocess.run([sys.executable, '-c', {MEASURED!r}, *sys.argv[1:]],"
        " capture_output=True, text=True)\n"
        "done.returncode > 1 and sys.exit(done.stderr)\n"
        "print(json.dumps(resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss))"
    )
    begin = time.perf_counter()
    done = subprocess.run(
        [sys.executable, "-c", code, *words], cwd=folder, capture_output=True, text=True, check=True
    )
    return time.perf_counter() - begin, json.loads(done.stdout) / 1024


def main() -> None:
    """Parts of a day at 100 Hz, and the whole."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        for hours in HOURS:
            (folder / "known.toml").write_text(HEAD + sequence(hours))
            (folder / "truth.toml").write_text(HEAD + sequence(hours) + TRUTH)
            rest = f'[[sequence]]\naction = "rest"\ndwell_s = {3600 * hours}\n'
            (folder / "rest.toml").write_text(HEAD + rest + TRUTH)
            given = ["--scenario", "known.toml"]
            if hours == HOURS[0]:
                run(["simulate", "truth.toml", "-o", "first.parquet"], folder)
                fitted = ["--method", "six_position", "-o", "CAL.json"]
                run(["calibrate", "first.parquet", *given, *fitted], folder)
            for words in (
                ["simulate", "truth.toml", "-o", "run.parquet"],
                ["simulate", "truth.toml", "-o", "run.csv"],
                ["correct", "CAL.json", "run.parquet", "-o", "corrected.parquet"],
                ["correct", "CAL.json", "run.parquet", "-o", "corrected.csv"],
                ["calibrate", "run.parquet", *given, "--method", "six_position"],
                ["calibrate", "run.csv", *given, "--method", "six_position"],
                ["diagnose", "run.parquet", *given],
                ["diagnose", "run.csv", *given],
                ["simulate", "rest.toml", "-o", "rest.parquet"],
                ["noise", "rest.parquet"],
            ):
                seconds, peak = run(words, folder)
                print(
                    f"{hours:g} h x 100 Hz: {words[0]}, {_file(words)}: {seconds:.1f} s,"
                    f" {0.36 * hours / seconds:.3g} million rows/s, peak RSS {peak:.0f} MiB",
                    flush=True,
                )


def _file(words: list[str]) -> str:
    """The recording that a command reads, or writes."""
    files = [w for w in words if w.endswith((".csv", ".parquet"))]
    return files[-1] if "-o" in words else files[0]
