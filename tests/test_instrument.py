"""The instrument on another simulation: the laboratory's readings, step by step, for the whole
catalogue; delays, noise, lost samples, episodes, refusals, and what wraps what.
"""

from dataclasses import replace

import numpy as np
import pytest
from catalogue_cases import lively, plausible, sensors_for

from tiltcal.core.errors import TiltcalError
from tiltcal.effects import CATALOGUE
from tiltcal.effects.base import SignalEffect
from tiltcal.effects.sense import ENCODER
from tiltcal.effects.stepwise import Stepping
from tiltcal.forward.kinematics import closed_form
from tiltcal.forward.signal_chain import make_sense, readings, stream
from tiltcal.laboratory.instrument.instrument import Instrument
from tiltcal.laboratory.scenario import parse_scenario

RATE = 100.0
# what a step cannot know: the future, the length of the recording, or the noise of all samples
NEED_MORE = {
    "magnetic_field",
    "triad_size_effect",
    "acc_drift",
    "acc_thermal_gradient",
    "acc_thermal_hysteresis",
    "acc_vre",
    "gyr_vre",
    "fog_shupe",
    "emi_spike",
    "data_outlier",
    "data_drop",
    "supply_ratiometric",
}


def bench(*effects, rate=RATE, **more):
    """A triad, an inclinometer, a gyro and a FOG on a table that turns."""
    sensors = [
        {"name": "accel", "kind": "accelerometer", "rate_hz": rate},
        {"name": "level", "kind": "inclinometer", "axes": ["x", "y"], "rate_hz": rate},
        {"name": "gyro", "kind": "gyro", "rate_hz": rate},
        {"name": "fog", "kind": "fog", "axes": ["a"], "input_axis": [1, 1, 1], "rate_hz": rate},
    ]
    table = {
        "schema": 1,
        "name": "bench",
        "site": {"gravity_m_s2": 9.80123},
        "rig": {"table": "three"},
        "climate": {"swing_degC": 3.0, "period_s": 20.0},
        "sensor": sensors,
        "sequence": [
            {"action": "rest", "dwell_s": 1},
            {"action": "turn", "axis": "middle", "angle_deg": 70, "rate_deg_s": 40},
            {"action": "turn", "axis": "inner", "angle_deg": -60, "rate_deg_s": 60, "dwell_s": 1},
        ],
        "effect": list(effects),
    }
    return parse_scenario(table | more)


def stepped(scenario, *, seed=None, envs=1, lost="nan"):
    """The readings of an instrument that is fed the laboratory's motion, (steps, envs, k)."""
    start, end = scenario.schedule.times
    time = start + np.arange(int((end - start) * RATE + 1e-9) + 1) / RATE
    motion = closed_form(scenario, scenario.schedule.drive(time))
    instrument = Instrument(scenario, 1 / RATE, envs=envs, seed=seed, lost=lost)
    found = [
        instrument.step(*inputs)
        for inputs in zip(motion.force, motion.rate, motion.angular_acceleration, strict=True)
    ]
    return {name: np.array([step[name] for step in found]) for name in found[0]}


def recorded(scenario, *, seed=None):
    start, end = scenario.schedule.times
    times = {
        s.name: start + np.arange(int((end - start) * s.rate_hz + 1e-9) + 1) / s.rate_hz
        for s in scenario.sensor
    }
    return readings(scenario, scenario.schedule, times, scenario.effects, seed=seed)


def assert_alike(scenario, tolerance=0.0, **how):
    live, lab = stepped(scenario, **how), recorded(scenario, seed=how.get("seed"))
    for name, values in lab.items():
        np.testing.assert_allclose(
            live[name][:, 0], values, rtol=0, atol=tolerance, err_msg=name, equal_nan=True
        )


SIGNAL = [i for i, cls in CATALOGUE.items() if issubclass(cls, SignalEffect)]
OTHERWISE = {"acc_bandwidth", "gyr_bandwidth", "acc_noise", "gyr_noise"}  # see below
ALIKE = [
    i for i in SIGNAL if i not in NEED_MORE | OTHERWISE and CATALOGUE[i].kinds != ENCODER
]  # no instrument has an encoder


@pytest.mark.parametrize("id", ALIKE)
def test_each_effect_reads_what_the_laboratory_reads(id):
    """Row by row of a lively recording, the first environment against the laboratory's array."""
    setup, course, times = lively("three")
    time = times["accel"]
    drive = course.drive(time)
    motion = closed_form(setup, drive)
    for sensor in sensors_for(CATALOGUE[id], setup):
        effect = plausible(id, setup, sensor)
        part = effect.stepwise(Stepping(sensor, 1, [stream(7, id, sensor.name)]))
        assert part is not None
        part.restart(slice(None))
        sense = make_sense(sensor, setup, motion, drive)
        whole = effect.apply(sense.true_input(), sense, stream(7, id, sensor.name))
        again = [
            part(one.true_input(), one, slice(None))[0]
            for one in (row_of(sense, k) for k in range(len(time)))
        ]
        last_digit = 2e-15 if sensor.kind == "fog" else 0.0  # a product with the input axis
        np.testing.assert_allclose(again, whole, last_digit, last_digit, equal_nan=True)


def row_of(sense, k):
    """The sense of one row."""
    rows = ("time", "elapsed", "force", "rate", "up", "north", "angular_acceleration")
    parts = {name: getattr(sense, name)[k : k + 1] for name in (*rows, "temperature")}
    return replace(sense, **parts)


@pytest.mark.parametrize("id", sorted(NEED_MORE))
def test_an_effect_that_needs_more_than_the_past_is_refused(id):
    setup, *_ = lively("three")
    (sensor, *_) = sensors_for(CATALOGUE[id], setup)
    effect = plausible(id, setup, sensor)
    assert effect.stepwise(Stepping(sensor, 1, [stream(7, id, sensor.name)])) is None


CHAIN = [
    {"id": "acc_bias", "bias_x_ug": 3000, "sensor": "accel"},
    {"id": "acc_scale", "scale_y_ppm": 900, "sensor": "level"},
    {"id": "acc_saturation", "full_scale_m_s2": 9, "sensor": "accel"},
    {"id": "acc_temp_bias", "temp_bias_y_ug_degC": 300, "sensor": "accel"},
    {"id": "adc_quantisation", "sensor": "accel", "lsb_si": 1e-3},
    {"id": "gyr_bias", "bias_z_deg_s": 0.4},
    {"id": "gyr_gsens", "sensor": "gyro", "gsens_xz_deg_h_g": 60},
    {"id": "data_gap", "sensor": "gyro", "start_s": 2.0, "length_s": 0.5},
    {"id": "data_duplicate", "sensor": "level", "share_unitless": 0.05},
]


@pytest.mark.filterwarnings("ignore:seed=None leaves out")
@pytest.mark.parametrize("seed", [5, None])
def test_a_chain_reads_what_the_laboratory_reads_to_the_last_digit(seed):
    assert_alike(bench(*CHAIN), seed=seed, tolerance=1e-15)


def test_the_order_of_the_chain_is_kept():
    """Were the bias added after the clipping, the readings would pass it."""
    clipped = stepped(bench(CHAIN[2], {"id": "acc_bias", "bias_z_ug": 1e5, "sensor": "accel"}))
    assert clipped["accel"].max() == 9.0


@pytest.mark.parametrize("latency_ms", [10, 30])
def test_a_delay_of_whole_steps_reads_what_the_laboratory_reads(latency_ms):
    delay = [
        {"id": "data_latency", "sensor": "accel", "latency_ms": latency_ms},
        {"id": "channel_mux_skew", "sensor": "gyro", "skew_ms": 10},
        {"id": "acc_temp_bias", "temp_bias_x_ug_degC": 300, "sensor": "accel"},
    ]
    assert_alike(bench(*delay), tolerance=1e-11)


def test_a_delay_between_the_steps_is_interpolated():
    delay = {"id": "data_latency", "sensor": "accel", "latency_ms": 13.7}
    change = np.abs(recorded(bench())["accel"] - recorded(bench(delay))["accel"]).max()
    live, lab = stepped(bench(delay))["accel"][:, 0], recorded(bench(delay))["accel"]
    assert np.abs(live - lab).max() < 1e-3 * change


def test_a_low_pass_follows_the_laboratory_without_the_samples_to_come():
    lag = [
        {"id": "acc_bandwidth", "sensor": "accel", "tau_ms": 20},
        {"id": "gyr_bandwidth", "sensor": "gyro", "tau_ms": 2},
    ]
    live, lab, prompt = stepped(bench(*lag)), recorded(bench(*lag)), recorded(bench())
    for name in ("accel", "gyro"):
        change = np.abs(lab[name] - prompt[name]).max()
        assert np.abs(live[name][:, 0] - lab[name]).max() < 3e-3 * change


def test_white_noise_has_the_numbers_of_the_laboratory_with_the_seed_of_its_environment():
    scenario = bench(
        {"id": "acc_noise", "sensor": "accel", "white_ug_rthz": 40},
        {"id": "gyr_noise", "sensor": "gyro", "white_deg_rth": 0.3},
    )
    live = stepped(scenario, seed=3, envs=3)
    for k in range(3):
        lab = recorded(scenario, seed=3 + k)
        for name in ("accel", "gyro"):
            np.testing.assert_array_equal(live[name][:, k], lab[name])


def test_environments_out_of_step_have_the_numbers_of_their_own_streams():
    """Noise is computed ahead: one that begins again goes on in its streams, from a new start."""
    noise = {"id": "acc_noise", "sensor": "accel", "white_ug_rthz": 40}
    slow = {"flicker_ug": 50, "walk_ug_rts": 3}
    zero, steps, again = np.zeros((3, 3)), 700, (0, 3, 130, 256, 300)
    for more in ({}, slow):
        instrument = Instrument(bench(noise | more), 0.01, envs=3, seed=3)
        alone = [Instrument(bench(noise | more), 0.01, seed=3 + k) for k in range(3)]
        for step in range(steps):
            if step in again:  # the second begins again, out of step with the others
                instrument.reset(np.array([False, True, False]))
                alone[1].reset()
            together = instrument.step(zero, zero)["accel"]
            apart = [one.step(zero[:1], zero[:1])["accel"][0] for one in alone]
            np.testing.assert_allclose(together, apart, rtol=0, atol=1e-17)
        assert len(np.unique(together)) == 9


def test_flicker_and_walk_have_the_statistics_of_the_laboratory():
    """Variances of differences over three lags."""
    rate, envs, steps = 10.0, 400, 400
    noise = {"id": "acc_noise", "flicker_ug": 100, "walk_ug_rts": 30, "sensor": "accel"}
    scenario = bench(noise, rate=rate)
    instrument = Instrument(scenario, 1 / rate, envs=envs, seed=8)
    zero = np.zeros((envs, 3))
    live = np.array([instrument.step(zero, zero)["accel"] for _ in range(steps)])
    lab = np.array([drawn(scenario, steps, seed) for seed in range(envs)]).transpose(1, 0, 2)
    for lag in (1, 20, 200):
        one, other = (np.var(n[lag:] - n[:-lag], axis=0).mean() for n in (live, lab))
        assert one == pytest.approx(other, rel=0.1)
    assert live[0].std() == pytest.approx(lab[0].std(), rel=0.1)


def drawn(scenario, steps, seed):
    """The laboratory's noise of the triad at rest, (steps, 3)."""
    (effect,), sensor = scenario.effects, scenario.named("accel")
    drive = scenario.schedule.drive(np.linspace(0, 0.5, steps))
    sense = make_sense(sensor, scenario, closed_form(scenario, drive), drive)
    return effect.apply(np.zeros((steps, 3)), sense, stream(seed, effect.id, sensor.name))


def test_a_slow_sensor_keeps_its_reading_between_its_samples():
    live, lab = stepped(bench(rate=25.0))["accel"][:, 0], recorded(bench(rate=25.0))["accel"]
    np.testing.assert_allclose(live, lab[np.arange(len(live)) // 4], rtol=0, atol=1e-12)
    assert len(np.unique(live[:, 0])) > 20


def test_a_lost_sample_is_held_or_nan():
    gap = {"id": "data_gap", "sensor": "gyro", "start_s": 2.0, "length_s": 0.5}
    lost = stepped(bench(gap))["gyro"][:, 0]
    held = stepped(bench(gap), lost="hold")["gyro"][:, 0]
    missing = np.isnan(lost[:, 0])
    assert missing.sum() == 50
    assert (held[missing] == held[np.argmax(missing) - 1]).all()
    np.testing.assert_array_equal(held[~missing], lost[~missing])


def test_environments_that_begin_again_are_switched_on_alone():
    effects = [
        {"id": "acc_turn_on", "sensor": "accel", "sigma_ug": 1e4},
        {"id": "acc_warmup", "sensor": "accel", "warmup_x_ug": 1e5, "tau_s": 0.1},
        {"id": "data_latency", "sensor": "accel", "latency_ms": 20},
    ]
    instrument = Instrument(bench(*effects), 0.01, envs=2, seed=1)
    force = np.zeros((2, 3))
    before = [instrument.step(force, force)["accel"] for _ in range(50)]
    instrument.reset(np.array([False, True]))
    after = instrument.step(force + 5.0, force)["accel"]
    # the first goes on: 20 ms late, and warm; the second was always there, and is cold
    assert after[0, 1] == before[-1][0, 1]
    assert after[1, 1] - 5.0 != pytest.approx(before[0][1, 1], abs=1e-6)
    assert np.abs(after[1, 1:] - 5.0).max() < 1.0
    assert after[1, 0] - 5.0 > 0.5
    assert len(np.unique(before[-1])) == 6


# --------------------------------------------------------------------------------------------------
# ---- Refusals


@pytest.mark.parametrize(
    ("effect", "words"),
    [
        ({"id": "acc_drift", "drift_x_ug": 100, "sensor": "accel"}, "needs later samples"),
        ({"id": "data_jitter", "sensor": "accel", "jitter_ms": 1}, "a delay that varies"),
        ({"id": "data_latency", "sensor": "accel", "latency_ms": -5}, "needs later samples"),
        ({"id": "table_levelling", "tilt_east_arcsec": 30}, "laboratory's own motion"),
    ],
)
def test_what_cannot_be_live_is_refused_in_one_message(effect, words):
    with pytest.raises(TiltcalError, match=words) as error:
        Instrument(bench(effect), 0.01, seed=1)
    assert effect["id"] in str(error.value)


@pytest.mark.parametrize("rate", [30.0, 200.0])
def test_a_rate_between_the_steps_is_refused(rate):
    with pytest.raises(TiltcalError, match="divided by a whole number"):
        Instrument(bench(rate=rate), 0.01)


def test_what_senses_a_motion_that_is_not_given_is_refused():
    zero = np.zeros(3)
    with pytest.raises(TiltcalError, match=r"sensor gyro.*no rate"):
        Instrument(bench(), 0.01).step(zero, None)
    angular = {"id": "acc_angular_terms", "kang_x_ug_s2_rad": 100, "sensor": "accel"}
    with pytest.raises(TiltcalError, match=r"acc_angular_terms.*no angular acceleration"):
        Instrument(bench(angular), 0.01).step(zero, zero)
    assert Instrument(bench(angular), 0.01).step(zero, zero, zero)["accel"].shape == (1, 3)
