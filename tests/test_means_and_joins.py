"""Tables of means in place of logs, several recordings of one set-up, and the verdict that a
calibration carries along.
"""

import json

import examiner.judge  # noqa: F401  registers the makers
import numpy as np
import pytest
from builders import ACCEL, FOG, GYRO, G, setup_of
from examiner.case import MAKERS
from logs import log_of, triad_readings
from statistics_helpers import rng_of

from tiltcal.calibration.methods.registry import calibrate
from tiltcal.cli import main
from tiltcal.core.errors import TiltcalError
from tiltcal.recordings.joining import joined
from tiltcal.recordings.means_table import MeansTable, read_log_or_means
from tiltcal.recordings.recording import Recording
from tiltcal.recordings.saving import write_recording
from tiltcal.recordings.segmentation import find_segments

FACES = ["+x", "-x", "+y", "-y", "+z", "-z"]
UP = np.array([[1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, 1], [0, 0, -1]], dtype=float)
BIAS = np.array([0.12, -0.08, 0.15])
M = np.array([[1.004, 0.003, -0.0015], [0.002, 0.997, 0.0022], [-0.0015, 0.0032, 1.0025]])
SETUP = setup_of("handheld", ACCEL)
MEANS = triad_readings(UP, G, BIAS, M)


def table_of(folder, means=MEANS, sigma="accel_sigma_m_s2", words=FACES):
    rows = [f"{w},{','.join(repr(float(v)) for v in m)},0.0001" for w, m in zip(words, means)]
    path = folder / "means.csv"
    head = f"label,accel_x_m_s2,accel_y_m_s2,accel_z_m_s2,{sigma}"
    path.write_text("\n".join([head, *rows]) + "\n")
    return path


@pytest.mark.parametrize("sigma", ["accel_sigma_m_s2", "sigma_m_s2"])
def test_six_means_with_their_sigma_give_the_parameters_and_propagated_sigmas(tmp_path, sigma):
    table = read_log_or_means(table_of(tmp_path, sigma=sigma))
    assert isinstance(table, MeansTable)
    found = calibrate("six_position", table, SETUP)
    assert found.verdict == "good"
    for i, a in enumerate("xyz"):
        assert found.value(f"accel.bias_{a}") == pytest.approx(BIAS[i], abs=1e-12)
        assert found.value(f"accel.scale_{a}") == pytest.approx(M[i, i] - 1, abs=1e-12)
        # the mean of six readings, and half the difference of two over g
        assert found.parameters[f"accel.bias_{a}"].sigma == pytest.approx(1e-4 / np.sqrt(6))
        assert found.parameters[f"accel.scale_{a}"].sigma == pytest.approx(1e-4 / np.sqrt(2) / G)


def test_norm_takes_means_and_a_method_that_looks_inside_dwells_says_what_it_needs(tmp_path):
    rng = rng_of("means")
    up = rng.normal(size=(14, 3))
    up /= np.linalg.norm(up, axis=1)[:, None]
    S = (M + M.T) / 2
    means = triad_readings(up, G, BIAS, S) + rng.normal(0, 1e-4, (14, 3))
    path = table_of(tmp_path, means, words=[f"pose {k}" for k in range(14)])
    found = calibrate("norm", read_log_or_means(path), SETUP)
    for i, a in enumerate("xyz"):
        z = (found.value(f"accel.bias_{a}") - BIAS[i]) / found.parameters[f"accel.bias_{a}"].sigma
        assert abs(z) < 4
    with pytest.raises(TiltcalError, match="found a table of means, need the readings inside"):
        calibrate("norm", read_log_or_means(path), SETUP, drift=True)
    with pytest.raises(TiltcalError, match="means are enough for six_position"):
        calibrate("two_position", read_log_or_means(path), setup_of("vertical", ACCEL))


def test_means_without_a_sigma_are_refused_in_words(tmp_path):
    path = table_of(tmp_path, sigma="gyro_sigma_rad_s")
    with pytest.raises(TiltcalError, match="need a column accel_sigma_m_s2"):
        calibrate("six_position", read_log_or_means(path), SETUP)


def test_a_row_with_an_empty_cell_is_left_out(tmp_path):
    path = table_of(tmp_path)
    lines = path.read_text().splitlines()
    path.write_text("\n".join([*lines, "+x,,0.1,0.2,0.0001"]) + "\n")
    found = calibrate("six_position", read_log_or_means(path), SETUP)
    assert len(found.poses) == 6
    assert found.value("accel.bias_x") == pytest.approx(BIAS[0], abs=1e-12)


def part(faces, rng):
    clean = triad_readings(UP[faces], G, BIAS, M)
    rows = len(log_of(clean, ACCEL))
    labels = [FACES[k] for k in faces]
    return log_of(clean, ACCEL, labels=labels, noise=rng.normal(0, 1e-3, (rows, 3)))


def test_two_recordings_are_one_with_no_dwell_across_them():
    rng = rng_of("two parts")
    one, two = part([0, 1, 2], rng), part([2, 3, 4, 5], rng)
    both = joined([one, two], "identity")
    assert len(both) == len(one) + len(two)
    ends = one.time[-1] - one.time[0]
    found = find_segments(both)
    assert not any(s.start < ends and s.end > ends + 1 for s in found if s.kind == "dwell")
    result = calibrate("six_position", both, SETUP)
    assert result.verdict == "good"
    assert len(result.poses) == 7


def test_mountings_of_joined_recordings_hold_from_their_own_times():
    rng = rng_of("mounts")
    one, two = part([0, 1], rng), part([2, 3], rng)
    two.metadata["mount"] = "Rz(90); 3 s: Rz(180)"
    both = joined([one, two], "identity")
    assert both.metadata["mount"].startswith("identity; ")
    assert both.metadata["mount"].count("Rz(90)") == 1
    start = float(both.metadata["mount"].split(";")[1].split(" s:")[0])
    assert one.time[-1] < start < one.time[-1] + 60.0


def test_the_command_takes_several_recordings_and_correct_says_the_verdict(tmp_path, capsys):
    rng = rng_of("command")
    scenario = tmp_path / "bench.toml"
    scenario.write_text(
        'schema = 1\nname = "bench"\n[site]\ngravity_m_s2 = 9.80123\n[rig]\ntable = "handheld"\n'
        '[[sensor]]\nname = "accel"\nkind = "accelerometer"\nrate_hz = 20\n'
    )
    for name, faces in (("one", [0, 1, 2, 3]), ("two", [4, 5])):
        write_recording(part(faces, rng), tmp_path / f"{name}.csv")
    files = [str(tmp_path / f"{name}.csv") for name in ("one", "two")]
    cal = str(tmp_path / "CAL.json")
    words = ["--scenario", str(scenario), "--method", "six_position", "-o", cal]
    assert main(["calibrate", *files, *words]) == 0
    assert len(json.loads((tmp_path / "CAL.json").read_text())["poses"]) == 6
    capsys.readouterr()
    assert main(["correct", cal, files[0], "-o", str(tmp_path / "out.csv")]) == 0
    assert "calibration by six_position: good" in capsys.readouterr().err
    assert main(["calibrate", files[0], *words]) == 1
    assert main(["correct", cal, files[0], "-o", str(tmp_path / "out.csv")]) == 0
    said = capsys.readouterr().err
    assert "calibration by six_position: suspect" in said or "cannot_tell" in said
    assert "no pose within 60 deg of +z, -z up" in said


def test_days_of_a_field_calibration_share_the_scale_and_keep_their_bias():
    parts, truth = [], None
    for k in range(2):
        case = MAKERS["fog_scale"](np.random.default_rng([5, k]), "clean")
        truth = truth or case.truth
        gyro = {n: v for n, v in case.columns.items() if n.startswith("gyro")}
        for axis in "xyz":  # the first day's scale factors in both recordings
            own, first = case.truth[f"gyro.scale_{axis}"], truth[f"gyro.scale_{axis}"]
            gyro[f"gyro_{axis}_rad_s"] = gyro[f"gyro_{axis}_rad_s"] * (1 + first) / (1 + own)
        parts.append(Recording.from_columns(case.time, {**case.columns, **gyro}))
    setup = setup_of(
        "handheld", *(s.model_copy(update={"rate_hz": 100.0}) for s in (GYRO, FOG, ACCEL))
    )
    alone = [calibrate("fog_scale", p, setup) for p in parts]
    both = calibrate("fog_scale", joined(parts, "identity"), setup)
    assert both.verdict == "good"
    for axis in "xyz":
        name = f"gyro.scale_{axis}"
        sigma = both.parameters[name].sigma
        assert sigma < min(a.parameters[name].sigma for a in alone)
        assert abs(both.value(name) - truth[name]) < 4 * sigma
        day = alone[1].value(f"gyro.bias_{axis}")
        assert both.value(f"gyro.bias_{axis}") == pytest.approx(day, rel=1e-9)
    assert sum("bias of recording" in w for w in both.warnings) == 2
    # an axis error is common to all days: 0.1 deg across (1, 1, 1) is 0.1 deg sqrt 2 of scale
    stated = calibrate("fog_scale", joined(parts, "identity"), setup, axis_error_deg=0.1)
    own = both.parameters["gyro.scale_x"].sigma
    expected = np.hypot(own, np.radians(0.1) * np.sqrt(2))
    assert stated.parameters["gyro.scale_x"].sigma == pytest.approx(expected)


def test_correct_names_a_channel_that_is_dead(tmp_path, capsys):
    found = calibrate("six_position", part(range(6), rng_of("good part")), SETUP)
    found.save(tmp_path / "CAL.json")
    log = part([0, 1], rng_of("dead part"))
    dead = log.with_columns({})
    columns = {n: dead.column(n) for n in dead.column_names if n.startswith("accel")}
    columns["accel_y_m_s2"] = np.zeros(len(log))
    write_recording(Recording.from_columns(log.time, columns), tmp_path / "dead.csv")
    words = ["correct", str(tmp_path / "CAL.json"), str(tmp_path / "dead.csv")]
    assert main([*words, "-o", str(tmp_path / "out.csv")]) == 0
    assert "accel_y_m_s2: constant throughout, dead or disconnected" in capsys.readouterr().err


def test_means_of_poses_that_were_repeated_need_no_sigma(tmp_path):
    """Four trials of six faces, one row each: their scatter is the noise of a mean."""
    rng = rng_of("trials")
    rows = ["label,accel_x_m_s2,accel_y_m_s2,accel_z_m_s2"]
    for _ in range(4):
        for word, mean in zip(FACES, MEANS, strict=True):
            read = mean + rng.normal(0, 2e-3, 3)
            rows.append(f"{word},{','.join(repr(float(v)) for v in read)}")
    (tmp_path / "trials.csv").write_text("\n".join(rows) + "\n")
    table = read_log_or_means(tmp_path / "trials.csv")
    assert isinstance(table, MeansTable)
    found = calibrate("six_position", table, SETUP)
    assert len(found.poses) == 24
    assert found.verdict == "good"
    # each axis up and down four times: 2e-3 m/s2 over g and the root of eight
    assert found.parameters["accel.scale_x"].sigma == pytest.approx(2e-3 / G / np.sqrt(8), rel=0.4)
    timed = [f"time_s,{rows[0]}", *(f"{60 * k},{row}" for k, row in enumerate(rows[1:]))]
    (tmp_path / "timed.csv").write_text("\n".join(timed) + "\n")
    again = calibrate("six_position", read_log_or_means(tmp_path / "timed.csv"), SETUP)
    assert again.value("accel.scale_x") == found.value("accel.scale_x")
    assert again.poses[-1].start_s == 23 * 60
