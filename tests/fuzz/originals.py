"""The sound files that are mutated: small scenarios, and all that the commands make of them."""

import contextlib
import io
import json
import os
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import tomli_w
from scipy.io import savemat

from tests.scenario_files import BENCH_SCENARIO
from tests.test_formats import FORCE, TIME, hdf5, ros1_bag, tdms, ulog_bytes
from tiltcal.cli import main
from tiltcal.core.assets import folder
from tiltcal.laboratory.scenario import load_scenario

RATES = {
    "norm": ("norm_by_hand", 10),
    "incl": ("two_position_level", 10),
    "placing": ("placing_table_one_axis", 10),
    "fog": ("fog_scale_by_hand", 10),
    "turns": ("gyro_turns_by_hand", 10),
    "rates": ("gyro_rates_three", 10),
    "north": ("north_four_positions", 10),
}
"""Names of small scenarios: the built-in scenario each comes from, and its sample rate in Hz."""
MAP = """\
[file]
header = true
[time]
rate_hz = 10
[[column]]
from = "x"
to = "accel_x_g"
[[column]]
from = 2
to = "accel_y_g"
scale = 2.0
"""
CAMPAIGN = """\
schema = 1
scenario = "bench.toml"
name = "bias"
runs = 1
[[factor]]
field = "effect.acc_bias.bias_x_ug"
start = 0
stop = 100
count = 2
"""
ARM = """\
schema = 1
name = "arm"
seed = 1
[site]
gravity_m_s2 = 9.8
[rig]
mjcf = "arm.xml"
site = "tool"
[rig.axes]
pan = "pan"
lift = "lift"
[[sensor]]
name = "accel"
kind = "accelerometer"
rate_hz = 10
[[sequence]]
action = "move"
pan_deg = 20
lift_deg = -30
dwell_s = 3
[[effect]]
id = "joint_axis_tilt"
axis = "lift"
tilt_x_arcsec = 40
"""
SEQUENCE = """\
step,action,outer_deg,inner_deg,rate_deg_s,dwell_s,mount,label
1,rest,,,,2,,
2,move,10,20,20,3,,first
3,remount,,,,,Rz(180),
4,turn,50,,,1,,
"""
OWN_METHOD = """\
from tiltcal.calibration.result import Calibration
import numpy as np


def fails(recording, setup, *, size=1):
    return np.zeros(2)[int(size) + 2]


def nothing(recording, setup):
    return Calibration("nothing", "cannot_tell", {}, np.zeros((0, 0)))
"""


@contextlib.contextmanager
def inside(place: Path) -> Iterator[None]:
    """That folder as the working folder."""
    before = Path.cwd()
    os.chdir(place)
    try:
        yield
    finally:
        os.chdir(before)


def quietly(*words: str) -> int:
    """The exit status of a command whose output nobody reads."""
    with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(io.StringIO()):
        return main(words)


def make_originals(place: Path) -> dict[str, bytes]:
    """Every sound file by its path below ``place``."""
    with inside(place):
        Path("bench.toml").write_text(BENCH_SCENARIO.replace("rate_hz = 50", "rate_hz = 10"))
        for name, (scenario, rate) in RATES.items():
            Path(f"{name}.toml").write_text(slow(scenario, rate))
        for name in ("bench", *RATES):
            require(quietly("simulate", f"{name}.toml", "-o", f"{name}.csv"), name)
        calibrate_all()
        Path("map.toml").write_text(MAP)
        Path("log.txt").write_text("x,y,z\n" + "".join(f"{k},{2 * k},{3 * k}\n" for k in range(30)))
        Path("campaign.toml").write_text(CAMPAIGN)
        Path("sequence.csv").write_text(SEQUENCE)
        Path("own.py").write_text(OWN_METHOD)
        Path("still.csv").write_text(first_rows("bench.csv", 40))
        investigation()
        foreign_logs()
        own_arm()
        require(quietly("campaign", "campaign.toml", "-o", "shard"), "campaign")
    return {
        str(p.relative_to(place)): p.read_bytes() for p in sorted(place.rglob("*")) if p.is_file()
    }


def slow(name: str, rate: float) -> str:
    """A built-in scenario without time steps, with few samples."""
    whole = load_scenario(folder("scenarios") / f"{name}.toml").model_dump(
        by_alias=True, exclude_defaults=True, mode="json"
    )
    sensors = [s | {"rate_hz": rate} for s in whole["sensor"]]
    methods = [m | {"runs": 1} for m in whole.get("method", ())]
    changed = {"schema": 1} | whole | {"sensor": sensors, "method": methods}
    return tomli_w.dumps({k: v for k, v in changed.items() if k != "dynamics"})


def calibrate_all() -> None:
    """Recordings of other formats, calibrations, dwells and a diagnosis."""
    for ending in ("npz", "parquet"):
        require(quietly("simulate", "bench.toml", "-o", f"bench.{ending}"), ending)
    words = "calibrate bench.csv --scenario bench.toml --method six_position -o CAL.json"
    require(quietly(*words.split()), "six_position")
    words = "calibrate placing.csv --scenario placing.toml --method placing_table -o TABLE.json"
    quietly(*words.split())
    require(0 if Path("TABLE.json").exists() else 2, "placing_table")
    require(quietly("segments", "bench.csv", "-o", "SEG.csv"), "segments")
    require(quietly("diagnose", "bench.csv", "--scenario", "bench.toml", "-o", "found"), "diagnose")


def investigation() -> None:
    """An investigation that has ended, to be resumed."""
    words = "investigate bench.csv --scenario bench.toml --lab true -o looked"
    require(quietly(*words.split()), "investigate")
    state = json.loads(Path("looked/investigation.json").read_text())
    state["given"] = ["bench.csv"]
    Path("looked/investigation.json").write_text(json.dumps(state))


def foreign_logs() -> None:
    """Logs of other programs, and another calibration of the same instrument."""
    hdf5(Path("log.h5"), False)
    tdms(Path("log.tdms"))
    ros1_bag(Path("log.bag"))
    Path("log.ulg").write_bytes(ulog_bytes())
    savemat("log.mat", {"t": TIME, "acc": FORCE})
    savemat("log4.mat", {"t": TIME, "acc": FORCE}, format="4")
    np.savez("log.npz", t=TIME, acc=FORCE)
    require(quietly("export", "bench.csv", "-o", "log.mcap"), "mcap")
    require(quietly("import", "log.h5", "--propose", "-o", "h5.toml"), "h5.toml")
    Path("LATER.json").write_bytes(Path("CAL.json").read_bytes())
    require(quietly("export", "found/amended.toml", "-o", "sysid.yaml"), "sysid")
    words = "design bench.toml --terms bias --budget-s 60 -o plan"
    require(quietly(*words.split()), "design")


def own_arm() -> None:
    """A scenario on a model of one's own."""
    Path("arm.xml").write_bytes((folder("scenarios") / "arm" / "arm.xml").read_bytes())
    Path("arm.toml").write_text(ARM)
    require(quietly("simulate", "arm.toml", "-o", "arm.csv"), "arm")


def first_rows(name: str, count: int) -> str:
    """The beginning of a recording."""
    lines = Path(name).read_text().splitlines(keepends=True)
    return "".join(lines[:count])


def require(status: int, what: str) -> None:
    """Stop when a sound input is refused."""
    if status not in (0, 1):
        raise SystemExit(f"fuzz: the sound files of {what} cannot be made")
