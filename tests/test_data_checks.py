"""The checks of the data: silent on sound logs, each finds its own fault at the size it states, and
every command says it in the same words.
"""

import json
from collections import Counter

import numpy as np
import pytest
from checks_page import PAGE, page
from sound_logs import sound_log
from statistics_helpers import rng_of

from tiltcal.cli import main
from tiltcal.data_quality.log import Log
from tiltcal.data_quality.registry import CHECKS, REPAIRS, inspect_log, repair_log
from tiltcal.recordings.recording import Recording
from tiltcal.recordings.saving import write_recording

LOGS = 500
FORCE = 9.80665 * np.array([0.3, -0.2, 0.93])


def kinds(time, columns):
    rates = {n: 50.0 for n in columns if n.startswith("stated_")}
    return [f.kind for f in inspect_log(Log.of(time, columns, rates=rates)).findings]


def test_no_check_finds_a_fault_in_sound_logs():
    """At 1e-6 a channel nothing is expected in 500 logs of up to nine."""
    found = Counter()
    for k in range(LOGS):
        found.update(kinds(*sound_log(rng_of(f"sound log {k}"))))
    assert not found, found


def plain(rng, n=4000, noise=0.01, lsb=0.0):
    """A triad at three attitudes in m/s2, 100 Hz."""
    order = np.repeat(np.arange(3), n // 3 + 1)[:n]
    values = np.array([np.roll(FORCE, k) for k in order]) + noise * rng.normal(size=(n, 3))
    values = np.round(values / lsb) * lsb if lsb else values
    return np.arange(n) / 100, {f"accel_{a}_m_s2": values[:, i] for i, a in enumerate("xyz")}


def with_x(made, change):
    time, columns = made
    x = columns["accel_x_m_s2"].copy()
    change(x)
    return time, columns | {"accel_x_m_s2": x}


def moved(made, change):
    time, columns = made
    return change(time.copy()), columns


def unsigned(values):
    codes = np.rint(values * 1671).astype(np.int64)
    return np.mod(codes, 2**16).astype(float)


def swung(rng):
    """A triad that swings through zero, in codes of 16 bits read without sign."""
    swing = 9.8 * np.sin(np.arange(4000) / 150)[:, None] + 0.01 * rng.normal(size=(4000, 3))
    return np.arange(4000) / 100, {f"a_{x}_LSB": unsigned(swing[:, i]) for i, x in enumerate("xyz")}


def doubled(made):
    time, columns = made
    return time, columns | {"accel_x_m_s2": columns["accel_y_m_s2"]}


def in_g(time, columns):
    return time, {n: v / 9.80665 for n, v in columns.items()}


def alternate(x):
    x += 0.03 * (np.arange(len(x)) % 2)


def frozen(x):
    x[1000:1040] = x[1000]


def clipped(x):
    np.minimum(x, 9.1, out=x)


def sent_twice(x):
    again = np.arange(50, len(x), 100)
    x[again] = x[again - 1]


def spikes(x):
    x[[500, 900, 1800, 2100, 2900, 3500]] += 0.2  # 20 sigma


def lacking_bit(rng):
    swing = 9.8 * np.sin(np.arange(6000) / 900) + 0.002 * rng.normal(size=6000)
    codes = np.rint(swing / 5e-4).astype(np.int64) & ~np.int64(1 << 6)
    return np.arange(6000) / 100, {"a_x_m_s2": codes * 5e-4}


def bursts(time):
    return np.repeat(time[::8], 8)[: len(time)] + 1e-4 * (np.arange(len(time)) % 8)


def wrapped(time):
    return np.mod(time + 5.0, 20.0)


FAULTS = {
    "time_wrap": lambda rng: moved(plain(rng), wrapped),
    "time_back": lambda rng: moved(plain(rng), lambda t: np.where(t == t[700], t - 0.1, t)),
    "time_coarse": lambda rng: moved(plain(rng), np.floor),
    "time_repeated": lambda rng: moved(plain(rng), lambda t: np.where(t == t[700], t[699], t)),
    "gap": lambda rng: moved(plain(rng), lambda t: t + 0.02 * (t > 7.0)),
    "time_bursts": lambda rng: moved(plain(rng), bursts),
    "rate": lambda rng: (
        plain(rng)[0] / 0.94 * 2,
        {"stated_x_m_s2": plain(rng)[1]["accel_x_m_s2"]},
    ),
    "missing": lambda rng: with_x(plain(rng), lambda x: x.__setitem__(700, np.nan)),
    "wrap": lambda _: (
        np.arange(900) / 10,
        {"table_outer_deg": np.mod(np.arange(900) / 1.7, 360)},
    ),
    "dead": lambda rng: with_x(plain(rng), lambda x: x.fill(1.0)),
    "equal_columns": lambda rng: doubled(plain(rng)),
    "alternating": lambda rng: with_x(plain(rng), alternate),
    "sign_extension": swung,
    "coarse": lambda rng: plain(rng, noise=0.01, lsb=0.02),
    "stuck_bit": lacking_bit,
    "frozen": lambda rng: with_x(plain(rng), frozen),
    "clipped": lambda rng: with_x(plain(rng), clipped),
    "repeated": lambda rng: with_x(plain(rng), sent_twice),
    "spikes": lambda rng: with_x(plain(rng), spikes),
    "gravity": lambda rng: in_g(*plain(rng)),
    "inclination": lambda rng: (
        np.arange(900) / 10,
        {"incl_x_deg": 3600 * np.sin(np.arange(900) / 90) + rng.normal(size=900)},
    ),
    "temperature": lambda rng: (
        np.arange(900) / 10,
        {"temperature_degC": 293 + 0.1 * rng.normal(size=900)},
    ),
}


@pytest.mark.parametrize("check", CHECKS, ids=lambda check: check.name)
def test_each_check_finds_its_fault_at_the_size_that_it_states(check):
    for k in range(10):
        time, columns = FAULTS[check.name](rng_of(f"fault {check.name} {k}"))
        found = kinds(time, columns)
        assert check.name in found, found


@pytest.mark.parametrize("name", REPAIRS)
def test_what_is_repaired_is_not_found_again(name):
    check = REPAIRS[name]
    time, columns = FAULTS[check.name](rng_of(f"repair {name}"))
    log, reports = repair_log(Log.of(time, columns), [name])
    assert len(reports) == 1
    assert check.name not in [f.kind for f in inspect_log(log).findings]


def test_the_page_of_the_checks_is_made_from_them():
    assert PAGE.read_text(encoding="utf-8") == page()


BENCH = """\
schema = 1
name = "bench"
[site]
gravity_m_s2 = 9.80665
[rig]
table = "handheld"
[[sensor]]
name = "accel"
kind = "accelerometer"
rate_hz = 100
adjustable = ["bias", "scale", "cross_axis"]
"""
MAP = """\
[time]
column = "time_s"
[[column]]
from = "accel_x_m_s2"
to = "accel_x_m_s2"
[[column]]
from = "accel_y_m_s2"
to = "accel_y_m_s2"
[[column]]
from = "accel_z_m_s2"
to = "accel_z_m_s2"
"""


def twelve_positions(rng):
    """Up in the body, (4800, 3): positions by hand with moves between them."""
    up = rng.normal(size=(12, 3))
    up /= np.linalg.norm(up, axis=1)[:, None]
    knots = np.concatenate([[400 * k, 400 * k + 340] for k in range(12)])
    return np.column_stack([np.interp(np.arange(4800), knots, np.repeat(u, 2)) for u in up.T])


def test_import_calibrate_and_diagnose_say_the_same(tmp_path, capsys):
    """A channel that froze in one of twelve positions by hand."""
    rng = rng_of("same words")
    turned = twelve_positions(rng)
    force = 9.80665 * turned + 0.01 * rng.normal(size=turned.shape)
    force[2050:2150, 0] = force[2050, 0]
    time = np.arange(len(force)) / 100
    lines = [f"{t:.2f},{x:.5f},{y:.5f},{z:.5f}" for t, (x, y, z) in zip(time, force, strict=True)]
    head = "time_s,accel_x_m_s2,accel_y_m_s2,accel_z_m_s2"
    (tmp_path / "log.csv").write_text("\n".join([head, *lines]) + "\n")
    (tmp_path / "map.toml").write_text(MAP)
    (tmp_path / "bench.toml").write_text(BENCH)
    log, bench, out = (str(tmp_path / n) for n in ("log.csv", "bench.toml", "out"))
    words = ["import", log, "--map", str(tmp_path / "map.toml"), "-o", str(tmp_path / "r.csv")]
    assert main([*words, "--json"]) == 0
    (finding,) = json.loads(capsys.readouterr().out)["findings"]
    assert finding["kind"] == "frozen"
    words = ["calibrate", log, "--scenario", bench, "--method", "norm"]
    main([*words, "-o", str(tmp_path / "cal.json")])
    tests = json.loads((tmp_path / "cal.json").read_text())["tests"]
    assert finding["statement"] in [t["statement"] for t in tests if not t["passed"]]
    main(["diagnose", log, "--scenario", bench, "-o", out])
    capsys.readouterr()
    assert finding["statement"] in (tmp_path / "out" / "diagnosis.json").read_text()
    main(["noise", log, "--json"])
    assert [f["statement"] for f in json.loads(capsys.readouterr().out)["findings"]] == [
        finding["statement"]
    ]
    main(["init", "--from", log, "-o", str(tmp_path / "new.toml"), "--latitude", "50"])
    assert finding["statement"] in capsys.readouterr().err.replace("\n    ", " ")


def test_a_raw_gyro_is_one_and_does_not_keep_the_accelerometer_from_being_calibrated(tmp_path):
    """Readings of a gyro in LSB without a stated scale: ``init`` says so, ``norm`` needs none."""
    rng = rng_of("raw gyro")
    turned = twelve_positions(rng)
    force = 9.80665 * turned + 0.01 * rng.normal(size=turned.shape)
    rate = 5000 * np.gradient(turned, axis=0)[:, [1, 2, 0]] + 20 * rng.normal(size=turned.shape)
    columns = {f"accel_{a}_m_s2": force[:, i] for i, a in enumerate("xyz")}
    columns |= {f"gyro_{a}_LSB": np.round(rate[:, i]) for i, a in enumerate("xyz")}
    log = str(tmp_path / "log.csv")
    write_recording(Recording.from_columns(np.arange(4800) / 100, columns), log)
    bench = str(tmp_path / "bench.toml")
    assert main(["init", "--from", log, "-o", bench, "--latitude", "50"]) == 0
    assert 'kind = "gyro"' in (tmp_path / "bench.toml").read_text()
    assert main(["calibrate", log, "--scenario", bench, "--method", "norm"]) == 0
