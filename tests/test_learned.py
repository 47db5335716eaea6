"""Curves that no name fits: their equation, one face in algebra and mechanics, files, and what they
refuse.
"""

from dataclasses import replace

import numpy as np
import pytest
from builders import ACCEL, FOG, GYRO, drive_of, effect_of, read_poses, setup_of

from tiltcal.core.errors import TiltcalError
from tiltcal.core.frames import rotation
from tiltcal.core.units import G0, unit_sign
from tiltcal.effects import make_effect
from tiltcal.effects.catalogue import to_file
from tiltcal.effects.curve_coordinates import (
    COORDINATES,
    LAST_DIRECTION,
    TURN_RATE,
    coordinate_named,
    shown_name,
    title_of,
)
from tiltcal.effects.hysteresis_and_lag import first_order_lag, play
from tiltcal.effects.mechanisms import Context
from tiltcal.forward.kinematics import closed_form
from tiltcal.forward.nominal_motion import NominalMotion
from tiltcal.setup.trajectory import Jet
from tiltsim.motion import mujoco_motion

N = 200
T = np.linspace(0.0, 40.0, N)
SETUP = setup_of("three", ACCEL, GYRO, FOG, lever_arm_m=(0.1, -0.05, 0.2))
OUTER = Jet(0.3 * T, np.full(N, 0.3), np.zeros(N))
KNOTS, SIZES = [-1.0, 2.0, 5.0, 9.0], [1e-3, -2e-3, 3e-3, 0.5e-3]


def lively():
    axes = {
        "outer": OUTER,
        "middle": Jet(np.sin(T / 5), np.cos(T / 5) / 5, -np.sin(T / 5) / 25),
        "inner": Jet(-0.5 * T, np.full(N, -0.5), np.zeros(N)),
    }
    return drive_of(axes, T, temperature=23 + 2 * np.sin(T / 6))


def learned(sensor=None, axis=None, **words):
    return make_effect("learned", words, SETUP, sensor=sensor, axis=axis)


def added(effect, sensor="accel"):
    return read_poses(SETUP, lively(), effect)[sensor] - read_poses(SETUP, lively())[sensor]


def test_a_learned_reading_is_a_sum_of_harmonics_of_the_table_s_angle():
    effect = learned("accel", "y", coordinate="table_outer", coefficients=[1e-3, 2e-3, 0.0, -3e-3])
    u = 0.3 * T
    by_hand = 1e-3 * np.cos(u) + 2e-3 * np.sin(u) - 3e-3 * np.sin(2 * u)
    np.testing.assert_allclose(added(effect)[:, 1], by_hand, atol=1e-14)
    assert not added(effect)[:, [0, 2]].any()


def test_a_learned_line_is_held_outside_its_knots():
    effect = learned(
        "accel", "x", coordinate="time", knots=[10.0, 20.0, 30.0], coefficients=[0.0, 1.0, 2.0]
    )
    np.testing.assert_allclose(added(effect)[:, 0], np.clip((T - 10) / 10, 0, 2), atol=1e-13)


def test_a_learned_saw_begins_anew_after_each_period():
    """Knots 1 and 3 with a period of 2: from 0 to 0.004 between 1 and 3, 3 and 5, -1 and 1, however
    far the angle goes.
    """
    effect = learned(
        "accel",
        "z",
        coordinate="table_outer",
        knots=[1.0, 3.0],
        period=2.0,
        coefficients=[0.0, 4e-3],
    )
    u = 0.3 * T
    by_hand = 4e-3 * ((u - 1.0) / 2 - np.floor((u - 1.0) / 2))
    np.testing.assert_allclose(added(effect)[:, 2], by_hand, atol=1e-14)
    assert np.ptp(u) > 4.0


@pytest.mark.parametrize(("power", "odd"), [(0.5, False), (1.0, False), (1.0, True), (2.0, True)])
def test_a_learned_power_has_one_number(power, odd):
    effect = learned("accel", "x", coordinate="rate_z", power=power, odd=odd, coefficients=[2e-3])
    w = read_poses(SETUP, lively())["gyro"][:, 2]
    np.testing.assert_allclose(
        added(effect)[:, 0], 2e-3 * np.abs(w) ** power * (np.sign(w) if odd else 1.0), atol=1e-14
    )


def test_a_natural_spline_between_three_knots_is_as_worked_by_hand():
    """Knots 0, 1, 2 with values 0, 1, 0: M1 = -3, so s(u) = (3 u - u^3)/2 on [0, 1], and its mirror
    image.
    """
    effect = learned(
        "accel", "x", coordinate="time", knots=[0.0, 20.0, 40.0], coefficients=[0.0, 1.0, 0.0]
    )
    u = 1 - np.abs(T / 20 - 1)
    np.testing.assert_allclose(added(effect)[:, 0], (3 * u - u**3) / 2, atol=1e-13)


def test_a_curve_that_holds_keeps_its_last_value_over_temperature():
    """What completes a law's form is not known beyond what was seen: there only the law goes on."""
    warm = lively().temperature - lively().reference_temperature
    law = {"coordinate": "temperature", "knots": [-0.5, 0, 0.5], "coefficients": [1e-3, 0, 1e-3]}
    outside = np.abs(warm) > 0.5
    assert outside.any()
    held, going = (
        added(learned("accel", "x", **law, **more))[:, 0] for more in ({"holds": True}, {})
    )
    np.testing.assert_allclose(held[outside], 1e-3, atol=1e-14)
    np.testing.assert_allclose(going[outside], 4e-3 * warm[outside] ** 2, atol=1e-13)
    np.testing.assert_allclose(held[~outside], going[~outside], atol=1e-14)


def test_a_law_of_temperature_goes_on_beyond_its_knots():
    """Three knots: the parabola 0.001 u^2, as far as it goes. Two: the line, and with four of them
    in it, by the last slope.
    """
    warm = lively().temperature - lively().reference_temperature
    for knots, law in (
        ([-1, 0, 1], 1e-3 * warm**2),
        ([-1, 1], 1e-3 * warm),
        ([-1.5, -0.5, 0.5, 1.5], 1e-3 * warm),
    ):
        values = [1e-3 * k**2 if len(knots) == 3 else 1e-3 * k for k in knots]
        effect = learned("accel", "x", coordinate="temperature", knots=knots, coefficients=values)
        np.testing.assert_allclose(added(effect)[:, 0], law, atol=1e-14)
    assert np.ptp(warm) > 3.5


def test_a_learned_scale_multiplies_its_own_input_and_a_lag_is_felt_late():
    force = read_poses(SETUP, lively())["accel"]
    scale = learned(
        "accel",
        "z",
        coordinate="input",
        knots=[-9.9, 9.9],
        coefficients=[-1e-3, 1e-3],
        per_input=True,
    )
    np.testing.assert_allclose(added(scale)[:, 2], 1e-3 * force[:, 2] ** 2 / 9.9, atol=1e-12)
    late = learned(
        "accel",
        "x",
        coordinate="temperature",
        knots=[-5.0, 5.0],
        coefficients=[-5.0, 5.0],
        lag_s=4.0,
    )
    warm = 2 * np.sin(T / 6)
    np.testing.assert_allclose(
        added(late)[:, 0], first_order_lag(T, warm - warm.mean(), 4.0), atol=1e-12
    )


def test_a_late_rate_of_warming_is_that_of_the_late_temperature():
    """d/dt of 1/(1 + lag s) T is (T - late T) / lag: nothing at first, as both begin at one
    temperature.
    """
    late = learned(
        "accel", "x", coordinate="warming", knots=[-1.0, 1.0], coefficients=[-1.0, 1.0], lag_s=4.0
    )
    warm = 2 * np.sin(T / 6)
    found = added(late)[:, 0]
    np.testing.assert_allclose(
        found[5:-5], ((warm - first_order_lag(T, warm, 4.0)) / 4.0)[5:-5], atol=0.01
    )
    assert abs(found[0]) < 0.05 < np.abs(found).max()


def test_coordinates_are_what_their_names_say():
    line = {"knots": [-1e3, 1e3], "coefficients": [-1e3, 1e3]}  # the curve u itself
    plain = read_poses(SETUP, lively())
    force, rate = plain["accel"], plain["gyro"]
    warm = 2 * np.sin(T / 6)
    for coordinate, expected in (
        ("force_y", force[:, 1]),
        ("rate_z", rate[:, 2]),
        ("input", force[:, 0]),
        ("warming", np.gradient(warm, T)),
        ("since_move", 0),
    ):
        found = added(learned("accel", "x", coordinate=coordinate, **line))[:, 0]
        np.testing.assert_allclose(
            found, np.broadcast_to(expected, N), atol=1e-11, err_msg=coordinate
        )
    # what is not along (1, 1, 1)
    across = np.linalg.norm(rate - np.outer(rate @ np.ones(3) / 3, np.ones(3)), axis=1)
    np.testing.assert_allclose(
        added(learned("fog", "a", coordinate="transverse", **line), "fog")[:, 0], across, atol=1e-11
    )


FACES = [
    {
        "on": "readout",
        "axis": "middle",
        "coordinate": "table_outer",
        "coefficients": [1e-3, -2e-3, 5e-4],
    },
    {
        "on": "readout",
        "axis": "inner",
        "coordinate": "time",
        "knots": [0, 11, 23, 40],
        "coefficients": SIZES,
    },
    {
        "on": "tilt",
        "slot": "base",
        "turn": "x",
        "coordinate": "table_outer",
        "coefficients": [2e-3, 1e-3],
    },
    {
        "on": "tilt",
        "slot": "inner_bearing",
        "turn": "y",
        "coordinate": "table_outer",
        "knots": KNOTS,
        "coefficients": SIZES,
    },
    {
        "on": "tilt",
        "slot": "mount",
        "turn": "z",
        "coordinate": "temperature",
        "knots": [-3, 0, 3],
        "coefficients": SIZES[:3],
    },
    {
        "on": "tilt",
        "slot": "base",
        "turn": "y",
        "coordinate": "speed",
        "lag_s": 6.0,
        "power": 1.0,
        "odd": True,
        "coefficients": [5e-3],
    },
    *(
        {**where, "coordinate": "turn_rate_middle", "power": 2.0, "coefficients": [0.1]}
        for where in (
            {"on": "readout", "axis": "middle"},
            {"on": "tilt", "slot": "middle_bearing", "turn": "x"},
        )
    ),
    {
        "on": "tilt",
        "slot": "outer_bearing",
        "turn": "x",
        "coordinate": "table_middle",
        "play": 0.6,
        "power": 1.0,
        "odd": True,
        "coefficients": [2e-3],
    },
    {
        "on": "tilt",
        "slot": "mount",
        "turn": "x",
        "coordinate": "table_outer",
        "lag_s": 4.0,
        "coefficients": [2e-3, 1e-3],
    },
    *(
        {
            **where,
            "coordinate": "table_outer",
            "beside": "table_middle",
            "coefficients": [0.0, 2e-3, 0.0, 0.0, 1e-3, *[0.0] * 31],
        }
        for where in (
            {"on": "readout", "axis": "middle"},
            {"on": "tilt", "slot": "mount", "turn": "y"},
        )
    ),
    *(
        {
            **where,
            "coordinate": "table_middle",
            "times": "temperature",
            "coefficients": [1e-3, 5e-4],
        }
        for where in (
            {"on": "readout", "axis": "middle"},
            {"on": "tilt", "slot": "middle_bearing", "turn": "x"},
        )
    ),
    *(
        {
            "on": "readout",
            "axis": "middle",
            "coordinate": "table_middle",
            "times": times,
            "coefficients": [1e-3, 5e-4],
        }
        for times in ("table_outer", "speed")
    ),
    *(
        {"on": "tilt", "slot": "mount", "turn": "x", "coordinate": "force_y", **law}
        for law in (
            {"knots": [-10, 0, 10], "coefficients": [-3e-3, 0.0, 1e-3]},
            {"lag_s": 4.0, "power": 1.0, "odd": True, "coefficients": [2e-4]},
            {"lag_s": 4.0, "relaxing": True, "power": 1.0, "odd": True, "coefficients": [2e-4]},
            {"play": 3.0, "power": 1.0, "odd": True, "coefficients": [2e-3]},
        )
    ),
]


@pytest.mark.parametrize(
    "face",
    FACES,
    ids=lambda f: " ".join(
        [f["on"], f["coordinate"], *(k for k in ("beside", "times", "relaxing", "play") if k in f)]
    ),
)
def test_a_learned_motion_is_the_same_in_algebra_and_in_mechanics(face):
    effect = learned(**face)
    algebra, mechanics = (
        mover(SETUP, lively(), [effect]) for mover in (closed_form, mujoco_motion)
    )
    plain = closed_form(SETUP, lively())
    for one, other in (
        (algebra.force, mechanics.force),
        (algebra.rate, mechanics.rate),
        (algebra.up, mechanics.up),
    ):
        np.testing.assert_allclose(other, one, rtol=0, atol=1e-11)
    assert np.abs(algebra.up - plain.up).max() > 1e-4


def test_curves_that_tilt_a_frame_about_one_axis_are_one_turn():
    """A body of the simulator has six joints, and a diagnosis may find more curves."""
    tilts = [
        learned(on="tilt", slot="base", turn=turn, coordinate="table_outer", coefficients=[size])
        for size, turn in zip(np.linspace(1e-4, 3e-4, 9), "xyzxyzyxz", strict=True)
    ]
    one, other = (mover(SETUP, lively(), tilts) for mover in (closed_form, mujoco_motion))
    np.testing.assert_allclose(other.force, one.force, rtol=0, atol=1e-11)
    np.testing.assert_allclose(other.rate, one.rate, rtol=0, atol=1e-11)


@pytest.mark.parametrize(
    ("power", "odd"),
    [(0.5, False), (0.5, True), (1.0, True), (2.0, False), (2.0, True), (3.0, True)],
)
def test_derivatives_of_a_learned_power(power, odd):
    effect = learned(
        on="readout",
        axis="outer",
        coordinate="table_outer",
        power=power,
        odd=odd,
        coefficients=[1.0],
    )
    u, h = np.array([-1.3, -0.2, 0.4, 2.1]), 1e-4
    slope = (effect.curve(u + h) - effect.curve(u - h)) / (2 * h)
    bend = (effect.curve(u + h) - 2 * effect.curve(u) + effect.curve(u - h)) / h**2
    np.testing.assert_allclose(effect.curve(u, 1), slope, rtol=1e-6)
    np.testing.assert_allclose(effect.curve(u, 2), bend, rtol=1e-5, atol=1e-6)
    assert np.isfinite([effect.curve(np.zeros(1), order) for order in (0, 1, 2)]).all()


def test_derivatives_of_a_learned_curve_are_those_of_its_values():
    x = np.linspace(-0.9, 8.9, 4001)
    for table in (
        {"coefficients": [1, 2, 0, -3]},
        {"knots": KNOTS, "coefficients": [1, -2, 3, 0.5]},
    ):
        effect = learned(on="readout", axis="outer", coordinate="table_outer", **table)
        for order in (1, 2):
            slope = np.gradient(effect.curve(x, order - 1), x)
            np.testing.assert_allclose(effect.curve(x, order)[5:-5], slope[5:-5], atol=0.02)
    # beyond the last knot: held, at rest
    jet = effect.jet(Jet(np.array([20.0]), np.array([3.0]), np.array([1.0])))
    assert (jet.x, jet.v, jet.a) == (pytest.approx([0.5]), [0.0], [0.0])


def test_a_lively_sine_of_the_angle_has_the_chain_rule_s_rates():
    """sin(2 u), u' = 3, u'' = 1: slope 6 cos(2 u), curvature 2 cos(2 u) - 36 sin(2 u)."""
    effect = learned(
        on="readout", axis="outer", coordinate="table_outer", coefficients=[0, 0, 0, 1.0]
    )
    u = np.array([0.7])
    jet = effect.jet(Jet(u, np.array([3.0]), np.array([1.0])))
    assert jet.v == pytest.approx(6 * np.cos(1.4))
    assert jet.a == pytest.approx(2 * np.cos(1.4) - 36 * np.sin(1.4))


def test_a_learned_effect_reads_back_from_its_file():
    tables = [
        *FACES,
        {
            "on": "reading",
            "sensor": "accel",
            "axis": "z",
            "coordinate": "input",
            "knots": KNOTS,
            "coefficients": SIZES,
            "per_input": True,
            "lag_s": 2.0,
            "place": "electronics",
        },
        {
            "on": "reading",
            "sensor": "gyro",
            "axis": "y",
            "coordinate": "rate_x",
            "power": 0.5,
            "odd": True,
            "coefficients": [1e-3],
            "place": "sensor",
        },
    ]
    for table in tables:
        words = {k: v for k, v in table.items() if k not in ("sensor", "axis")}
        where = {k: table[k] for k in ("sensor", "axis") if k in table}
        effect = make_effect("learned", words, SETUP, **where, role="found", seen_in="abc")
        found = to_file(effect)
        assert (found.pop("id"), found.pop("role"), found.pop("seen_in")) == (
            "learned",
            "found",
            "abc",
        )
        again = {k: found.pop(k) for k in ("sensor", "axis") if k in found}
        assert make_effect("learned", found, SETUP, **again, role="found", seen_in="abc") == effect


GOOD = {"coordinate": "table_outer", "coefficients": [1e-3]}


@pytest.mark.parametrize(
    ("where", "words", "message"),
    [
        (
            {"sensor": "accel", "axis": "x"},
            {"cofficients": [1]},
            "unknown key 'cofficients'.*did you mean 'coefficients'",
        ),
        (
            {"sensor": "accel", "axis": "x"},
            {"on": "wheel"},
            "key on: found 'wheel', need one of reading, readout, tilt",
        ),
        (
            {"sensor": "accel", "axis": "x"},
            {"coordinate": "mood"},
            "key coordinate: found 'mood', need one of table_outer",
        ),
        (
            {"sensor": "accel", "axis": "x"},
            {"knots": [2, 1], "coefficients": [1, 2]},
            "2 knots, 2 coefficients, need two or more",
        ),
        (
            {"sensor": "accel", "axis": "x"},
            {"knots": [1, 2], "coefficients": [1]},
            "2 knots, 1 coefficients",
        ),
        (
            {"sensor": "accel", "axis": "x"},
            {"coefficients": ["a"]},
            r"key coefficients: found \['a'\], need a list of numbers",
        ),
        (
            {"sensor": "accel", "axis": "x"},
            {"knots": 3},
            "key knots: found 3, need a list of numbers",
        ),
        (
            {"sensor": "accel", "axis": "x"},
            {"coefficients": [float("nan")]},
            "need a list of numbers",
        ),
        ({"sensor": "accel", "axis": "a"}, {}, "found axis 'a', need one of x, y, z"),
        (
            {"axis": "outer"},
            {"on": "readout", "coordinate": "input"},
            "'input', need a table angle, time, temperature",
        ),
        (
            {"axis": "inner"},
            {"on": "tilt", "slot": "base", "turn": "x", "coordinate": "force_x"},
            "need a table angle, time",
        ),
        ({"axis": "x"}, {"on": "readout"}, "found axis 'x', need one of outer, middle, inner"),
        (
            {},
            {"on": "tilt", "slot": "lid", "turn": "x"},
            "key slot: found 'lid', need one of base, outer_bearing",
        ),
        (
            {},
            {"on": "tilt", "slot": "base", "turn": "up"},
            "key turn: found 'up', need one of x, y, z",
        ),
        (
            {"sensor": "accel", "axis": "x"},
            {"lag_s": -1.0},
            "key lag_s: found -1.0, need seconds, not negative",
        ),
        (
            {"sensor": "accel", "axis": "x"},
            {"power": 2.0, "coefficients": [1, 2]},
            "0 knots and 2 coefficients, need one",
        ),
        (
            {"sensor": "accel", "axis": "x"},
            {"lag_s": "late"},
            "key lag_s: found 'late', need seconds, not negative",
        ),
        (
            {"sensor": "accel", "axis": "x"},
            {"lag_s": 3.0, "relaxing": True},
            "key relaxing: found on = 'reading', coordinate = 'table_outer', lag_s = 3, need",
        ),
        (
            {},
            {
                "on": "tilt",
                "slot": "mount",
                "turn": "x",
                "coordinate": "temperature",
                "lag_s": 3.0,
                "relaxing": True,
            },
            "key relaxing: .*coordinate = 'temperature'.*over a motion or a force",
        ),
        (
            {"axis": "outer"},
            {"on": "readout", "beside": "table_middle", "times": "time"},
            "key times: found 'time' and beside = 'table_middle', need one of them",
        ),
        (
            {"axis": "outer"},
            {"on": "readout", "coordinate": "table_outer", "times": "force_x"},
            "key times: found 'force_x', need one of",
        ),
        (
            {"axis": "outer"},
            {"on": "readout", "coordinate": "table_outer", "times": "rate_x"},
            "key times: found 'rate_x', need one of",
        ),
        (
            {"sensor": "accel", "axis": "x"},
            {"coordinate": "time", "instants": [3.0, 4.0], "fall_s": 2.0},
            "key instants: found 2 instants and 1 coefficients over 'time', rise_s = 0, fall_s = 2",
        ),
        (
            {"sensor": "accel", "axis": "x"},
            {"place": "moon"},
            "key place: found 'moon', need one of environment, table",
        ),
    ],
)
def test_what_is_no_learned_curve_is_refused_in_words(where, words, message):
    with pytest.raises(TiltcalError, match=message):
        make_effect("learned", GOOD | words, SETUP, **where)


@pytest.mark.parametrize(
    ("coordinate", "message"),
    [
        ("table_middle", "found coordinate 'table_middle', need an axis of this table"),
        ("turn_rate_middle", "key coordinate.*found 'turn_rate_middle'"),
    ],
)
def test_an_axis_that_this_table_has_not_is_refused(coordinate, message):
    with pytest.raises(TiltcalError, match=message):
        make_effect(
            "learned",
            GOOD | {"coordinate": coordinate},
            setup_of("dual", ACCEL),
            sensor="accel",
            axis="x",
        )


def test_without_coefficients_it_is_nothing():
    assert learned("accel", "x", coordinate="table_outer").is_identity
    assert not added(learned("accel", "x", coordinate="table_outer")).any()
    assert effect_of("acc_bias", SETUP, sensor="accel", bias_x_ug=1).value(
        "bias_x"
    ) == pytest.approx(1e-6 * G0)


def test_a_learned_reading_may_follow_the_number_of_moves_with_a_period():
    """Two columns of period 3 over moves 0, 1, 2, ...: cos and sin of a third of a turn a move."""
    stop = np.repeat([0, -1, 1, -1, 2, -1, 3, -1], N // 8)
    moves = np.repeat([0, 1, 1, 2, 2, 3, 3, 4], N // 8)
    effect = learned("accel", "z", coordinate="moves", period=3.0, coefficients=[1e-3, 2e-3])
    drive = replace(lively(), stop=stop)
    change = read_poses(SETUP, drive, effect)["accel"] - read_poses(SETUP, drive)["accel"]
    turn = 2 * np.pi * moves / 3
    np.testing.assert_allclose(change[:, 2], 1e-3 * np.cos(turn) + 2e-3 * np.sin(turn), atol=1e-14)


def test_a_learned_reading_may_be_a_product_of_two_angles():
    """The last of the first four coefficients is sin(outer) sin(middle); of the next four, orders 1
    and 2, the first is cos cos.
    """
    effect = learned(
        "accel",
        "y",
        coordinate="table_outer",
        beside="table_middle",
        coefficients=[0.0, 0.0, 0.0, 2e-3, 1e-3],
    )
    a, b = 0.3 * T, np.sin(T / 5)
    np.testing.assert_allclose(
        added(effect)[:, 1],
        2e-3 * np.sin(a) * np.sin(b) + 1e-3 * np.cos(a) * np.cos(2 * b),
        atol=1e-14,
    )


def test_a_coefficient_may_grow_with_the_temperature():
    """1e-4 (T - T0) f_x^2, and a readout error of 1e-3 (T - T0) cos(outer) with its rate."""
    effect = learned(
        "accel", "x", coordinate="input", power=2.0, times="temperature", coefficients=[1e-4]
    )
    plain = learned("accel", "x", coordinate="input", power=2.0, coefficients=[1e-4])
    drive = lively()
    warm = drive.temperature - drive.reference_temperature
    assert np.ptp(warm) > 1
    np.testing.assert_allclose(added(effect)[:, 0], added(plain)[:, 0] * warm, atol=1e-15)
    effect = learned(
        on="readout",
        axis="outer",
        coordinate="table_outer",
        times="temperature",
        coefficients=[1e-3],
    )
    jet, outer = effect.along(drive), drive.axes["outer"]
    np.testing.assert_allclose(jet.x, 1e-3 * warm * np.cos(outer.x), atol=1e-15)
    slope = np.gradient(jet.x, drive.time, edge_order=2)
    np.testing.assert_allclose(jet.v[2:-2], slope[2:-2], atol=0.02 * np.abs(jet.v).max())


def test_a_coefficient_may_grow_with_the_speed_of_turn_or_another_input():
    """1e-4 |rate| f_y, and 1e-4 w_z f_y on x."""
    drive = lively()
    rate = closed_form(SETUP, drive).rate
    speed = np.linalg.norm(rate, axis=1)
    assert np.ptp(speed) > 0
    for coordinate, times, factor in (
        ("force_y", "speed", speed),
        ("force_y", "rate_z", rate[:, 2]),
    ):
        law = {"coordinate": coordinate, "power": 1.0, "odd": True, "coefficients": [1e-4]}
        varying, plain = (
            added(learned("accel", "x", **law, **more))[:, 0] for more in ({"times": times}, {})
        )
        np.testing.assert_allclose(varying, plain * factor, atol=1e-12)


def test_a_curve_may_act_one_way_only():
    """2e-3 cos(middle) as the middle angle, sin(T / 5), rises, minus that as it falls; 0.5 deg
    after it turned back at 2.5 pi that is known.
    """
    law = {"coordinate": "table_middle", "coefficients": [2e-3], "times": "way_middle"}
    reading = added(learned("accel", "x", **law))[:, 0]
    error = learned(on="readout", axis="middle", **law).along(lively())
    angle, back = np.sin(T / 5), 5 * np.pi / 2
    np.testing.assert_allclose(np.asarray(error.x), reading, atol=1e-14)
    turned = np.arccos(np.cos(T / 5 - np.pi / 2)) > 0.3  # well after it
    rising, falling = turned & (T > 2) & (back > T), turned & (back < T) & (3 * back > T)
    assert rising.any()
    assert falling.any()
    np.testing.assert_allclose(reading[rising], 2e-3 * np.cos(angle[rising]), atol=1e-14)
    np.testing.assert_allclose(reading[falling], -2e-3 * np.cos(angle[falling]), atol=1e-14)
    with pytest.raises(TiltcalError, match="key times"):
        learned("accel", "x", **{**law, "times": "way_upper"})


def test_a_curve_may_grow_with_the_rate_of_an_angle():
    """2e-3 cos(middle) times the rate of the middle angle, cos(T / 5) / 5; as an error of a readout
    it changes with the acceleration too.
    """
    law = {"coordinate": "table_middle", "coefficients": [2e-3], "times": "turn_rate_middle"}
    reading = added(learned("accel", "x", **law))[:, 0]
    by_hand = 2e-3 * np.cos(np.sin(T / 5)) * np.cos(T / 5) / 5
    np.testing.assert_allclose(reading, by_hand, atol=1e-6)
    drive = lively()
    error = learned(on="readout", axis="middle", **law).along(drive)
    np.testing.assert_allclose(np.asarray(error.x), reading, atol=1e-14)
    told = np.gradient(reading, drive.time, edge_order=2)
    np.testing.assert_allclose(np.asarray(error.v)[2:-2], told[2:-2], atol=1e-6)


def test_a_readout_error_may_follow_two_angles_with_the_rates_of_both():
    """cos(outer) sin(middle), and its derivatives against differences of its values."""
    effect = learned(
        on="readout",
        axis="outer",
        coordinate="table_outer",
        beside="table_middle",
        coefficients=[0.0, 1e-3],
    )
    drive = lively()
    jet = effect.along(drive)
    outer, middle = drive.axes["outer"].x, drive.axes["middle"].x
    np.testing.assert_allclose(jet.x, 1e-3 * np.cos(outer) * np.sin(middle), atol=1e-15)
    inside, most = slice(2, -2), np.abs(jet.a).max()
    for value, slope in ((jet.x, jet.v), (jet.v, jet.a)):
        told = np.gradient(value, drive.time, edge_order=2)
        np.testing.assert_allclose(slope[inside], told[inside], atol=0.01 * most)


def test_transients_rise_evenly_to_their_coefficients_and_fall_exponentially():
    """2e-3 at 5 s and -1e-3 at 9 s: half a rise before half of it, a fall later a share of 1/e."""
    effect = learned(
        "accel",
        "x",
        coordinate="time",
        instants=[5.0, 9.0],
        rise_s=1.0,
        fall_s=0.5,
        coefficients=[2e-3, -1e-3],
    )
    table = to_file(effect)
    assert (table["instants"], table["rise_s"], table["fall_s"]) == ([5.0, 9.0], 1.0, 0.5)
    at = np.array([0.0, 3.9, 4.5, 5.0, 5.5, 8.5])
    alone = 2e-3 * np.array([0.0, 0.0, 0.5, 1.0, np.exp(-1), np.exp(-7)])
    alone[-1] -= 5e-4
    np.testing.assert_allclose(effect.curve(at), alone, atol=1e-15)
    smooth, step = at[[0, 1, 2, 4]], 1e-6  # not at a kink
    for order in (1, 2):
        above, below = (effect.curve(smooth + side * step, order - 1) for side in (1, -1))
        np.testing.assert_allclose(
            effect.curve(smooth, order), (above - below) / (2 * step), atol=1e-6
        )


def test_a_force_is_forgotten_with_its_lag():
    effect = learned(
        "accel",
        "x",
        coordinate="force_z",
        knots=[-10.0, 10.0],
        coefficients=[-1e-3, 1e-3],
        lag_s=5.0,
    )
    force = read_poses(SETUP, lively())["accel"][:, 2]
    np.testing.assert_allclose(
        added(effect)[:, 0], 1e-4 * first_order_lag(T, force, 5.0), atol=1e-12
    )


@pytest.mark.parametrize("per_input", [False, True])
def test_power_warms_late(per_input):
    """2e-5 times the late square of f_z on x, and as a scale factor of x: of a force that turns to
    and fro the late square is not the square of the late force.
    """
    heat = learned(
        "accel",
        "x",
        coordinate="force_z",
        power=2.0,
        lag_s=5.0,
        per_input=per_input,
        coefficients=[2e-5],
    )
    force = read_poses(SETUP, lively())["accel"]
    warm = 2e-5 * first_order_lag(T, force[:, 2] ** 2, 5.0)
    assert np.abs(first_order_lag(T, force[:, 2], 5.0) ** 2 - warm / 2e-5).max() > 1
    by_hand = warm * force[:, 0] if per_input else warm
    np.testing.assert_allclose(added(heat)[:, 0], by_hand, atol=1e-12)


def test_a_scale_factor_may_follow_a_play():
    """Even over the state of a play of 4 m/s2: 1e-3 where it is at either end, nothing between."""
    loop = learned(
        "accel",
        "y",
        coordinate="force_z",
        play=4.0,
        per_input=True,
        knots=[-1.0, 0.0, 1.0],
        coefficients=[1e-3, 0.0, 1e-3],
    )
    force = read_poses(SETUP, lively())["accel"]
    ended = np.abs(play(force[:, 2], 4.0)) == 1
    assert 0.2 < ended.mean() < 0.95
    change = added(loop)[:, 1] / force[:, 1]
    np.testing.assert_allclose(change[ended], 1e-3, atol=1e-12)
    assert change[~ended].min() < 5e-4


def test_braking_is_the_fall_of_the_speed():
    line = {"knots": [-1e3, 1e3], "coefficients": [-1e3, 1e3]}  # the curve u itself
    speed, braking = (
        added(learned("accel", "x", coordinate=c, **line))[:, 0] for c in ("speed", "braking")
    )
    rate = read_poses(SETUP, lively())["gyro"]
    np.testing.assert_allclose(speed, np.linalg.norm(rate, axis=1), atol=1e-4)  # Earth's rate
    np.testing.assert_allclose(braking[2:-2], -np.gradient(speed, T)[2:-2], atol=2e-3)
    assert np.ptp(braking) > 0.02


def test_a_play_tells_which_way_the_angle_last_went():
    """The middle angle, sin(T / 5), turns back at T = 2.5 pi and 7.5 pi: 0.2 rad later the other
    side is pushed.
    """
    one = {"power": 1.0, "odd": True, "coefficients": [1.0]}
    reading = learned("accel", "x", coordinate="table_middle", play=0.2, **one)
    tilt = learned(
        on="tilt", slot="base", turn="x", coordinate="table_middle", play=0.2, **one
    ).along(lively())
    angle, back = np.sin(T / 5), 5 * np.pi / 2
    state = added(reading)[:, 0]
    np.testing.assert_allclose(np.asarray(tilt.x), state, atol=1e-12)
    rising = (T > 2) & (back > T)
    falling = (back < T) & (angle < 0.79) & (3 * back > T)
    assert np.allclose(state[rising], 1.0)
    assert np.allclose(state[falling], -1.0)
    turning = (back < T) & (angle > 0.81) & (2 * back > T)
    np.testing.assert_allclose(state[turning], 1 - (1 - angle[turning]) / 0.1, atol=2e-3)


def test_a_mount_follows_the_weight_that_turns_in_the_body():
    """At every pose of the nominal table; a mounting turns it too."""
    drive = replace(lively(), mounts=((0, np.eye(3)), (30, rotation("x", 0.4))))
    nominal = Context.along(drive, drive.axes, SETUP.rig, SETUP.site.gravity)
    up = closed_form(SETUP, drive).up
    np.testing.assert_allclose(nominal.gravity_in_body(), SETUP.site.gravity * up, atol=1e-12)


def test_a_relaxing_tilt_ends_where_it_began():
    """A quarter of a turn in one second, then rest: minus what is still to come, exp(-t / lag)."""
    time = np.arange(0, 60, 0.05)
    outer = np.clip(time - 5, 0, 1) * np.pi / 2
    drive = drive_of({"outer": Jet(outer)}, time)
    effect = learned(
        on="tilt",
        slot="mount",
        turn="x",
        coordinate="table_outer",
        power=1.0,
        odd=True,
        lag_s=8.0,
        relaxing=True,
        coefficients=[1.0],
    )
    tilt = effect.along(drive).x
    rest = time > 6
    left = 8.0 * (np.pi / 2) * (np.exp(1 / 8) - 1) * np.exp(-(time - 5) / 8)
    np.testing.assert_allclose(tilt[rest], -left[rest], rtol=1e-6)
    assert not tilt[time <= 5].any()


def test_a_late_angle_is_a_structure_that_creeps():
    creep = learned(
        on="tilt", slot="base", turn="x", coordinate="table_outer", lag_s=5.0, coefficients=[1e-3]
    ).along(lively())
    by_hand = 1e-3 * first_order_lag(T, np.cos(0.3 * T), 5.0)
    np.testing.assert_allclose(creep.x, by_hand, atol=1e-15)
    np.testing.assert_allclose(np.asarray(creep.v)[3:-3], np.gradient(by_hand, T)[3:-3], atol=2e-6)


def test_a_reading_may_feel_an_angle_late():
    """The sum of the curve, not the angle, is late: after a turn the angle goes on."""
    warm = learned("accel", "x", coordinate="table_outer", lag_s=5.0, coefficients=[1e-3, 2e-3])
    by_hand = first_order_lag(T, 1e-3 * np.cos(0.3 * T) + 2e-3 * np.sin(0.3 * T), 5.0)
    np.testing.assert_allclose(added(warm)[:, 0], by_hand, atol=1e-14)


def test_a_scale_factor_may_follow_the_speed_late():
    sag = learned(
        "accel",
        "z",
        coordinate="speed",
        lag_s=5.0,
        per_input=True,
        power=1.0,
        odd=True,
        coefficients=[-1e-3],
    )
    seen = read_poses(SETUP, lively())
    speed = added(learned("accel", "x", coordinate="speed", power=1.0, odd=True, coefficients=[1]))
    late = first_order_lag(T, speed[:, 0], 5.0)
    np.testing.assert_allclose(added(sag)[:, 2], -1e-3 * late * seen["accel"][:, 2], atol=1e-12)


@pytest.mark.parametrize("sensor", ["accel", None], ids=["of one", "of all"])
def test_stamps_may_be_late_by_a_curve(sensor):
    """0 to 4 ms over a minute: a reading is that of the motion so much earlier."""
    table = {"on": "stamps", "coordinate": "time", "knots": [0.0, 60.0], "place": "timing"}
    values = {**table, "coefficients": [0.0, 4e-3]}
    late = make_effect("learned", values, SETUP, sensor=sensor)
    assert to_file(late)["on"] == "stamps"
    assert late.delay(np.array([15.0, 90.0]), 0, None) == pytest.approx([1e-3, 4e-3])
    time = np.arange(0.0, 60.0, 0.1)
    watch = NominalMotion(SETUP, Turning(), time)
    told, answers = watch.changes(late), watch.answers(late)
    curve = np.asarray(watch.curve(late).x) @ late.coefficients
    at = time, time - late.delay(time, 0, None)
    read, earlier = (read_poses(SETUP, Turning().drive(t)) for t in at)
    assert set(told) == set(answers) == ({"accel"} if sensor else set(read))
    for name, change in told.items():
        size = np.abs(change).max()
        np.testing.assert_allclose(change, earlier[name] - read[name], atol=5e-3 * size)
        np.testing.assert_allclose(answers[name][0] * curve[:, None], change, atol=1e-12 * size)


class Turning:
    """The outer axis turns evenly, the middle one to and fro, the inner one rests."""

    def drive(self, time):
        outer = Jet(0.3 * time, 0.3 + 0 * time, 0 * time)
        middle = Jet(np.sin(time / 5), np.cos(time / 5) / 5, -np.sin(time / 5) / 25)
        return drive_of({"outer": outer, "middle": middle, "inner": Jet(0 * time)}, time)


@pytest.mark.parametrize("words", [{"coordinate": "temperature"}, {"axis": "x"}])
def test_stamps_are_late_with_time_and_all_channels_together(words):
    table = {
        "on": "stamps",
        "coordinate": "time",
        "knots": [0.0, 60.0],
        "coefficients": [0.0, 1e-3],
    }
    axis = words.pop("axis", None)
    with pytest.raises(TiltcalError, match="coordinate 'time' and no axis"):
        make_effect("learned", {**table, **words}, SETUP, sensor="accel", axis=axis)


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ({"coordinate": "time"}, "need two angles of this table"),
        ({"beside": "table_upper"}, "key beside: found 'table_upper'"),
    ],
)
def test_a_product_needs_two_angles(words, message):
    table = {"coordinate": "table_outer", "beside": "table_middle", "coefficients": [1e-3], **words}
    with pytest.raises(TiltcalError, match=message):
        make_effect("learned", table, SETUP, sensor="accel", axis="x")


@pytest.mark.parametrize(
    "name", [*COORDINATES, "table_outer", f"{TURN_RATE}outer", f"{LAST_DIRECTION}outer"]
)
def test_every_coordinate_has_words_and_is_read_back_from_its_title(name):
    """It is written with its unit, ``angular_acceleration_x_deg_s2``, and read back from that."""
    one, (title, unit) = coordinate_named(name), title_of(shown_name(name))
    assert "{" not in one.words + one.factor
    assert "_" not in title
    assert unit == ("" if name == one.unit else one.unit)
    assert "_" not in unit_sign(unit)
