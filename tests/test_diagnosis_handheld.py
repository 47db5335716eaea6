"""Recordings turned by hand: what a small error does to all that is redundant in them, in one pass;
which rests are rests.
"""

from dataclasses import replace

import numpy as np
import pytest
from diagnosis_fixtures import rewritten
from scipy.spatial.transform import Rotation
from statistics_helpers import rng_of

from tiltcal.core.assets import folder
from tiltcal.data_quality.spikes import off_neighbours
from tiltcal.diagnosis.data.handheld_recording import (
    KEPT_AT_REST,
    condensed,
    direction_polynomials,
    inner,
    known_stops,
    no_less,
    rest_steps,
    undisturbed,
)
from tiltcal.diagnosis.data.observe import observe
from tiltcal.diagnosis.data_faults.prepare import prepare
from tiltcal.diagnosis.diagnose import diagnose
from tiltcal.diagnosis.hypotheses.curves import lags_of
from tiltcal.diagnosis.hypotheses.hypothesis import Hypothesis
from tiltcal.diagnosis.model.fitted_model import FittedModel, FittedTerm
from tiltcal.diagnosis.search.best_shape import normalise_tone_phase
from tiltcal.effects import CATALOGUE, make_effect
from tiltcal.effects.hysteresis_and_lag import LAGS, first_order_lag
from tiltcal.effects.learned import LearnedReading
from tiltcal.forward.gravity_transport import GravityTransport, Windows, turns_between
from tiltcal.laboratory.handheld import inverted, sensor_matrix
from tiltcal.laboratory.laboratory import SimulatedLaboratory
from tiltcal.laboratory.scenario import load_scenario, parse_scenario
from tiltcal.recordings.recording import Recording
from tiltcal.statistics.noise_spectrum import NoiseFit, WhiteFlickerWalk

G = 9.80123
TRIADS = load_scenario(folder("scenarios") / "gyro_turns_by_hand.toml")
FOG = parse_scenario(
    {
        "schema": 1,
        "name": "a FOG beside a gyro triad",
        "site": {"gravity_m_s2": G, "latitude_deg": 45.0},
        "rig": {"table": "handheld"},
        "sensor": [
            {"name": "gyro", "kind": "gyro", "rate_hz": 50.0},
            {
                "name": "fog",
                "kind": "fog",
                "axes": ["a"],
                "input_axis": [0.36, 0.48, 0.8],
                "rate_hz": 50.0,
            },
        ],
    }
)


@pytest.fixture(scope="module")
def triads():
    recording = SimulatedLaboratory().record(TRIADS, 3)
    plain = TRIADS.model_copy(update={"effect": ()})
    return observe(plain, [recording]), [
        replace(e, role="calibration") for e in TRIADS.effects if not e.random
    ]


@pytest.fixture(scope="module")
def fog():
    time = np.arange(3000) / 50.0
    moving = np.sin(np.pi * np.clip((time % 20 - 5) / 15, 0, 1)) ** 2  # begun and ended smoothly
    rate = np.column_stack([np.sin((0.5 + 0.2 * k) * time) * moving for k in range(3)])
    columns = {f"gyro_{a}_rad_s": rate[:, k] for k, a in enumerate("xyz")} | {
        "fog_a_rad_s": rate @ FOG.named("fog").input_vector
    }
    return observe(FOG, [Recording.from_columns(time, columns)]), []


SMALL = {  # id: values small enough that squares do not matter, where
    "acc_bias": ({"bias_x_ug": 300.0}, "accel"),
    "acc_scale": ({"scale_y_ppm": 300.0}, "accel"),
    "acc_cross_axis": ({"cross_zx_ppm": 300.0}, "accel"),
    "acc_K2": ({"k2_z_ug_g2": 300.0}, "accel"),
    "acc_drift": ({"drift_x_ug": 1000.0}, "accel"),
    "gyr_bias": ({"bias_y_deg_h": 20.0}, "gyro"),
    "gyr_scale": ({"scale_z_ppm": 300.0}, "gyro"),
    "gyr_misalignment": ({"cross_xy_ppm": 300.0}, "gyro"),
    "gyr_gsens": ({"gsens_xz_deg_h_g": 20.0}, "gyro"),
    "gyr_nonlinearity": ({"cubic_x_ppm_rad2_s2": 100.0}, "gyro"),
}
RATES = {
    "fog_scale": ({"scale_a_ppm": 300.0}, "fog"),
    "fog_bias": ({"bias_a_deg_h": 10.0}, "fog"),
    "gyr_scale": ({"scale_z_ppm": 300.0}, "gyro"),
    "data_latency": ({"latency_ms": 0.1}, "fog"),
    "gyr_misalignment": ({"cross_xy_ppm": 300.0}, "gyro"),
    "gyr_bandwidth": ({"tau_ms": 0.5}, "fog"),
}


def one(observations, id, values, sensor):
    return make_effect(id, values, observations.scenario, sensor=sensor)


def differences(observations, effect, around):
    """How predictions change with an effect, by a step up and one down; from nothing where it has
    no negative size.
    """
    positive = any(p.positive for p in effect.parameters)
    down = replace(effect, values={n: 0.0 if positive else -v for n, v in effect.values.items()})
    pairs = zip(
        observations.predict([*around, effect]), observations.predict([*around, down]), strict=True
    )
    return [(up - low) / (1 if positive else 2) for up, low in pairs]


def assert_alike(observations, effect, around):
    found = observations.changes(effect, around)
    assert found
    for i, expected in enumerate(differences(observations, effect, around)):
        column = found.get(i, np.zeros_like(expected))
        scale = np.linalg.norm(expected)
        assert np.linalg.norm(column - expected) <= 0.02 * scale + 1e-11, observations.channels[
            i
        ].name


def test_a_noisy_gyro_turned_across_the_axis_of_a_fog_shows_no_scale_factor():
    """The FOG senses no turn: its scale factor's column is the gyro's noise, which is in what the
    FOG should read as well. The correlation of the two is 0 only where no sample tells its own.
    """
    time, across = np.arange(3000) / 50.0, np.array([0.8, -0.6, 0.0])  # at right angles to the axis
    rate = np.outer(np.where(time % 20 > 5, np.sin(0.5 * time), 0.0), across)
    scores = []
    for rng in (np.random.default_rng(seed) for seed in range(20)):
        read = rate + 3e-4 * rng.standard_normal(rate.shape)
        columns = {f"gyro_{a}_rad_s": read[:, k] for k, a in enumerate("xyz")}
        columns["fog_a_rad_s"] = 2e-5 * rng.standard_normal(len(time))
        observations = observe(FOG, [Recording.from_columns(time, columns)])
        effect = one(observations, "fog_scale", {"scale_a_ppm": 300.0}, "fog")
        column = observations.columns(effect, ["scale_a"], ())[0][1][0]
        products = column * observations.residuals(())[0]
        scores.append(products.sum() / np.sqrt((products**2).sum()))
    # the products of two samples that tell each other are alike: up to twice the variance
    assert abs(np.mean(scores)) < 4 * np.sqrt(2 / len(scores))


@pytest.mark.parametrize("id", SMALL)
def test_the_columns_by_hand_are_the_differences_of_what_is_predicted(triads, id):
    observations, around = triads
    assert [c.axis for c in observations.channels] == ["norm", "x", "y", "z", "turn"]
    values, sensor = SMALL[id]
    assert_alike(observations, one(observations, id, values, sensor), around)


@pytest.mark.parametrize("id", RATES)
def test_so_are_those_of_a_fog_beside_a_gyro_triad(fog, id):
    observations, around = fog
    values, sensor = RATES[id]
    assert_alike(observations, one(observations, id, values, sensor), around)


def test_a_late_fog_is_a_gyro_that_is_early(fog):
    """By hand one delay is the other's advance, to its column: of a whole plausible delay it would
    bend the other way.
    """
    observations = fog[0]
    late, early = (
        observations.changes(one(observations, "data_latency", {"latency_ms": 5.0}, s), ())[0]
        for s in ("fog", "gyro")
    )
    assert np.linalg.norm(late + early) < 0.02 * np.linalg.norm(late)
    gyro = Hypothesis(one(observations, "data_latency", {"latency_ms": 5.0}, "gyro"), ("latency",))
    (told,) = normalise_tone_phase(
        FittedModel((), (), (replace(FittedTerm.start(gyro), values=(-2e-3,)),)), observations
    ).terms
    assert (told.effect.sensor, told.values) == ("fog", (2e-3,))


def test_all_coefficients_of_a_curve_in_one_pass_are_each_by_itself(triads):
    observations, around = triads
    names = tuple(f"c{k}" for k in range(4))
    curve = LearnedReading(
        dict.fromkeys(names, 1e-5), "accel", "x", coordinate="force_y", knots=(-G, -3.0, 3.0, G)
    )
    together = observations.columns(curve, names, around)
    for k, name in enumerate(names):
        for i, column in observations.changes(replace(curve, values={name: 1e-5}), around).items():
            which, block = together[i]
            assert np.allclose(block[which.index(k)], column, rtol=1e-9, atol=1e-16)


def test_the_body_has_no_axes_but_the_sensors_own(triads):
    """A small turn of the body's axes is no physics: three of nine cross terms of the accelerometer
    have no column.
    """
    observations, around = triads
    effect = one(
        observations,
        "acc_cross_axis",
        {f"cross_{p}_ppm": 300.0 for p in ("xy", "xz", "yx", "yz", "zx", "zy")},
        "accel",
    )
    names = list(effect.values)
    told = {
        names[k]
        for numbers, _ in observations.columns(effect, names, around).values()
        for k in numbers
    }
    assert told == {"cross_yx", "cross_zx", "cross_zy"}


def test_a_memory_of_the_force_is_shaken_away_by_the_hand(triads):
    observations, around = triads
    assert (
        observations.changes(
            one(observations, "acc_hysteresis", {"hysteresis_x_ug": 500.0}, "accel"), around
        )
        == {}
    )


def test_gravity_is_carried_across_a_turn_as_rotations_compose():
    """Against scipy's rotations, one after the other: about x by 90 deg, then about z by 90 deg."""
    time = np.arange(300) / 100.0
    rate = np.zeros((300, 3))
    rate[100:150, 0] = rate[150:200, 2] = np.pi / 2 / 0.5
    up = np.array([0.0, 0.0, 1.0])
    force, attitude = np.empty((300, 3)), Rotation.identity()
    for k in range(300):
        force[k] = G * attitude.inv().apply(up)
        step = (rate[k] + rate[min(k + 1, 299)]) / 2 / 100
        attitude = attitude * Rotation.from_rotvec(step)
    windows = Windows.around(time, [(90, 210)])
    assert np.abs(GravityTransport(windows, force, rate).errors).max() < 1e-12
    late = np.vstack([rate[3:], rate[:3]])  # a gyro that runs ahead turns it somewhere else
    # ... but not from rest to rest
    assert np.abs(GravityTransport(windows, force, late).errors).max() < 1e-12
    assert np.abs(GravityTransport(windows, force, 1.01 * rate).errors).max() > 0.01


def test_turns_lie_between_rests_that_are_long_enough():
    stop = np.repeat([0, -1, 1, -1, 2], [50, 30, 5, 30, 50])
    assert turns_between(np.arange(165) / 10.0, stop) == []
    stop = np.repeat([0, -1, 1], [50, 30, 50])
    assert turns_between(np.arange(130) / 10.0, stop) == [(49, 80)]


def long_log():
    """Forty rests of 4 s at 100 Hz with moves between them, as a recording."""
    rng = rng_of("a long log")
    rows, spin = [], []
    for _ in range(40):
        up = rng.normal(size=3)
        rows += [np.tile(G * up / np.linalg.norm(up), (400, 1)), rng.normal(0, 6, (100, 3))]
        spin += [np.zeros((400, 3)), rng.normal(0, 1, (100, 3))]
    values = np.vstack(rows) + rng.normal(0, 0.01, (20000, 3))
    rates = np.vstack(spin) + rng.normal(0, 0.001, (20000, 3))
    columns = {f"accel_{a}_m_s2": values[:, k] for k, a in enumerate("xyz")} | {
        f"gyro_{a}_rad_s": rates[:, k] for k, a in enumerate("xyz")
    }
    return Recording.from_columns(np.arange(20000) / 100.0, columns)


def test_a_long_log_keeps_its_rests_when_they_are_averaged():
    log = long_log()
    short = condensed(log)
    stop, before = known_stops(short), known_stops(log)
    assert len(short) < len(log)
    assert (stop >= 0).sum() < KEPT_AT_REST + 100 * (stop.max() + 1)
    assert stop.max() == before.max()
    assert (stop < 0).sum() == (before < 0).sum()  # what happens between the rests is left alone
    assert condensed(short) is short
    name = "accel_x_m_s2"
    for k in range(stop.max() + 1):
        assert (
            abs(short.column(name)[stop == k].mean() - log.column(name)[before == k].mean()) < 0.005
        )


def test_gross_errors_are_looked_for_in_the_log_as_it_came():
    """Rows and rests of the log itself, not of the shorter one that its averages make."""
    log = long_log()
    x = log.column("accel_x_m_s2").copy()
    hit = 500 * np.arange(40) + 200  # in the middle of each rest
    x[hit] += 0.5
    bench = prepare(TRIADS.model_copy(update={"effect": ()}), [rewritten(log, accel_x_m_s2=x)])
    assert len(bench.observations.recordings[0]) < len(log)
    (fault,) = [f for f in bench.faults if f.effect.id == "data_outlier"]
    assert fault.axes == ("x",)
    assert fault.effect.value("share") == pytest.approx(
        40 / inner(log.time, known_stops(log)).sum(), rel=0.02
    )


def test_the_edges_of_rests_are_not_at_rest():
    stop = np.repeat([-1, 0, -1, 1], [10, 40, 10, 400])
    rest = inner(np.arange(460) / 100.0, stop)
    assert rest[:20].sum() == 0
    assert rest[20:40].all()
    assert rest[60:110].sum() == 0
    assert rest[120:400].all()


@pytest.mark.parametrize(
    ("rows", "dropped"), [(slice(120, 123), "all"), (slice(0, 0), "none"), (slice(50, 250), "none")]
)
def test_a_rest_that_was_touched_is_none(rows, dropped):
    """A brief push takes a short rest with it; what lasts half of it is no push, and stays to be
    explained.
    """
    rng = rng_of(f"touched {rows}")
    values = rng.normal(0, 1, (400, 2))
    values[rows, 0] += 30.0
    kept = undisturbed(np.ones(400, bool), np.zeros(400, int), np.arange(400) / 100.0, values)
    assert kept.any() == (dropped == "none")
    assert kept.all() or dropped == "all"


def test_a_long_rest_loses_only_the_touch():
    values = rng_of("touched once").normal(0, 1, (6000, 1))
    values[3000:3003] += 30.0
    kept = undisturbed(np.ones(6000, bool), np.zeros(6000, int), np.arange(6000) / 100.0, values)
    assert not kept[3000:3003].any()
    assert kept.sum() > 5980


def test_noise_is_no_less_than_rests_are_apart():
    """Forty rests of sixty samples, each with its own offset: white noise by the spectrum of most
    rows, not from rest to rest.
    """
    rng = rng_of("rests apart")
    stop = np.repeat(np.arange(40), 60)
    residual = rng.normal(0, 1, 2400) + rng.normal(0, 2.0, 40)[stop]
    steps, mean = rest_steps(stop), np.zeros((2400, 0))
    white = NoiseFit.known(WhiteFlickerWalk(1.0))
    model = no_less(white, steps, residual, mean).model
    variance = ((steps**2) @ model.spectrum(2400)).mean()
    apart = np.var(np.diff([residual[stop == k].mean() for k in range(40)]))
    assert variance == pytest.approx(apart, rel=0.05)
    assert no_less(white, steps, rng.normal(0, 0.9, 2400), mean) is white


def test_what_may_follow_the_pose_is_as_rich_as_the_poses_allow():
    rng = rng_of("poses")
    few, many = rng.normal(size=(6, 3)), rng.normal(size=(60, 3))
    columns = {
        n: direction_polynomials(np.repeat(f, 10, axis=0), np.repeat(np.arange(n), 10))
        for n, f in ((6, few), (60, many))
    }
    assert len(columns[6]) == 0
    assert len(columns[60]) >= 3 + 5


def test_the_crest_of_a_quick_turn_is_no_outlier():
    time = np.arange(2000) / 100.0
    rate = np.sin(2 * np.pi * 9 * time) * np.exp(-(((time % 2) - 1) ** 2) / 0.005) + rng_of(
        "crest"
    ).normal(0, 0.002, 2000)
    assert (off_neighbours(rate) > 8).sum() == 0
    rate[777] += 0.5
    assert off_neighbours(rate)[777] > 8


def test_long_recordings_may_show_long_lags():
    assert lags_of(600.0) == LAGS
    assert max(lags_of(8400.0)) == pytest.approx(60 * 2.5**3)
    assert lags_of(8400.0)[: len(LAGS)] == LAGS


HEATED = parse_scenario(
    {
        "schema": 1,
        "name": "heated at rest",
        "site": {"gravity_m_s2": G},
        "rig": {"table": "handheld"},
        "sensor": [
            {
                "name": "accel",
                "kind": "accelerometer",
                "rate_hz": 1.0,
                "adjustable": ["bias", "acc_temp_bias"],
            }
        ],
    }
)


@pytest.mark.parametrize(("late", "step"), [(True, 4.0), (False, 1.0)], ids=["late", "bent"])
def test_only_what_no_curve_over_temperature_does_is_called_late(late, step):
    """A triad at rest through a cycle of two hours, read every so many seconds: bias by a bent law
    of the temperature, of now or of some minutes ago.
    """
    rng, time = rng_of(f"heated {late}"), np.arange(0.0, 6000.0, step)
    cycle = 40 * np.sin(2 * np.pi * time / 5000) * np.exp(-time / 9000)
    felt = cycle if not late else first_order_lag(time, cycle, 200.0)
    bias = 1e-3 * felt + 2e-5 * felt**2
    values = (
        np.array([0.2, -0.1, 9.75])
        + bias[:, None] * [1.0, -0.5, 0.7]
        + rng.normal(0, 2e-3, (len(time), 3))
    )
    columns = {f"accel_{a}_m_s2": values[:, k] for k, a in enumerate("xyz")} | {
        "temperature_degC": 25 + cycle
    }
    found = diagnose(HEATED, [Recording.from_columns(time, columns)]).findings
    assert any("acc_temp_bias" in f.names or f.effect is None for f in found)
    assert any("warming and cooling differ" in f.statement for f in found) == late


@pytest.mark.parametrize("beside", ["nothing", "a slower gyro"])
def test_a_fog_that_no_gyro_follows_has_no_findings(beside):
    """No gyro triad tells the rate that the FOG felt, or none between its readings."""
    moves = [
        {"action": "move", "up": up, "rate_deg_s": 60.0, "dwell_s": 3.0}
        for up in ("[1, 0.2, 0]", "[0, 1, 0.3]", "[0.5, 0, 1]", "[-1, 0.4, 0.2]", "[0, -1, 0.5]")
    ]
    accel = {"name": "accel", "kind": "accelerometer", "rate_hz": 25.0}
    fog = {"name": "fog", "kind": "fog", "axes": ["a"], "input_axis": [0.6, 0.0, 0.8]}
    fog |= {"rate_hz": 50.0, "adjustable": ["bias", "scale"]}
    table = {
        "schema": 1,
        "site": {"gravity_m_s2": G, "latitude_deg": 45.0},
        "rig": {"table": "handheld"},
        "sensor": [accel | {"adjustable": ["bias", "scale", "cross_axis"]}, fog],
        "sequence": moves,
    }
    noise = [
        {"id": "acc_noise", "white_ug_rthz": 30.0},
        {"id": "gyr_noise", "sensor": "fog", "white_deg_rth": 0.003},
    ]
    if beside == "a slower gyro":
        adjustable = ["bias", "scale", "cross_axis"]
        gyro = {"name": "gyro", "kind": "gyro", "rate_hz": 10.0, "adjustable": adjustable}
        table["sensor"].insert(1, gyro)
        noise.append({"id": "gyr_noise", "sensor": "gyro", "white_deg_rth": 0.1})
    recording = SimulatedLaboratory().record(parse_scenario(table | {"effect": noise}), 2)
    assert diagnose(parse_scenario(table), [recording]).findings == ()


def test_a_triad_is_inverted_as_its_matrix_says():
    """Scales, cross-axis terms and biases by hand: what was read gives back what was felt."""
    matrix = np.array([[1.05, 0.04, 0.0], [0.0, 0.98, 0.03], [-0.02, 0.0, 1.01]])
    bias = np.array([0.2, -0.1, 0.05])
    sizes = {
        "acc_scale": {"scale_x": 0.05, "scale_y": -0.02, "scale_z": 0.01},
        "acc_cross_axis": {"cross_xy": 0.04, "cross_yz": 0.03, "cross_zx": -0.02},
        "acc_bias": {"bias_x": 0.2, "bias_y": -0.1, "bias_z": 0.05},
    }
    effects = [CATALOGUE[id](values, "accel") for id, values in sizes.items()]
    (triad,) = TRIADS.sensors("accelerometer")
    np.testing.assert_allclose(sensor_matrix(triad, effects), matrix)
    force = rng_of("inverted").normal(size=(50, 3)) * G
    read = force @ matrix.T + bias
    columns = {f"accel_{a}_m_s2": read[:, k] for k, a in enumerate("xyz")}
    recording = Recording.from_columns(np.arange(50) / 50, columns)
    found = inverted(triad, TRIADS, recording, effects, None, read)
    np.testing.assert_allclose(found, force, atol=1e-8)
