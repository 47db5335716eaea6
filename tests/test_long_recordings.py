"""Long recordings go through the commands in pieces: to the bit what the whole recording gives."""

import re

import numpy as np
import pytest
from catalogue_cases import lively, plausible, sensors_for

from tiltcal.api.instruments import instrument_of
from tiltcal.api.simulating import pieces_of
from tiltcal.calibration.correction import correct_pieces, corrected_columns
from tiltcal.calibration.result import Calibration, Estimate
from tiltcal.cli import main, output
from tiltcal.core.errors import TiltcalError
from tiltcal.effects import CATALOGUE
from tiltcal.forward.signal_chain import readings
from tiltcal.laboratory.laboratory import SimulatedLaboratory
from tiltcal.laboratory.scenario import parse_scenario
from tiltcal.recordings import span_means
from tiltcal.recordings.parquet_files import PIECE
from tiltcal.recordings.pieces import joined, read_pieces, writing
from tiltcal.recordings.recording import Recording
from tiltcal.recordings.recording_files import read_recording
from tiltcal.recordings.saving import write_recording
from tiltcal.recordings.span_means import read_averaged
from tiltcal.setup.setup import Setup

ROWS = 150_000  # three pieces of Parquet
SETUP = Setup.model_validate(
    {
        "site": {"gravity_m_s2": 9.80123, "latitude_deg": 45.0},
        "rig": {"table": "three"},
        "sensor": [
            {"name": "accel", "kind": "accelerometer", "rate_hz": 100},
            {"name": "level", "kind": "inclinometer", "rate_hz": 100, "axes": ["x", "y"]},
            {"name": "gyro", "kind": "gyro", "rate_hz": 100},
        ],
    }
)


def made_log(rows=ROWS):
    """Three sensors, the triad on every fifth row and silent for a piece, the level with gaps."""
    rng = np.random.default_rng(3)
    time = np.arange(rows) / 100
    columns = {f"accel_{a}_m_s2": rng.normal(0, 1, rows) for a in "xyz"}
    columns["accel_z_m_s2"] += 9.0
    columns |= {f"level_{a}_deg": rng.normal(0, 20, rows) for a in "xy"}
    columns |= {f"gyro_{a}_deg_s": rng.normal(0, 30, rows) for a in "xyz"}
    for name in columns:
        if name.startswith("accel"):
            columns[name][np.arange(rows) % 5 > 0] = np.nan
            columns[name][40_000:120_000] = np.nan
        if name.startswith("level"):
            columns[name][70_000:70_011] = np.nan
    labels = np.array(["+x", None, "+y", "a, b"], dtype=object)[np.arange(rows) // 1000 % 4]
    remarks = np.array([f"row {k}" if k % 3 else None for k in range(rows)], dtype=object)
    return Recording.from_columns(
        time, columns, labels=labels, extra={"remark": remarks}, metadata={"by": "hand"}
    )


def calibration():
    """Every way a reading is corrected: linear, with a missing axis and higher orders, and pulled
    by gravity.
    """
    values = {
        "accel.bias_x": (0.01, "m_s2"),
        "accel.cross_xy": (1e-3, "1"),
        "accel.K2_x": (300.0, "ug_g2"),
        "level.bias_y": (0.02, "m_s2"),
        "level.cross_xz": (2e-3, "1"),
        "gyro.scale_x": (1e-3, "1"),
        "gyro.cross_yz": (1e-3, "1"),
        "gyro.gsens_xz": (20.0, "deg_h_g"),
    }
    parameters = {n: Estimate(v, 0.0, u) for n, (v, u) in values.items()}
    return Calibration(
        "test",
        "good",
        parameters,
        np.zeros((len(values), len(values))),
        provenance={"setup": SETUP.model_dump(mode="json", by_alias=True)},
    )


def assert_same(one, other):
    """Bit by bit."""
    assert one.time.tobytes() == other.time.tobytes()
    assert set(one.column_names) == set(other.column_names)
    for name in other.column_names:
        np.testing.assert_array_equal(one.column(name), other.column(name), err_msg=name)
    assert set(one.texts) == set(other.texts)
    for name, words in other.texts.items():
        assert one.texts[name].tolist() == words.tolist()
    assert one.metadata == other.metadata


@pytest.fixture(scope="module")
def log():
    return made_log()


@pytest.mark.parametrize("suffix", [".csv", ".parquet", ".npz"])
def test_the_pieces_are_the_recording(suffix, log, tmp_path):
    write_recording(log, tmp_path / f"whole{suffix}")
    pieces = list(read_pieces(tmp_path / f"whole{suffix}"))
    assert len(pieces) > 2
    assert_same(joined(pieces), log)
    with writing(tmp_path / f"again{suffix}") as write:
        for piece in pieces:
            write(piece)
    assert_same(read_recording(tmp_path / f"again{suffix}"), log)


def test_pieces_are_corrected_as_the_whole_is(log, tmp_path):
    write_recording(log, path := tmp_path / "log.parquet")
    found = []
    done = correct_pieces(read_pieces(path), calibration(), found.append)
    assert done.rows == ROWS
    assert_same(joined(found), log.with_columns(corrected_columns(log, calibration(), SETUP)))


def test_curves_over_time_and_over_turn_rates_are_corrected_in_pieces(tmp_path):
    """Curves that a diagnosis found on a rate sensor: over the time since the start of the
    recording, and over the rate of a table axis, which its readout tells.
    """
    curve = {"id": "learned", "sensor": "gyro", "role": "found"}
    drift = {"axis": "x", "coordinate": "time", "knots": [0.0, 1500.0]}
    of_rate = {"axis": "y", "coordinate": "turn_rate_inner", "power": 1, "odd": True}
    effects = [
        curve | drift | {"coefficients": [0.0, 0.03]},
        curve | of_rate | {"coefficients": [0.02]},
    ]
    amended = parse_scenario(
        {"schema": 1, **SETUP.model_dump(mode="json", exclude_none=True), "effect": effects}
    )
    time = np.arange(ROWS) / 100
    columns = {f"gyro_{a}_rad_s": np.zeros(ROWS) for a in "xyz"}
    columns["gyro_x_rad_s"] += 0.03 * time / 1500
    columns["gyro_y_rad_s"] += 0.02 * 0.5 * np.cos(0.5 * time)
    inner = np.degrees(np.sin(0.5 * time))
    inner[70_000:70_005] = np.nan
    columns["table_inner_deg"] = inner
    log = Recording.from_columns(time, columns)
    write_recording(log, path := tmp_path / "log.parquet")
    found = instrument_of(amended)
    pieces = []
    correct_pieces(read_pieces(path), found, pieces.append)
    assert len(pieces) > 2
    corrected = joined(pieces)
    assert_same(corrected, log.with_columns(corrected_columns(log, found, amended)))
    for axis in "xy":
        left = corrected.column(f"gyro_{axis}_corrected_rad_s")
        # the last row has but one neighbour, 0.01 s before: half of that times 0.25 rad/s2
        assert np.abs(left).max() < 1.01 * 0.02 * 0.25 * 0.005


@pytest.mark.parametrize(("coordinate", "told"), [("since_move", True), ("time", False)])
def test_what_follows_past_moves_is_noted(coordinate, told):
    curve = {"id": "learned", "sensor": "accel", "axis": "x", "coordinate": coordinate}
    curve |= {"knots": [0.0, 10.0], "coefficients": [0.0, 0.01]}
    amended = parse_scenario(
        {"schema": 1, **SETUP.model_dump(mode="json", exclude_none=True), "effect": [curve]}
    )
    log = Recording.from_columns(
        np.arange(9) / 100,
        {f"accel_{a}_m_s2": np.arange(9.0) for a in "xyz"}
        | {f"table_{a}_deg": np.zeros(9) for a in ("outer", "inner")},
    )
    done = correct_pieces([log], instrument_of(amended), lambda _: None)
    note = "a curve follows the time since the last move, which no stream tells: corrected as at a"
    assert done.notes == [f"{note} standstill"] * told


def test_reading_and_correcting_tell_the_time_left(log, tmp_path, monkeypatch):
    write_recording(log, path := tmp_path / "log.csv")
    calibration().save(tmp_path / "CAL.json")
    corrected, averaged = list[str](), list[str]()
    monkeypatch.setattr(output._Lines, "show", lambda _, text: corrected.append(text))
    words = ["--progress", "correct", tmp_path / "CAL.json", path, "-o", tmp_path / "corrected.csv"]
    assert main([str(word) for word in words]) == 0
    monkeypatch.setattr(span_means, "LONGEST", 10_000)
    read_averaged(path, averaged.append)
    for told in (corrected, averaged):
        found = [re.fullmatch(r"(\d+) of (\d+) rows, .* a second, .* left", text) for text in told]
        taken = [int(match[1]) for match in found]
        assert len(taken) > 1
        assert taken == sorted(taken)
        assert all(0 < rows < ROWS for rows in taken)
        assert abs(int(found[0][2]) / ROWS - 1) < 0.2  # by the length of the first lines


def test_a_long_simulation_tells_the_time_left_and_a_short_one_nothing():
    told = list[str]()
    table = tumble().model_dump(exclude_defaults=True, by_alias=True) | {"schema": 1}
    table["sensor"] = [s for s in table["sensor"] if s["name"] == "accel"]
    pieces = list(pieces_of(parse_scenario(table), None, 4, told.append))
    first, whole = len(pieces[0]), sum(map(len, pieces))
    (said,) = told
    found = re.fullmatch(rf"{first} of (\d+) rows, .* a second, .* left", said)
    assert abs(int(found[1]) - whole) <= 2
    table["sequence"] = table["sequence"][:1]
    assert len(list(pieces_of(parse_scenario(table), None, 4, told.append))) == 1
    assert told == [said]


def test_what_is_wrong_far_into_a_recording_is_named_by_its_row(tmp_path):
    log = made_log()
    log.time[100_000] = log.time[99_999] - 1
    for suffix in (".csv", ".parquet"):
        write_recording(log, path := tmp_path / f"log{suffix}")
        with pytest.raises(TiltcalError) as whole:
            read_recording(path).require_increasing()
        with pytest.raises(TiltcalError, match="data row 100001") as pieces:
            list(read_pieces(path))
        assert str(pieces.value) == str(whole.value)


@pytest.mark.parametrize(
    ("name", "content"),
    [
        ("a.csv", b"time_s,accel_x_m_s2\n"),
        ("a.csv", b""),
        ("a.csv", b"x\n1\n"),
        ("a.parquet", b"?"),
    ],
)
def test_a_recording_without_rows_is_refused_in_the_same_words(name, content, tmp_path):
    (path := tmp_path / name).write_bytes(content)
    with pytest.raises(TiltcalError) as whole:
        read_recording(path)
    with pytest.raises(TiltcalError) as pieces:
        list(read_pieces(path))
    assert str(pieces.value) == str(whole.value)


def test_an_output_that_fails_midway_leaves_nothing(log, tmp_path):
    (tmp_path / "old.parquet").write_text("old")
    other = Recording.from_columns(np.zeros(1), {"b_x_g": np.zeros(1)})
    with pytest.raises(TiltcalError), writing(tmp_path / "old.parquet") as write:
        [write(piece) for piece in (log, other)]
    assert [p.name for p in tmp_path.iterdir()] == ["old.parquet"]
    assert (tmp_path / "old.parquet").read_text() == "old"


# --------------------------------------------------------------------------------------------------
# ---- Simulation


def tumble(effects=()):
    """Half an hour of a triad at 100 Hz and a gyro at 60 Hz on a table that moves."""
    step = {"action": "move", "rate_deg_s": 30, "dwell_s": 130}
    return parse_scenario(
        {
            "schema": 1,
            "name": "long",
            "site": {"gravity_m_s2": 9.80123, "latitude_deg": 45.0},
            "rig": {"table": "dual"},
            "climate": {"ramp_degC_h": 3.0},
            "sensor": [
                {"name": "accel", "kind": "accelerometer", "rate_hz": 100},
                {"name": "gyro", "kind": "gyro", "rate_hz": 60},
            ],
            "sequence": [
                step | {"outer_deg": 40.0 * k, "inner_deg": 70.0 * k, "label": f"pose {k}"}
                for k in range(12)
            ],
            "effect": list(effects),
        }
    )


def test_a_long_recording_is_simulated_in_pieces_to_the_bit():
    scenario = tumble(
        [
            {"id": "acc_bias", "bias_x_ug": 300},
            {"id": "acc_noise", "white_ug_rthz": 40, "flicker_ug": 8, "walk_ug_rts": 0.3},
            {"id": "gyr_noise", "white_deg_rth": 0.3, "flicker_deg_h": 8},
            {"id": "adc_quantisation", "sensor": "gyro", "lsb_si": 1e-5},
        ]
    )
    pieces = list(SimulatedLaboratory().record_pieces(scenario, 4))
    assert [len(p) > PIECE // 2 for p in pieces] == [True] * 2
    assert_same(joined(pieces), SimulatedLaboratory().record(scenario, 4))


def test_what_looks_over_the_whole_recording_is_simulated_in_one_go():
    scenario = tumble([{"id": "acc_bandwidth", "tau_ms": 20}])
    (only,) = SimulatedLaboratory().record_pieces(scenario, 4)
    assert_same(only, SimulatedLaboratory().record(scenario, 4))


@pytest.mark.parametrize("id", [e for e, cls in CATALOGUE.items() if cls.row_wise])
@pytest.mark.parametrize("table", ["dual", "three"])
def test_an_effect_that_says_so_acts_row_by_row(id, table):
    setup, course, times = lively(table)
    parts = np.split(times["accel"], [313, 640])
    for sensor in sensors_for(CATALOGUE[id], setup):
        effect = plausible(id, setup, sensor)
        whole = readings(setup, course, times, [effect], seed=2)
        pieces = [
            readings(setup, course, dict.fromkeys(times, part), [effect], seed=2) for part in parts
        ]
        for name, values in whole.items():
            np.testing.assert_array_equal(np.concatenate([p[name] for p in pieces]), values)
