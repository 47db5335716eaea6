"""A small scenario on disk with everything that the commands make of it, for the tests of the
command line.
"""

import re
from pathlib import Path

import pytest

from tiltcal.cli import main

HEAD = """\
schema = 1
name = "bench"
seed = 5
[site]
gravity_m_s2 = 9.80123
latitude_deg = 39.9
[rig]
table = "dual"
[[sensor]]
name = "accel"
kind = "accelerometer"
rate_hz = 50
adjustable = ["bias", "scale", "cross_axis"]
"""
EFFECTS = """\
[[effect]]
id = "acc_noise"
white_ug_rthz = 50
[[effect]]
id = "acc_bias"
bias_x_ug = 3000
bias_y_ug = -1500
[[effect]]
id = "acc_scale"
scale_z_ppm = 1200
"""
FACES = (
    (0, 0, "+z"),
    (90, 0, "+y"),
    (180, 0, "-z"),
    (270, 0, "-y"),
    (90, 90, "+x"),
    (90, 270, "-x"),
)
SEQUENCE = "".join(
    f'[[sequence]]\naction = "move"\nouter_deg = {a}\ninner_deg = {b}\ndwell_s = 3\nrate_deg_s ='
    f' 90\nlabel = "{c}"\n'
    for a, b, c in FACES
)
METHOD = '[[method]]\nname = "six_position"\n[method.accept]\nbetter_by = 5\n'
BENCH_SCENARIO = HEAD + EFFECTS + SEQUENCE + METHOD


def make_files(folder: Path) -> Path:
    """bench.toml, run.csv, truth.json, CAL.json and SEG.csv in ``folder``."""
    (folder / "bench.toml").write_text(BENCH_SCENARIO)
    at = {
        name: str(folder / name)
        for name in ("bench.toml", "run.csv", "truth.json", "CAL.json", "SEG.csv")
    }
    assert (
        main(["simulate", at["bench.toml"], "-o", at["run.csv"], "--truth", at["truth.json"]]) == 0
    )
    assert main(["segments", at["run.csv"], "-o", at["SEG.csv"]]) == 0
    words = [
        "calibrate",
        at["run.csv"],
        "--scenario",
        at["bench.toml"],
        "--method",
        "six_position",
        "-o",
        at["CAL.json"],
    ]
    assert main(words) == 0
    return folder


def refusal(arguments: list[object], folder: Path, capsys: pytest.CaptureFixture[str]) -> str:
    """The one message of a command that refuses its input and leaves ``folder`` as it was."""
    before = {p: p.read_bytes() for p in folder.rglob("*") if p.is_file()}
    capsys.readouterr()
    status = main([str(a) for a in arguments])
    out, err = capsys.readouterr()
    assert (status, out) == (2, ""), err
    assert "Traceback" not in err
    assert "internal error" not in err
    assert len(re.findall(r"^tiltcal: ", err, re.MULTILINE)) == 1
    message = err[err.index("tiltcal: ") :]
    assert re.fullmatch(r"tiltcal: .+: found .+, need .+; .+\n", message, re.DOTALL), message
    assert {p: p.read_bytes() for p in folder.rglob("*") if p.is_file()} == before
    return message
