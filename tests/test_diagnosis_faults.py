"""Faults of the data are named, placed and mended before any physics is looked for."""

from dataclasses import replace

import numpy as np
import pytest
from diagnosis_fixtures import (
    BY_HAND,
    bench,
    faults_of,
    honest,
    recorded,
    rewritten,
    stating,
    turned_by_hand,
)
from statistics_helpers import rng_of

from tiltcal.core.errors import TiltcalError
from tiltcal.data_quality.log import repeat_chance
from tiltcal.diagnosis.conclusions.finding import verdict_of
from tiltcal.diagnosis.conclusions.statements import implausible
from tiltcal.diagnosis.data.observations import Channel
from tiltcal.diagnosis.data_faults.inspection import LeftOut, by_recording, inspect
from tiltcal.diagnosis.data_faults.lost_samples import loss_by_moves, lost_as_another
from tiltcal.diagnosis.data_faults.prepare import prepare
from tiltcal.diagnosis.data_faults.readout_jumps import jump_of
from tiltcal.diagnosis.data_faults.units_signs_axes import find_labelling_faults
from tiltcal.diagnosis.diagnose import diagnose
from tiltcal.diagnosis.lines.spectral_lines import spectral_lines_of
from tiltcal.effects.spans import SpectralLines
from tiltcal.laboratory.scenario import parse_scenario
from tiltcal.recordings.recording import Recording
from tiltcal.statistics.dwell_noise import white_at_standstill


def x_of(recording):
    return recording.column("accel_x_m_s2").copy()


def test_a_sound_recording_has_none(truth, sound):
    assert faults_of(truth, sound) == {}


def test_a_frozen_channel(truth, sound):
    x = x_of(sound)
    x[400:460] = x[400]
    fault = faults_of(truth, rewritten(sound, accel_x_m_s2=x))["data_stuck"]
    assert fault.axes == ("x",)
    assert fault.interval == pytest.approx((40.0, 45.9), abs=0.2)


def test_repeated_samples(truth, sound, rng):
    columns = {}
    again = rng.random(len(sound)) < 0.05
    again[0] = False
    source = np.maximum.accumulate(np.where(again, 0, np.arange(len(sound))))
    for axis in "xyz":
        columns[f"accel_{axis}_m_s2"] = sound.column(f"accel_{axis}_m_s2")[source]
    fault = faults_of(truth, rewritten(sound, **columns))["data_duplicate"]
    assert fault.effect.value("share") == pytest.approx(again.mean(), rel=0.1)


def test_rows_that_repeat_on_all_axes_at_once(truth, sound, rng):
    """0.6 % of the rows: on each axis alone chance repeats more often."""
    moved = np.hypot(*(np.diff(sound.column(f"table_{a}_deg")) for a in ("outer", "inner")))
    again = rng.choice(np.flatnonzero(moved < 1e-3) + 1, len(sound) * 6 // 1000, replace=False)
    columns = {}
    for axis in "xyz":
        name = f"accel_{axis}_m_s2"
        code = 0.2 * np.median(np.abs(np.diff(sound.column(name))))
        values = np.rint(sound.column(name) / code) * code
        values[again] = values[again - 1]
        columns[name] = values
    (fault,) = prepare(honest(truth), [rewritten(sound, **columns)]).faults
    assert fault.effect.id == "data_duplicate"
    assert fault.axes == ("x", "y", "z")
    assert fault.effect.value("share") == pytest.approx(len(again) / len(sound), rel=0.3)


def test_codes_repeat_by_chance_where_the_table_rests_though_it_moves_most_of_the_time(rng):
    """The noise of a rest is what repeats; that of second differences holds the moves."""
    sweep = 9.8 * np.sin(np.linspace(0, 40, 6000) ** 2)
    course = np.concatenate([sweep, np.full(4000, sweep[-1])])
    values = np.rint((course + rng.normal(0, 4e-5, 10000)) / 1e-5) * 1e-5
    again = np.mean(np.diff(values) == 0)
    assert again > 0.02
    assert repeat_chance(values) == pytest.approx(again, rel=0.3)


def test_clipping(truth, sound):
    fault = faults_of(truth, rewritten(sound, accel_x_m_s2=np.clip(x_of(sound), -7.0, 7.0)))[
        "acc_saturation"
    ]
    assert (fault.axes, fault.effect.value("full_scale")) == (("x",), pytest.approx(7.0))


def test_a_channel_that_is_clipped_most_of_the_time(truth, sound):
    """The noise is that of the rest: on the rails there is none."""
    x = x_of(sound)
    limit = float(np.median(np.abs(x))) / 2
    fault = faults_of(truth, rewritten(sound, accel_x_m_s2=np.clip(x, -limit, limit)))[
        "acc_saturation"
    ]
    assert (np.abs(x) > limit).mean() > 0.6
    assert (fault.axes, fault.effect.value("full_scale")) == (("x",), pytest.approx(limit))


def test_coarse_codes(truth, sound):
    lsb = 0.004
    fault = faults_of(truth, rewritten(sound, accel_x_m_s2=lsb * np.rint(x_of(sound) / lsb)))[
        "adc_quantisation"
    ]
    assert (fault.axes, fault.effect.value("lsb")) == (("x",), pytest.approx(lsb, rel=1e-6))


def test_gross_errors(truth, sound, rng):
    x = x_of(sound)
    hit = rng.choice(len(x), 12, replace=False)
    x[hit] += 0.05 * rng.choice([-1, 1], 12)
    fault = faults_of(truth, rewritten(sound, accel_x_m_s2=x))["data_outlier"]
    assert fault.axes[0] == "x"
    assert fault.effect.value("share") == pytest.approx(12 / len(x), rel=0.35)


def test_of_gross_errors_those_where_a_move_ends_go_with_the_others(truth, sound, rng):
    """One alone there may be a jerk of the table; beside a dozen elsewhere it is one more."""
    x = x_of(sound)
    stop = prepare(honest(truth), [sound]).observations.stops[0]
    begin = int(np.flatnonzero((stop[1:] >= 0) & (stop[:-1] < 0))[7]) + 2
    hit = [
        begin,
        *rng.choice(np.flatnonzero(np.abs(np.arange(len(x)) - begin) > 50), 12, replace=False),
    ]
    x[hit] += 0.05
    found = prepare(honest(truth), [rewritten(sound, accel_x_m_s2=x)])
    assert [f.effect.id for f in found.faults] == ["data_outlier"]
    assert begin not in found.observations.channels[0].rows


def test_heavy_tails_are_no_gross_errors(truth, sound, rng):
    x = x_of(sound)
    wide = rng.random(len(x)) < 0.03
    x[wide] += 3 * 7.8e-4 * rng.normal(size=wide.sum())
    assert "data_outlier" not in faults_of(truth, rewritten(sound, accel_x_m_s2=x))


def test_a_sign(truth, sound):
    fault = faults_of(truth, rewritten(sound, accel_z_m_s2=-sound.column("accel_z_m_s2")))[
        "data_sign"
    ]
    assert fault.effect.values == {"flip_z": 1.0}


def test_exchanged_columns(truth, sound):
    swapped = {
        "accel_x_m_s2": sound.column("accel_y_m_s2"),
        "accel_y_m_s2": sound.column("accel_x_m_s2"),
    }
    assert faults_of(truth, rewritten(sound, **swapped))["data_axis_swap"].effect.values == {
        "swap_xy": 1.0
    }


def test_a_wrong_unit(truth, sound):
    columns = {f"accel_{a}_m_s2": sound.column(f"accel_{a}_m_s2") / 9.80665 for a in "xyz"}
    factor = faults_of(truth, rewritten(sound, **columns))["data_unit"].effect.value("factor")
    assert factor == pytest.approx(1 / 9.80665, rel=1e-6)


def test_a_table_counted_the_other_way(truth, sound):
    fault = faults_of(truth, rewritten(sound, table_outer_deg=-sound.column("table_outer_deg")))[
        "data_rotation_sense"
    ]
    assert fault.effect.axis == "outer"


def test_a_mistyped_angle(truth, sound):
    outer = sound.column("table_outer_deg").copy()
    bench_ = prepare(honest(truth), [sound])
    stop = bench_.observations.courses[0].stop
    outer[stop == 7] += 0.5
    fault = faults_of(truth, rewritten(sound, table_outer_deg=outer))["data_pose_label"]
    assert (fault.effect.axis, fault.effect.value("error")) == (
        "outer",
        pytest.approx(np.radians(0.5), rel=0.02),
    )


def with_times(recording, change):
    """The recording with other stamps."""
    time = recording.time.copy()
    change(time)
    columns = {n: recording.column(n) for n in recording.column_names}
    return Recording.from_columns(time, columns, source="run.csv")


def test_time_that_goes_back_is_mended_and_a_finding(truth, sound):
    def back(time):
        time[100] -= 1.0

    found = diagnose(honest(truth), [with_times(sound, back)])
    (finding,) = found.findings
    assert (finding.effect, finding.stage, found.verdict) == (None, "data", "unlisted")
    assert finding.statement == (
        "run.csv: time_s: time goes back, once, in data row 101; 1 row(s) are left out, the first"
        " of them data row 101."
    )
    assert finding.p_value is finding.delta_bic is None
    physics = replace(finding, effect="acc_K2", names=("acc_K2",), stage="sensor")
    assert verdict_of((finding, physics), True) == "explained"


def test_one_stamp_far_ahead_costs_one_row(truth, sound):
    def ahead(time):
        time[300] = time[-1] + 5

    found = inspect(honest(truth), [with_times(sound, ahead)])
    assert [(rows.row, rows.count, rows.out_of_order) for rows in found.left_out] == [(301, 1, 1)]
    assert len(found.recordings[0]) == len(sound) - 1


def test_a_clock_set_back_costs_the_shorter_part_of_what_overlaps(truth, sound):
    def back(time):
        time[200:] -= 50.5 * (time[1] - time[0])

    (rows,) = inspect(honest(truth), [with_times(sound, back)]).left_out
    assert rows.count == 50


def test_stamps_that_repeat_may_be_rounded_and_are_noted(truth, sound):
    def repeat(time):
        time[100] = time[99]

    found = diagnose(honest(truth), [with_times(sound, repeat)])
    assert (found.findings, found.verdict) == ((), "match")
    assert any(
        "time_s: a stamp is repeated, once, in data row 101; 1 row(s) are left out" in n
        for n in found.notes
    )


def test_what_was_mended_leaves_the_rest_as_it_was(truth, sound):
    """After mending a sign, the calibration is that of the sound recording."""
    flipped = rewritten(sound, accel_z_m_s2=-sound.column("accel_z_m_s2"))
    first, second = (prepare(honest(truth), [r]).start for r in (sound, flipped))
    for a, b in zip(first.nuisance, second.nuisance, strict=True):
        np.testing.assert_allclose(a.values, b.values, atol=1e-9)


def test_a_readout_cut_to_a_few_decimals(truth, sound):
    cut = {
        n: np.floor(sound.column(n) / 0.05) * 0.05 for n in ("table_outer_deg", "table_inner_deg")
    }
    found = prepare(honest(truth), [rewritten(sound, **cut)])
    assert {f.effect.id for f in found.faults} == {"data_truncation"}
    assert {f.effect.axis: f.effect.value("step") for f in found.faults} == pytest.approx(
        {"outer": np.radians(0.05), "inner": np.radians(0.05)}, rel=1e-6
    )
    # a reading may be off by what both axes lack
    assert found.whitened.floors["accel"] == pytest.approx(9.81 * 2 * np.radians(0.05), rel=1e-6)


def test_readings_weigh_less_by_the_error_of_a_cut_readout(truth, sound):
    """The inner axis is z of the body: it turns f_y into f_x, by a step over the root of twelve."""
    n = "table_inner_deg"
    cut = rewritten(sound, **{n: np.floor(sound.column(n) / 0.05) * 0.05})
    found = prepare(honest(truth), [cut])
    of_x, of_y, of_z = found.observations.channels
    rest = of_x.stop >= 0
    error = of_y.values * np.radians(0.05) / np.sqrt(12)
    expected = np.hypot(1, error / white_at_standstill(of_x.values, of_x.stop))
    assert expected[rest].max() > 1.5
    np.testing.assert_allclose(of_x.spread[rest], expected[rest], rtol=0.02)
    assert of_z.spread is None
    lines = spectral_lines_of(found.observations, found.start)
    assert lines == SpectralLines(lines.tones)  # its steps beat with the motion


def test_the_counts_of_a_coarse_encoder_are_no_cut_decimals(truth, sound):
    """20 arcsec, poses on counts."""
    count = 20 / 3600
    coarse = {
        n: np.round(np.rint(sound.column(n) / count) * count, 5)
        for n in ("table_outer_deg", "table_inner_deg")
    }
    assert not prepare(honest(truth), [rewritten(sound, **coarse)]).faults


@pytest.mark.parametrize(
    ("factor", "id", "values"),
    [
        (1.0, None, {}),
        (np.radians(1), "data_unit", {"factor": np.radians(1)}),
        (-1.0, "data_sign", {"flip_a": 1.0}),
    ],
)
def test_a_fog_turned_by_hand_with_a_gyro_tells_its_unit_and_its_sign(factor, id, values, rng):
    time = np.arange(0, 60, 0.02)
    rate = np.column_stack(
        [np.sin(time * w + k) * (np.sin(time / 7) > 0) for k, w in enumerate((1.1, 0.7, 1.7))]
    )
    columns = {
        f"gyro_{a}_rad_s": r + rng.normal(0, 1e-3, len(time))
        for a, r in zip("xyz", rate.T, strict=True)
    }
    columns["fog_a_rad_s"] = factor * (rate @ [0.6, 0.0, 0.8]) + rng.normal(0, 1e-5, len(time))
    found = find_labelling_faults(BY_HAND, Recording.from_columns(time, columns))
    assert [f.effect.id for f in found] == ([] if id is None else [id])
    for fault in found:
        assert fault.effect.sensor == "fog"
        assert dict(fault.effect.values) == pytest.approx(values)


@pytest.mark.parametrize(
    ("columns", "id", "axes"), [("Xyz", "data_sign", ("x",)), ("yxz", "data_axis_swap", ("x", "y"))]
)
def test_a_gyro_turned_by_hand_with_a_fog_tells_a_sign_or_an_exchange_of_its_columns(
    columns, id, axes, rng
):
    time = np.arange(0, 60, 0.02)
    rate = np.column_stack(
        [np.sin(time * w + k) * (np.sin(time / 7) > 0) for k, w in enumerate((1.1, 0.7, 1.7))]
    )
    read = {
        c.lower(): (-1 if c.isupper() else 1) * rate[:, "xyz".index(axis)]
        for axis, c in zip("xyz", columns, strict=True)
    }
    written = {f"gyro_{a}_rad_s": read[a] + rng.normal(0, 1e-3, len(time)) for a in "xyz"}
    written["fog_a_rad_s"] = rate @ [0.6, 0.0, 0.8] + rng.normal(0, 1e-5, len(time))
    (fault,) = find_labelling_faults(BY_HAND, Recording.from_columns(time, written))
    assert (fault.effect.id, fault.effect.sensor, fault.axes) == (id, "gyro", axes)


@pytest.mark.parametrize("amid_a_move", [False, True])
def test_samples_that_were_lost_are_counted_and_the_rest_moved_back(truth, sound, amid_a_move):
    lost, at = 7, 600
    stop = prepare(honest(truth), [sound]).observations.stops[0]
    if amid_a_move:  # a move of half a second or more: 5 rows on either side
        at = next(k for k in range(600, 900) if (stop[k - 5 : k + 6] < 0).all())
    columns = {}
    for axis in "xyz":
        values = sound.column(f"accel_{axis}_m_s2")
        columns[f"accel_{axis}_m_s2"] = np.concatenate(
            [values[:at], values[at + lost :], np.full(lost, np.nan)]
        )
    columns["accel_x_m_s2"][[100, 200, 300]] = np.nan  # and one channel lacks more than the others
    found = prepare(honest(truth), [rewritten(sound, **columns)])
    (fault,) = found.faults
    assert fault.effect.id == "data_drop"
    assert fault.effect.value("samples") == lost
    anywhere = 0.15 if amid_a_move else 10  # s: to a sample and a half, or somewhere in that rest
    assert fault.interval[0] == pytest.approx(sound.time[at] - sound.time[0], abs=anywhere)
    repaired = found.observations.recordings[0].column("accel_x_m_s2")
    later = slice(at + 150, len(repaired) - lost)
    np.testing.assert_array_equal(repaired[later], x_of(sound)[later])


@pytest.mark.parametrize(
    ("early", "told"),
    [
        ([0, 0, 0, 0, 20, 19, 20, 20], (3, 4, 20)),  # lost in the rest before the fifth
        ([3, 0, 0, 0, 14, 20, 19, 19, 20, 19, 20, 20], (3, 5, 20)),  # amid the fifth, the first off
        ([0, 0, 0, 30, 20, 20, 20], None),  # no move comes earlier than all that was lost
        ([0, 0, 7, 14, 20, 20, 20, 20], None),  # two between: no one loss
        ([20, 20, 20, 20, 20, 20, 20], None),  # a latency
        ([0, 0, 0, 9, 20, 20], None),  # five moves tell too little
    ],
)
def test_a_loss_is_told_by_the_moves_before_and_after_it(early, told):
    assert loss_by_moves(np.array(early)) == told


def test_samples_after_a_loss_come_back_to_their_rows_past_rows_that_are_empty(truth, sound):
    lost, at, empty = 7, 600, 900
    columns = {
        f"accel_{a}_m_s2": np.concatenate([v[:at], v[at + lost :], v[-lost:]])
        for a in "xyz"
        for v in [sound.column(f"accel_{a}_m_s2")]
    }
    for values in columns.values():
        values[empty] = np.nan
    (fault,) = (found := prepare(honest(truth), [rewritten(sound, **columns)])).faults
    assert (fault.effect.id, fault.effect.value("samples")) == ("data_drop", lost)
    repaired = found.observations.recordings[0].column("accel_x_m_s2")
    there = np.arange(at + 150, len(repaired) - lost)
    there = there[~np.isnan(repaired[there])]
    assert len(there) == len(repaired) - lost - at - 151
    np.testing.assert_array_equal(repaired[there], x_of(sound)[there])


@pytest.mark.parametrize(("lost", "told"), [(7, True), (0, False)])
def test_what_one_sensor_lost_another_may_have_lost_too(lost, told):
    """Asked of a sensor by itself: a wave that comes seven samples early from the middle on, or
    does not.
    """
    time = np.arange(400) / 10.0
    rows = np.arange(400)
    model = np.sin(time)
    read = np.sin(time + np.where(rows >= 200, 0.1 * lost, 0.0))
    channel = Channel(0, "accel", "x", 0, rows, time, read, np.full(400, -1))
    assert lost_as_another([(channel, model)], 20.0, 7) == told


def test_random_stamps_are_found_first_and_what_they_spoil_is_left_out(truth, sound, rng):
    late = rng.normal(0, 0.005, len(sound.time))
    columns = {
        f"accel_{a}_m_s2": np.interp(sound.time + late, sound.time, sound.column(f"accel_{a}_m_s2"))
        for a in "xyz"
    }
    found = prepare(honest(truth), [rewritten(sound, **columns)])
    assert [f.effect.id for f in found.faults] == ["data_jitter"]
    assert found.observations.samples < 3 * len(sound.time)


def upright_turns():
    """Turns of a three-axis table about the upright axis: gravity sees none of it."""
    steps = [
        {
            "action": "move",
            "outer_deg": a,
            "middle_deg": 0.0,
            "inner_deg": 0.0,
            "rate_deg_s": 40.0,
            "dwell_s": 3.0,
        }
        for a in (0, 90, 30, 180, 60, 150, 10, 120)
    ]
    return parse_scenario(
        {
            "schema": 1,
            "name": "turns",
            "site": {"gravity_m_s2": 9.81, "latitude_deg": 40.0},
            "rig": {"table": "three"},
            "sensor": [
                {"name": "s", "kind": "gyro", "rate_hz": 50.0, "adjustable": ["bias", "scale"]}
            ],
            "effect": [{"id": "gyr_noise", "sensor": "s", "white_deg_rth": 0.2}],
            "sequence": steps,
        }
    )


def test_an_angle_that_jumps_where_the_gyro_does_not_is_a_wrong_label():
    """About the upright axis no stop is off: only the jump of the readout, and a gyro that reads
    nothing, tell.
    """
    truth = upright_turns()
    sound = recorded(truth, 5)
    outer = sound.column("table_outer_deg").copy()
    stop = prepare(honest(truth), [sound]).observations.courses[0].stop
    outer[stop == 3] += 0.3
    (fault,) = prepare(honest(truth), [rewritten(sound, table_outer_deg=outer)]).faults
    assert (fault.effect.id, fault.effect.axis) == ("data_pose_label", "outer")
    assert fault.effect.value("error") == pytest.approx(np.radians(0.3), rel=1e-3)
    assert fault.effect.value("stop") == 3
    assert prepare(honest(truth), [sound]).faults == ()


@pytest.mark.parametrize("jumps", [True, False])
def test_a_steep_course_bends_but_does_not_jump(jumps):
    """A quick turn, 1 s of raised cosine up to 130 deg/s and down, bends by 8 arcsec from row to
    row, as far back as there.
    """
    t = np.arange(0.0, 12.0, 0.02)
    up, down = np.clip(t - 2.0, 0, 1), np.clip(t - 5.0, 0, 1)
    speed = np.radians(130.0) * (np.sin(np.pi / 2 * up) ** 2 - np.sin(np.pi / 2 * down) ** 2)
    angle = np.cumsum(speed) * 0.02 + rng_of("readout").normal(0, 2e-7, len(t))
    angle[250:300] += 4e-4 if jumps else 0.0
    found = jump_of("outer", t, angle, np.ones(len(t), bool))
    assert (found is not None) == jumps
    assert found is None or found.error == pytest.approx(4e-4, rel=0.1)


@pytest.mark.parametrize("jumps", [True, False])
def test_irregular_stamps_make_no_jump(jumps):
    """Up to 75 deg/s, stamps that are true and off an even grid by 3 % of its step, rms."""
    rng = rng_of("irregular stamps")
    t = 0.02 * (np.arange(600) + rng.normal(0, 0.03, 600))
    angle = np.radians(143.0) * np.sin(np.pi * t / 6) + rng.normal(0, 3e-7, 600)
    angle[250:300] += 2e-3 if jumps else 0.0
    found = jump_of("outer", t, angle, np.ones(600, bool))
    assert (found is not None) == jumps


@pytest.mark.parametrize("before", [18, 22])
def test_a_readout_that_is_missing_while_the_table_goes_does_not_jump(before):
    """Both ends of a gap look like jumps by half of a step of what is put into it, as far back as
    there.
    """
    truth = bench()
    sound = recorded(truth, 5)
    outer, inner = (sound.column(f"table_{axis}_deg").copy() for axis in ("outer", "inner"))
    stop = prepare(honest(truth), [sound]).observations.courses[0].stop
    gap = slice(np.flatnonzero(stop == before)[-1] + 1, np.flatnonzero(stop == before + 1)[0])
    outer[gap] = inner[gap] = np.nan
    assert (
        prepare(
            honest(truth), [rewritten(sound, table_outer_deg=outer, table_inner_deg=inner)]
        ).faults
        == ()
    )


def test_a_table_that_truly_jumps_is_believed():
    """Kicked by 0.3 deg for two seconds: the gyro reads both kicks."""
    truth = upright_turns()
    sound = recorded(truth, 5)
    outer, z = sound.column("table_outer_deg").copy(), sound.column("s_z_deg_s").copy()
    rows = np.flatnonzero(prepare(honest(truth), [sound]).observations.courses[0].stop == 3)
    outer[rows] += 0.3
    for row, way in ((rows[0], 1.0), (rows[-1] + 1, -1.0)):
        z[row - 1 : row + 1] += way * 0.3 * 50.0 / 2
    found = prepare(honest(truth), [rewritten(sound, table_outer_deg=outer, s_z_deg_s=z)]).faults
    assert "data_pose_label" not in {f.effect.id for f in found}


@pytest.mark.parametrize(
    ("lever", "names"), [(0.0, {"data_sign", "data_rotation_sense"}), (0.08, {"data_sign"})]
)
def test_a_sign_that_gravity_cannot_tell_from_a_sense_of_rotation(lever, names):
    """Of x = g sin(outer) sin(inner) the sign is that of inner; only what the motion adds off the
    axes knows better.
    """
    truth = bench()
    stated = truth.model_copy(
        update={"rig": truth.rig.model_copy(update={"lever_arm_m": (lever, 0.0, lever)})}
    )
    sound = recorded(stated, 5)
    (fault,) = find_labelling_faults(honest(stated), rewritten(sound, accel_x_m_s2=-x_of(sound)))
    assert fault.effect.id == "data_sign"
    assert set(fault.names) == names


def test_coarse_codes_of_a_gyro_may_be_its_own_or_the_converters():
    truth = upright_turns()
    sound = recorded(truth, 5)
    z = np.rint(sound.column("s_z_deg_s"))
    (fault,) = prepare(honest(truth), [rewritten(sound, s_z_deg_s=z)]).faults
    assert set(fault.names) == {"adc_quantisation", "gyr_quantisation"}
    stated = truth.model_dump(exclude={"effect", "sequence"}, exclude_defaults=True, by_alias=True)
    known = parse_scenario(
        {
            "schema": 1,
            **stated,
            "effect": [{"id": "gyr_quantisation", "sensor": "s", "lsb_deg_s": 1.0}],
        }
    )
    assert inspect(known, [rewritten(sound, s_z_deg_s=z)]).faults == ()


def test_gross_errors_of_a_gyro_turned_by_hand_are_all_that_is_found(rng):
    """Beside a FOG, which tells a knock from a fault: named with their share, and left out of what
    is looked at after.
    """
    time = np.arange(6000) / 50.0
    columns = turned_by_hand(rng, time)
    hit = rng.choice(len(time), 30, replace=False)
    columns["gyro_y_rad_s"][hit] += 0.3 * rng.choice([-1, 1], 30)
    (found,) = diagnose(BY_HAND, [Recording.from_columns(time, columns)]).findings
    assert (found.effect, found.names, found.stage, found.axes) == (
        "data_outlier",
        ("data_outlier",),
        "data",
        ("y",),
    )
    assert found.parameters["share_unitless"][0] == pytest.approx(30 / 6000, rel=0.1)


def test_a_gross_error_of_a_fog_shows_at_rest_below_the_noise_of_the_gyro(rng):
    """Forty sigma of the FOG are less than one of the gyro: its misfit does not show them."""
    time = np.arange(6000) / 50.0
    columns = turned_by_hand(rng, time)
    still = np.flatnonzero((time % 20 > 1) & (time % 20 < 4))
    columns["fog_a_rad_s"][rng.choice(still, 12, replace=False)] += 4e-4
    faults = prepare(BY_HAND, [Recording.from_columns(time, columns)]).faults
    assert [(f.effect.id, f.sensors, f.axes) for f in faults] == [
        ("data_outlier", ("fog",), ("a",))
    ]


def test_a_table_at_rest_tests_nothing_where_all_it_reads_may_be_calibrated():
    """One attitude, and readings that no instrument has there."""
    rng, time = rng_of("one attitude"), np.arange(2000) / 50
    columns = {
        "table_outer_deg": np.zeros(2000),
        "table_inner_deg": np.zeros(2000),
        **{f"accel_{a}_m_s2": m + rng.normal(0, 1e-3, 2000) for a, m in zip("xyz", (0.5, -0.7, 6))},
    }
    scenario = honest(bench())
    found = diagnose(scenario, [Recording.from_columns(time, columns)])
    assert found.verdict == "cannot_tell"
    assert "Record more attitudes" in found.statement


def test_a_calibration_that_no_instrument_needs_is_noted(truth, sound):
    """Scale factors of 9.8/1.62 are 5 million ppm."""
    scenario = honest(truth)
    assert implausible(prepare(scenario, [sound]).start) == []
    site = scenario.site.model_copy(update={"gravity_m_s2": 1.62})
    (note,) = implausible(prepare(scenario.model_copy(update={"site": site}), [sound]).start)
    assert "acc_scale" in note
    assert "scale_z is" in note


def test_recordings_that_no_diagnosis_can_use_are_refused(truth, sound):
    scenario = honest(truth)
    with pytest.raises(TiltcalError, match="each recording once"):
        diagnose(scenario, [sound, sound])
    with pytest.raises(TiltcalError, match=r"moves and stops \d+ times"):
        diagnose(scenario, [sound], static=sound)
    turning = rewritten(sound, table_outer_deg=np.linspace(0.0, 300.0, len(sound)))
    with pytest.raises(TiltcalError, match="moves and stops 0 times"):
        diagnose(scenario, [sound], static=turning)
    other = {n.replace("accel", "acc"): sound.column(n) for n in sound.column_names}
    with pytest.raises(TiltcalError, match="did you mean 'acc_x_m_s2'"):
        diagnose(scenario, [Recording.from_columns(sound.time, other)])
    empty = rewritten(sound, accel_x_m_s2=np.full(len(sound), np.nan))
    with pytest.raises(TiltcalError, match="no reading of its axis x"):
        diagnose(scenario, [empty])


def test_columns_of_no_sensor_are_reported(truth, sound):
    more = sound.with_columns({"pressure_hPa": np.ones(len(sound))})
    assert any("pressure_hPa" in note for note in inspect(honest(truth), [more]).notes)


def test_a_channel_that_never_changes_beside_noisy_ones_is_stuck(truth, sound):
    dead = rewritten(sound, accel_y_m_s2=np.full(len(sound), 0.02))
    fault = faults_of(truth, dead)["data_stuck"]
    assert fault.axes == ("y",)
    assert fault.effect.value("length") == pytest.approx(np.ptp(sound.time))


def test_rows_left_out_of_the_pieces_of_one_recording_are_said_once():
    pieces = [
        LeftOut(9, 2, 1, "a.csv", "back"),
        LeftOut(700, 3, 0, "a.csv", "again"),
        LeftOut(4, 1, 0, "b.csv", "again"),
    ]
    assert by_recording(pieces) == [
        LeftOut(9, 5, 1, "a.csv", "back"),
        LeftOut(4, 1, 0, "b.csv", "again"),
    ]


def test_recordings_that_are_labelled_otherwise_than_the_first_are_refused(truth, sound):
    """Not repaired as the first is: a sign that is wrong in one only would be turned in both."""

    def turned(recording):
        return rewritten(recording, accel_x_m_s2=-x_of(recording))

    second = recorded(truth, 6)
    for pair in ([turned(sound), second], [sound, turned(second)]):
        with pytest.raises(TiltcalError, match="labelled otherwise than in"):
            prepare(honest(truth), pair)
    fault = one_fault_of(prepare(honest(truth), [turned(sound), turned(second)]))
    assert fault.effect.id == "data_sign"
    one_pose = rows_of(turned(second), slice(0, 40))  # any labels fit it
    assert one_fault_of(prepare(honest(truth), [turned(sound), one_pose])).effect.id == "data_sign"


def one_fault_of(prepared):
    (fault,) = prepared.faults
    return fault


def rows_of(recording, rows):
    columns = {name: recording.column(name)[rows] for name in recording.column_names}
    return Recording.from_columns(recording.time[rows], columns)


COARSE = [
    {"id": "adc_quantisation", "sensor": "accel", "lsb_si": 0.01},
    {"id": "data_truncation", "step_deg": 0.1},
]


@pytest.mark.parametrize("fault", COARSE, ids=[fault["id"] for fault in COARSE])
def test_coarse_codes_that_are_stated_hide_as_much_as_those_that_are_found(fault):
    truth = bench(fault)
    read = recorded(truth, 5)
    found, known = prepare(honest(truth), [read]), prepare(stating(truth, fault), [read])
    assert {f.effect.id for f in found.faults} == {fault["id"]}
    assert known.faults == ()
    assert known.whitened.floors
    assert known.whitened.floors == pytest.approx(dict(found.whitened.floors), rel=1e-3)
    assert bool(known.observations.cut) is (fault["id"] == "data_truncation")


def test_a_bit_that_is_stated_as_stuck_is_put_back_as_one_that_is_found():
    fault = {"id": "adc_stuck_bit", "sensor": "accel", "axis": "x", "bit_value_si": 0.05}
    truth = bench(fault)
    read = recorded(truth, 5)
    found, known = prepare(honest(truth), [read]), prepare(stating(truth, fault), [read])
    assert {f.effect.id for f in found.faults} == {fault["id"]}
    assert known.faults == ()
    for a, b in zip(found.observations.channels, known.observations.channels, strict=True):
        np.testing.assert_array_equal(a.values, b.values)


def test_fine_steps_of_an_angle_hide_nothing(truth, sound):
    fine = stating(truth, {"id": "data_truncation", "step_deg": 0.0001})
    prepared = prepare(fine, [sound])
    assert not prepared.observations.cut
    assert not prepared.whitened.floors


@pytest.mark.parametrize("id", ["emi_spike", "data_outlier"])
def test_spikes_that_are_stated_are_left_out_and_no_finding(id):
    spikes = {"id": id, "sensor": "accel", "share_unitless": 0.02}
    truth = bench(spikes)
    read = recorded(truth, 5)
    assert faults_of(truth, read).keys() == {"data_outlier"}
    known = prepare(stating(truth, spikes), [read])
    assert known.faults == ()
    assert len(known.observations.channels[0].values) < len(read)


def test_a_loss_of_samples_that_is_stated_is_no_labelling_fault():
    """Its last rows have no prediction."""
    drop = {"id": "data_drop", "sensor": "accel", "samples": 3, "time_s": 60.0}
    truth = bench(drop)
    assert find_labelling_faults(stating(truth, drop), recorded(truth, 5)) == []
