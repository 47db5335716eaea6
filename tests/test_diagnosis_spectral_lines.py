"""What beats in a residual is found where it beats: in the readings, in the world, over an axis'
angle, over a reading's own input, after each move.
"""

import re

import numpy as np
import pytest
from diagnosis_fixtures import bench, honest, recorded
from statistics_helpers import rng_of

from tiltcal.diagnosis.data_faults.prepare import prepare
from tiltcal.diagnosis.diagnose import diagnose
from tiltcal.diagnosis.lines.spectral_lines import spectral_lines_of, wandering_of
from tiltcal.diagnosis.search.dictionary import build_dictionary, extend_dictionary
from tiltcal.diagnosis.search.state import State
from tiltcal.effects.electronics.mains import MainsPickup
from tiltcal.effects.spans import CoordinateRanges
from tiltcal.laboratory.scenario import parse_scenario
from tiltcal.recordings.recording import Recording
from tiltcal.setup.sequence import Step

WHITE = 25e-6 * 9.81 * np.sqrt(25.0)  # of a sample at 25 Hz, m/s2


def prepared(*left_out, seed=3):
    truth = bench(*left_out)
    return prepare(honest(truth), [recorded(truth, seed)])


def lines(*left_out):
    found = prepared(*left_out)
    return spectral_lines_of(found.observations, found.start)


def test_noise_has_no_lines():
    found = lines()
    assert (found.tones, found.shakes, found.echoes, found.ripples) == ((), (), (), ())
    assert found.waves == ()


def test_a_hum_of_the_electronics_is_a_tone_of_the_readings():
    found = lines(
        {"id": "mains_pickup", "sensor": "accel", "pickup_x_ug": 400.0, "frequency_hz": 3.37}
    )
    assert found.tones[0] == pytest.approx(3.37, abs=0.005)


def test_lost_rows_do_not_smear_a_tone():
    """A lost row shifts the phase of all later ones, were they counted and not timed: at 4.9 Hz
    half a period for each.
    """
    truth = bench(
        {
            "id": "mains_pickup",
            "sensor": "accel",
            "pickup_x_ug": 400.0,
            "frequency_hz": 4.9,
            "phase_deg": 70.0,
        }
    )
    whole = recorded(truth, 4)
    kept = np.delete(
        np.arange(len(whole)), rng_of("lost rows").choice(len(whole), 12, replace=False)
    )
    columns = {name: whole.column(name)[kept] for name in whole.column_names}
    found = prepare(honest(truth), [Recording.from_columns(whole.time[kept], columns)])
    width = 1 / float(np.ptp(whole.time))
    assert spectral_lines_of(found.observations, found.start).tones[0] == pytest.approx(
        4.9, abs=width / 4
    )


def test_a_hum_that_wanders_is_told_by_all_its_lines_together():
    """Its phase swings by 2.6 rad three times: the strongest of its lines has a quarter of its
    energy, and does not stand out. At 26.7 Hz 50 Hz shows near it.
    """
    table = bench().model_dump(exclude_defaults=True, by_alias=True)
    table["sensor"][0]["rate_hz"] = 26.7
    truth = parse_scenario({"schema": 1, **table})
    whole = recorded(truth, 4)
    time = whole.time - whole.time[0]
    phase = 2 * np.pi * 3.37 * time + 2.6 * np.sin(2 * np.pi * time / (0.3 * time[-1]))
    size = WHITE * np.sqrt(2 * 220.0 / len(time))  # 220 of deviance
    columns = {name: whole.column(name) for name in whole.column_names}
    columns["accel_y_m_s2"] = columns["accel_y_m_s2"] + size * np.sin(phase)
    hum = Recording.from_columns(whole.time, columns)
    found = prepare(honest(truth), [hum])
    assert spectral_lines_of(found.observations, found.start).tones == ()
    assert all(abs(f - 3.37) < 0.05 for f in wandering_of(found.observations, found.start))
    assert [f.effect for f in diagnose(honest(truth), [hum]).findings] == ["mains_pickup"]


def test_noise_has_no_wandering_lines():
    for seed in range(3, 6):
        found = prepared(seed=seed)
        assert wandering_of(found.observations, found.start) == ()


def test_a_hum_has_a_phase():
    """All of it goes to its name: without a phase what is left of it would be laid to the base.
    Beyond half a turn, where those of test_diagnosis_events.py are not.
    """
    truth = bench(
        {
            "id": "mains_pickup",
            "sensor": "accel",
            "pickup_x_ug": 400.0,
            "frequency_hz": 3.37,
            "phase_deg": 310.0,
        }
    )
    found = diagnose(honest(truth), [recorded(truth, 3)])
    (only,) = found.findings
    assert only.effect == "mains_pickup"
    size, sigma = only.parameters["pickup_x_ug"]
    assert size == pytest.approx(400.0, abs=5 * sigma)  # a negative one is half a turn of the phase
    assert sigma < 10.0


def test_a_shaken_base_is_one_line_in_the_world():
    found = lines({"id": "base_vibration", "ec_ug": 500.0, "frequency_hz": 4.21})
    assert found.shakes[0] == pytest.approx(4.21, abs=0.005)


def test_an_interpolation_error_is_a_line_over_the_angle():
    """In a turn: between stops that are few a line has aliases."""
    turn = {"action": "turn", "axis": "outer", "rate_deg_s": 3.0, "dwell_s": 3.0}
    sequence = tuple(Step(**turn, angle_deg=angle) for angle in (360.0, -360.0))
    truth = bench({"id": "table_encoder_sde", "axis": "outer", "cos_arcsec": 60.0, "lines": 36})
    truth = truth.model_copy(update={"sequence": sequence})
    found = prepare(honest(truth), [recorded(truth, 3)])
    assert spectral_lines_of(found.observations, found.start).ripples[:1] == (36,)


def test_the_skirts_of_a_line_over_few_stops_do_not_hide_it():
    """Nineteen stops five degrees apart: 29 lines a turn look much like any other number."""
    stops = [5.0 * ((7 * k) % 19) - 45.0 for k in range(38)]
    sequence = tuple(
        Step(action="move", outer_deg=a, inner_deg=0.0, rate_deg_s=30.0, dwell_s=3.0) for a in stops
    )
    truth = bench({"id": "table_encoder_sde", "axis": "outer", "cos_arcsec": 10.0, "lines": 29})
    truth = truth.model_copy(update={"sequence": sequence})
    found = prepare(honest(truth), [recorded(truth, 3)])
    assert spectral_lines_of(found.observations, found.start).ripples == (29,)


def test_a_gyro_tells_the_lines_of_a_turn_about_the_upright():
    """Gravity sees nothing of it: the rate of the error alone does."""
    steps = [
        {"action": "turn", "axis": "outer", "rate_deg_s": 30.0, "angle_deg": a, "dwell_s": 3.0}
        for a in (360, -360, 360)
    ]
    truth = parse_scenario(
        {
            "schema": 1,
            "name": "turns",
            "site": {"gravity_m_s2": 9.81, "latitude_deg": 40.0},
            "rig": {"table": "three"},
            "sensor": [
                {"name": "gyro", "kind": "gyro", "rate_hz": 50.0, "adjustable": ["bias", "scale"]}
            ],
            "sequence": steps,
            "effect": [
                {"id": "gyr_noise", "sensor": "gyro", "white_deg_rth": 0.2},
                {"id": "table_encoder_sde", "axis": "outer", "sin_arcsec": 20.0, "lines": 24},
            ],
        }
    )
    found = prepare(honest(truth), [recorded(truth, 3)])
    assert spectral_lines_of(found.observations, found.start).ripples[:1] == (24,)


PERIOD = 0.61  # m/s2


def with_wave_over_input(truth, seed):
    """A recording whose reading of y has an error that is periodic in what it reads."""
    whole = recorded(truth, seed)
    columns = {name: whole.column(name) for name in whole.column_names}
    y = columns["accel_y_m_s2"]
    columns["accel_y_m_s2"] = y + 1.5 * WHITE * np.sin(2 * np.pi * y / PERIOD)
    return Recording.from_columns(whole.time, columns)


def test_an_error_periodic_in_the_reading_is_a_line_over_its_own_input():
    truth = bench()
    found = prepare(honest(truth), [with_wave_over_input(truth, 4)])
    waves = spectral_lines_of(found.observations, found.start).waves
    (wave,) = (w for w in waves if w.coordinate == "input")
    assert (wave.sensor, wave.axis) == ("accel", "y")
    assert wave.period == pytest.approx(PERIOD, rel=0.02)


TABLE_STEP = 0.5  # degC


def with_compensation_table(truth, seed):
    """A recording whose bias of z is compensated from a table of half degrees, the temperature
    being truncated and not interpolated: a saw-tooth of what is beyond the half degree.
    """
    whole = recorded(truth, seed)
    columns = {name: whole.column(name) for name in whole.column_names}
    beyond = whole.temperature() / TABLE_STEP % 1.0
    columns["accel_z_m_s2"] = columns["accel_z_m_s2"] + 2 * WHITE * (beyond - 0.5)
    return Recording.from_columns(whole.time, columns)


def test_a_table_over_temperature_is_a_line_over_temperature():
    truth = bench(swing_degC=2.0, period_s=600.0)
    found = prepare(honest(truth), [with_compensation_table(truth, 4)])
    (wave,) = (
        w
        for w in spectral_lines_of(found.observations, found.start).waves
        if w.coordinate == "temperature"
    )
    assert (wave.sensor, wave.axis) == ("accel", "z")
    span = np.ptp(recorded(truth, 4).temperature())
    assert wave.period == pytest.approx(TABLE_STEP, rel=TABLE_STEP / span / 2)  # half a line


def test_a_table_over_temperature_is_a_finding_without_a_name():
    truth = bench(swing_degC=2.0, period_s=600.0)
    found = diagnose(honest(truth), [with_compensation_table(truth, 4)])
    assert found.verdict == "unlisted"
    told = re.search(
        r"accel z that follows temperature, with a period of (\S+) degC", found.statement
    )
    assert told
    assert float(told[1]) == pytest.approx(TABLE_STEP, rel=0.05)


def with_pick_up(truth, seed, lines=17, of=np.abs):
    """A recording whose reading of x has so many periods a turn of the inner axis while that turns,
    in proportion to something of its rate.
    """
    whole = recorded(truth, seed)
    columns = {name: whole.column(name) for name in whole.column_names}
    inner = np.radians(columns["table_inner_deg"])
    rate = of(np.gradient(inner, whole.time))
    columns["accel_x_m_s2"] = columns["accel_x_m_s2"] + 15 * WHITE * rate * np.sin(lines * inner)
    return Recording.from_columns(whole.time, columns)


@pytest.mark.parametrize(
    ("of", "lines", "times"), [(np.abs, 17, "speed"), (np.array, 4, "turn_rate_inner")]
)
def test_what_a_turning_motor_puts_into_a_reading_is_a_line_over_its_angle(of, lines, times):
    """By its speed, or by its rate: a voltage changes its sign with the sense of rotation."""
    truth = bench()
    found = prepare(honest(truth), [with_pick_up(truth, 4, lines, of)])
    wave = spectral_lines_of(found.observations, found.start).waves[0]
    assert (wave.sensor, wave.axis) == ("accel", "x")
    assert (wave.coordinate, wave.times) == ("table_inner", times)
    assert wave.period == pytest.approx(2 * np.pi / lines)


def test_the_pick_up_of_a_turning_motor_is_a_finding_without_a_name():
    truth = bench()
    found = diagnose(honest(truth), [with_pick_up(truth, 4)])
    assert found.verdict == "unlisted"
    assert "accel x that follows the inner angle, in proportion to the speed of turn, 17 times" in (
        found.statement
    )


def test_an_error_periodic_in_the_reading_is_a_finding_without_a_name():
    truth = bench()
    found = diagnose(honest(truth), [with_wave_over_input(truth, 4)])
    assert found.verdict == "unlisted"
    assert "accel y that follows its own input, with a period of 0.6" in found.statement


def test_what_rings_anew_after_each_move_is_an_echo():
    found = lines(
        {
            "id": "settling_transient",
            "axis": "outer",
            "amplitude_arcsec": 200.0,
            "frequency_hz": 1.5,
            "tau_s": 2.0,
        }
    )
    assert found.echoes
    assert found.echoes[0] == pytest.approx(1.5, rel=0.1)


def test_what_stood_in_the_shadow_of_a_finding_comes_onto_the_ledger_later():
    """A line that stands out of the residual only once a large scale asymmetry is away."""
    found = prepared(
        {"id": "mains_pickup", "sensor": "accel", "pickup_x_ug": 400.0, "frequency_hz": 3.37}
    )
    before = spectral_lines_of(found.observations, found.start)
    nothing = type(before)()
    build_dictionary(found.whitened, found.start, nothing)
    count = len(found.whitened.hypotheses)
    state = State(found.start, found.whitened)
    assert extend_dictionary(state, nothing)
    new = {s.effect.values.get("frequency") for s in found.whitened.hypotheses[count:]}
    assert any(f is not None and abs(f - 3.37) < 0.01 for f in new)
    assert not extend_dictionary(state, before)


def test_the_odds_of_the_mains_follow_the_alias_of_a_grid():
    """By hand, 30 Hz for 200 s: 50 Hz shows at 10 Hz, with half of 0.7 within 1 Hz, and 0.3 over 15
    Hz; a cycle of anything else has 1 / (10 ln 3000) there.
    """
    span = CoordinateRanges(200.0, 30.0)
    at_alias = MainsPickup.shape_odds({"frequency": 10.0}, span)
    assert at_alias == pytest.approx(np.log((0.35 + 0.3 / 15) * 10 * np.log(3000)))
    elsewhere = MainsPickup.shape_odds({"frequency": 4.0}, span)
    assert elsewhere == pytest.approx(np.log(0.3 / 15 * 4 * np.log(3000)))
    assert MainsPickup.shape_odds({"frequency": 50.0}, span) == pytest.approx(at_alias)


def test_a_slow_wave_on_two_channels_is_no_mains_though_each_curve_has_one_channel():
    """0.05 Hz at 18 Hz, where 50 Hz shows at 4 Hz and 60 Hz at 6 Hz."""
    table = bench().model_dump(exclude_defaults=True, by_alias=True)
    table["sensor"][0]["rate_hz"] = 18.0
    truth = parse_scenario({"schema": 1, **table})
    whole = recorded(truth, 4)
    wave = np.sin(2 * np.pi * 0.05 * (whole.time - whole.time[0]) + 0.4)
    columns = {name: whole.column(name) for name in whole.column_names}
    for axis, deviance in (("x", 600.0), ("y", 300.0)):
        size = WHITE * np.sqrt(18 / 25 * deviance / np.sum(wave**2))
        columns[f"accel_{axis}_m_s2"] = columns[f"accel_{axis}_m_s2"] + size * wave
    found = diagnose(honest(truth), [Recording.from_columns(whole.time, columns)])
    assert found.verdict == "unlisted"
    assert found.findings[0].where.coordinate == "time"


def with_overtones(rate_hz, frequency, second, third):
    """A set-up, and a recording with a tone of y that has overtones, of 1200 of deviance in all."""
    table = bench().model_dump(exclude_defaults=True, by_alias=True)
    table["sensor"][0]["rate_hz"] = rate_hz
    truth = parse_scenario({"schema": 1, **table})
    whole = recorded(truth, 4)
    turn = 2 * np.pi * frequency * (whole.time - whole.time[0])
    wave = np.sin(turn) + second * np.sin(2 * turn + 1.0) + third * np.sin(3 * turn)
    columns = {name: whole.column(name) for name in whole.column_names}
    size = WHITE * np.sqrt(1200.0 / np.sum(wave**2))
    columns["accel_y_m_s2"] = columns["accel_y_m_s2"] + size * wave
    return honest(truth), Recording.from_columns(whole.time, columns)


def test_a_cycle_that_is_no_sinusoid_and_no_alias_of_a_grid_has_no_name():
    scenario, recording = with_overtones(25.0, 3.1, 0.5, 0.3)
    found = diagnose(scenario, [recording])
    assert found.verdict == "unlisted"
    assert "accel y that follows time, with a period of 0.323 s" in found.statement


def test_overtones_at_the_alias_of_a_grid_are_of_the_mains():
    """At 26 Hz 50 Hz shows at 2 Hz."""
    scenario, recording = with_overtones(26.0, 2.0, 0.0, 0.2)
    found = diagnose(scenario, [recording])
    assert [f.effect for f in found.findings] == ["mains_pickup"]
    assert "fitted in 2 parts" in found.statement
