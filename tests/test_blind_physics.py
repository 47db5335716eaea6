"""The physics of the blind trials: worked by hand, and against the product's simulator on the same
motion.
"""

from dataclasses import replace

import numpy as np
import pytest
from blind.cases import KINDS, TYPES, make, possible
from blind.catalogue import bound, listed, unlisted
from blind.faults import Rows, faults
from blind.files import write_recording, write_scenario
from blind.laboratory import Lab, another, draw
from blind.memory import leaky, play
from blind.motion import Move, Plan
from blind.oracle import Oracle, adjustable
from blind.second_author import second_author
from blind.world import Past, felt, readings
from statistics_helpers import rng_of

from tiltcal.cli import main
from tiltcal.effects import CATALOGUE
from tiltcal.laboratory.scenario import load_scenario
from tiltcal.recordings.recording_files import read_recording

ARCSEC = np.pi / 648000
TABLES = ("dual_tumble", "placing_sweep", "vertical_turn", "three_rates")


def faultless(lab: Lab) -> Lab:
    """The same with ideal sensors."""
    return replace(
        lab,
        sensors=tuple(replace(s, M=np.eye(len(s.M)), b=np.zeros(len(s.b))) for s in lab.sensors),
    )


def lab_of(kind: str, name: str) -> Lab:
    return faultless(draw(rng_of(name), kind, 1))


# --------------------------------------------------------------------------------------------------
# ------------ by hand


def test_a_move_arrives_with_no_rate_and_cruises_in_between():
    move = Move(0, 1.0, 5.0, 0.0, 2.0, ramp=0.25)
    t = np.array([0.0, 1.0, 3.0, 5.0, 9.0])
    assert move.angle(t) == pytest.approx([0, 0, 1, 2, 2], abs=1e-12)
    rate = np.gradient(move.angle(np.linspace(1, 5, 4001)), 1e-3)
    assert rate[0] == pytest.approx(0, abs=1e-4)
    assert rate[2000] == pytest.approx(2 / 4 / 0.75)  # the ramps cost a quarter of the way


def test_at_rest_a_tilted_triad_senses_gravity_along_the_tilt():
    lab = lab_of("placing_sweep", "placing")
    plan = Plan([np.pi / 6])
    plan.dwell(2.0)
    state = felt(replace(lab, track=plan.track()), (), np.array([1.0]), Past(lab))
    assert state.f[0] == pytest.approx(lab.gravity * np.array([-0.5, 0, np.sqrt(3) / 2]), rel=1e-9)


def test_a_turning_lever_arm_feels_the_centripetal_acceleration():
    lab = replace(lab_of("three_rates", "lever"), lever=np.array([0.05, 0.0, 0.0]))
    plan = Plan([0.0, 0.0, 0.0])
    plan.go({0: 20.0}, 2.0, ramp=0.2)
    track = plan.track()
    state = felt(replace(lab, track=track), (), np.array([track.end_s / 2]), Past(lab))
    rate = 2.0  # while it cruises
    assert state.f[0] == pytest.approx([-0.05 * rate**2, 0, lab.gravity], abs=1e-5)
    assert state.w[0, 2] == pytest.approx(
        rate + 7.292115e-5 * np.sin(np.deg2rad(lab.latitude)), rel=1e-6
    )


def test_memories_lag_as_they_should():
    assert play(np.array([0.0, 0.5, 2.0, 1.5, 0.0, 0.5]), 1.0) == pytest.approx(
        [0, 0.5, 1, 0.5, -1, -0.5]
    )
    step = np.r_[np.zeros(1), np.ones(1000)]
    assert leaky(step, 2.0, 0.01)[200] == pytest.approx(1 - np.exp(-1), rel=1e-9)


def test_the_lagged_room_follows_its_differential_equation():
    room = draw(rng_of("room"), "dual_tumble", 1).room
    t = np.linspace(0, 100, 20001)
    T = room.lagged(t, 20.0)
    assert T[0] == pytest.approx(room.at(t[:1])[0])
    assert 20 * np.gradient(T, t)[1:-1] + T[1:-1] == pytest.approx(room.at(t)[1:-1], abs=1e-4)


# --------------------------------------------------------------------------------------------------
# ---------------- laws


@pytest.mark.parametrize("kind", KINDS)
def test_every_effect_is_nothing_at_zero_and_finite_at_its_plausible_size(kind):
    lab = draw(rng_of(kind), kind, 1)
    t = np.linspace(0.5, lab.track.end_s - 0.5, 60)
    past = Past(lab)
    zero = readings(lab, (), t, past)
    for spec in listed(lab) + unlisted(lab) + second_author(lab):
        for shape in (
            spec.shapes(rng_of("x"), lab)[0],
            spec.odd(rng_of("x"), lab) if spec.odd else None,
        ):
            if shape is not None:
                nothing = readings(lab, [spec.physics(np.zeros(len(spec.names)), shape)], t, past)
                assert np.abs(nothing - zero).max() < 1e-9, spec.id
                full = readings(
                    lab,
                    [spec.physics(np.full(len(spec.names), spec.plausible * spec.unit), shape)],
                    t,
                    past,
                )
                assert np.isfinite(full).all(), spec.id


def test_what_is_called_listed_stands_in_the_catalogue_under_the_same_parameter_names():
    names, missing = {}, []
    for kind in KINDS:
        lab = draw(rng_of(kind), kind, 1)
        names |= {spec.id: spec for spec in listed(lab)}
        clean = Rows(
            np.arange(9.0),
            np.zeros((9, len(lab.axes))),
            np.tile(np.eye(9)[:, :1] * 50, len(lab.channels)),
            np.zeros(9),
        )
        assert {fault.id for fault in faults(lab, clean)} <= set(CATALOGUE)
    assert set(names) <= set(CATALOGUE)
    assert len({i for i in names if names[i].drawn}) + 15 >= 45
    for spec in names.values():
        known = {
            f"{n}{p.suffix}"
            for p in CATALOGUE[spec.id].parameters
            for n in p.expand(("x", "y", "z", "a"))
        }
        missing += [
            f"{spec.id}: {n}"
            for n in spec.names
            if n not in known and not n.startswith("bias_table")
        ]
    assert not missing


def test_there_are_at_least_eight_effects_that_no_catalogue_lists():
    new = {spec.id for kind in KINDS for spec in unlisted(draw(rng_of(kind), kind, 1))}
    assert len(new) >= 8
    assert not new & set(CATALOGUE)


# --------------------------------------------------------------------------------------------------
# -------------- oracle


def test_adjustable_columns_are_the_derivatives_of_the_readings():
    for kind in ("placing_sweep", "vertical_turn", "three_rates"):
        lab = draw(rng_of(kind), kind, 1)
        oracle = Oracle(lab, rng_of("o"))
        A = adjustable(lab, oracle.state, oracle.zero)
        other = replace(
            lab, sensors=tuple(replace(s, M=s.M + 1e-6, b=s.b + 1e-6) for s in lab.sensors)
        )
        moved = readings(other, (), oracle.t, oracle.past, oracle.state) - oracle.zero
        assert A.sum(2) * 1e-6 == pytest.approx(moved, rel=1e-4, abs=1e-12)


def test_the_non_centrality_is_the_mean_excess_of_the_test_statistic():
    lab = draw(rng_of("non-centrality"), "placing_sweep", 1)
    oracle, rng = Oracle(lab, rng_of("o")), rng_of("draws")
    spec = next(s for s in listed(lab) if s.id == "acc_temp_bias")
    p = np.eye(len(spec.names))[0] * spec.plausible * spec.unit * 0.02
    r = oracle.residual(oracle.signal([spec.physics(p, {})])[:, :, None])[:, 0]
    lam = r @ r
    u = r / np.sqrt(lam)
    score = (
        u @ (r[:, None] + rng.standard_normal((len(r), 400)))
    ) ** 2  # chi-square(1, lambda): mean 1 + lambda
    assert score.mean() == pytest.approx(1 + lam, abs=4 * np.sqrt((2 + 4 * lam) / 400))


# -------------------------------------------------------------------------------------------------
# against the simulator


@pytest.mark.parametrize("kind", TABLES)
def test_the_products_simulator_reads_the_same_for_the_same_motion(kind, here):
    """Two programs that share no line agree far below the noise wherever nothing is concealed."""
    lab = replace(lab_of(kind, kind), lever=np.zeros(3))
    t = np.round(np.arange(0, min(lab.track.end_s, 60), 1 / lab.rate_hz), 4)
    rows = Rows(t, lab.track.angles(t), readings(lab, (), t, Past(lab)), lab.room.at(t))
    write_recording(here / "motion.csv", lab, rows, None)
    write_scenario(here / "scenario.toml", lab)
    assert (
        main(
            [
                "simulate",
                "scenario.toml",
                "--motion",
                "motion.csv",
                "--noise",
                "off",
                "-o",
                "told.csv",
            ]
        )
        == 0
    )
    told, scenario = read_recording(here / "told.csv"), load_scenario(here / "scenario.toml")
    for s, sensor in enumerate(lab.sensors):
        own = [c for c, (k, _) in enumerate(lab.channels) if k == s]
        error = told.sensor(scenario.named(sensor.name)).values - rows.y[:, own]
        # the readout is written in steps of 0.04 arcsec, 1.7e-7 rad
        limit = 3e-5 if sensor.kind in ("gyro", "fog") else 5e-6
        assert np.abs(error).max() < limit, sensor.name


# --------------------------------------------------------------------------------------------------
# --------------- cases


@pytest.mark.parametrize(
    ("kind", "type_"),
    [(k, t) for k in ("field_turns", "six_faces") for t in TYPES if possible(k, t)],
)
def test_a_case_is_the_same_every_time_and_conceals_what_its_type_says(kind, type_):
    a, b = (make(kind, type_, 1, [7, 1, 2]) for _ in range(2))
    assert (a.rows.y == b.rows.y).all()
    count = {"null": 0, "pair": 2, "triple": 3}.get(type_, 1)
    assert len(a.truth["effects"]) == count
    if type_ in ("single", "odd", "pair", "triple", "unlisted"):
        assert all(e["lambda"] >= 60 for e in a.truth["effects"])
    if type_ == "impossible":
        assert a.truth["effects"][0]["lambda"] < 5


def test_another_recording_goes_no_farther_than_the_first():
    for kind in ("placing_sweep", "dual_tumble"):
        lab = draw(rng_of(kind), kind, 1)
        other = another(rng_of("other"), lab)
        first, second = (x.track.angles(np.linspace(0, x.track.end_s, 3000)) for x in (lab, other))
        assert (second.min(0) >= first.min(0) - 1e-3).all()
        assert (second.max(0) <= first.max(0) + 1e-3).all()
        assert other.T0 == lab.T0


def test_an_effect_follows_the_motion_and_the_temperature_of_the_recording_it_is_in():
    lab = draw(rng_of("first"), "dual_tumble", 1)
    other = another(rng_of("second"), lab)
    t = np.linspace(1, 60, 50)
    for id_, size, want in (
        ("table_encoder_eccentricity", [1e-5, 0.0], 1e-5 * np.cos(other.track.angles(t)[:, 0])),
        ("acc_temp_bias", [1e-3, 0.0, 0.0], 1e-3 * (other.room.at(t) - lab.T0)),
    ):
        spec = bound(next(s for s in listed(lab) if s.id == id_), other)
        physics = spec.physics(np.array(size), spec.shapes(rng_of("x"), other)[0])
        past = Past(other)
        got = (
            physics.readout(past, t)[:, 0]
            if physics.readout
            else physics.sense(past, felt(other, (), t, past))["accel"][:, 0]
        )
        assert got == pytest.approx(want, abs=1e-12)
