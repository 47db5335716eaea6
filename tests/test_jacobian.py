"""The columns of the information matrix are the derivative of what the chain reads."""

import numpy as np
import pytest
from builders import FOG, GYRO, INCL, G, setup_of

from tiltcal.core.units import PARAMETER_UNITS
from tiltcal.effects import make_effect
from tiltcal.forward.jacobian import Rows, candidates, gram, rows_of, sensitivity, white_noise
from tiltcal.forward.signal_chain import readings
from tiltcal.setup.schedule import build_schedule
from tiltcal.setup.sensor import Sensor
from tiltcal.setup.sequence import Climate, Step

ACCEL = Sensor(name="accel", kind="accelerometer", rate_hz=20, adjustable=("bias",))
STEPS = {
    "dual": [
        {"action": "move", "outer_deg": o, "inner_deg": i, "dwell_s": 2, "rate_deg_s": 40}
        for i in (0, 70)
        for o in (0, 50, -80, 130)
    ],
    "three": [
        {"action": "move", "middle_deg": 40, "inner_deg": 60, "dwell_s": 2, "rate_deg_s": 40},
        {"action": "turn", "axis": "outer", "angle_deg": 200, "rate_deg_s": 50, "dwell_s": 1},
        {"action": "move", "middle_deg": -50, "inner_deg": 200, "dwell_s": 2, "rate_deg_s": 40},
    ],
}
SHARE = 0.02  # of the plausible size: small enough for a derivative


def laboratory(table):
    setup = setup_of(table, ACCEL, INCL, GYRO, FOG, readout="command")
    course = build_schedule(
        [Step(**s) for s in STEPS[table]],
        setup.rig,
        Climate(ramp_degC_h=600, swing_degC=1, period_s=20),
    )
    time = np.arange(0.0, course.times[1], 0.05)
    return setup, course, Rows(time, np.ones(len(time)))


@pytest.mark.parametrize("table", list(STEPS))
def test_every_column_is_the_change_of_the_chain_s_readings(table):
    setup, course, rows = laboratory(table)
    times = {s.name: rows.time for s in setup.sensor}
    base = readings(setup, course, times, ())
    middle = (course.times[1] - course.times[0]) / 2
    shapes = {"time": middle, "start": middle, "frequency": 7.0}
    for column in sensitivity(setup, course, rows):
        _, _, _, _, p, size = next(
            c
            for c in candidates(setup, "mid_mems")
            if (c[0], c[1], c[2], c[3]) == (column.effect, column.sensor, column.axis, column.name)
        )
        words = {f"{column.name}{p.suffix}": size * SHARE}
        cls = type(make_effect(column.effect, {}, setup, sensor=column.sensor, axis=column.axis))
        words |= {
            f"{q.name}{q.suffix}": shapes[q.name]
            for q in cls.parameters
            if q.name in shapes and not q.default
        }
        effect = make_effect(column.effect, words, setup, sensor=column.sensor, axis=column.axis)
        now = readings(setup, course, times, [effect])
        for sensor in setup.sensor:
            near_level = (
                np.abs(base[sensor.name]) < 1.2
                if sensor.kind == "inclinometer"
                else np.ones_like(base[sensor.name], bool)
            )
            for k in range(len(sensor.axes)):
                expected = (
                    (now[sensor.name] - base[sensor.name])[:, k] / white_noise(sensor, ()) / SHARE
                )
                found = column.channels.get((sensor.name, k), np.zeros(len(expected), np.float32))
                keep = near_level[:, k]
                error = np.linalg.norm((found - expected)[keep])
                angle = (
                    size * p.factor if PARAMETER_UNITS[p.unit].quantity.startswith("angle") else 0.0
                )
                # gyros: 1 rad/s
                largest = {"accelerometer": G, "inclinometer": 1.0 / np.cos(1.2)}.get(
                    sensor.kind, 1.0
                )
                # order of a small turn squared
                second = angle**2 * largest * np.sqrt(len(expected)) / white_noise(sensor, ())
                allowed = 0.03 * np.linalg.norm(expected[keep]) + 4 * second + 1e-6
                assert error <= allowed, (column.label, sensor.name, k)


def test_compressed_dwells_give_the_matrix_of_all_samples():
    setup, course, whole = laboratory("dual")
    ids = ["acc_K2", "table_levelling", "table_sag", "acc_scale", "acc_Kip"]
    full = gram(sensitivity(setup, course, whole, only=ids))
    short_rows = rows_of(course, 20.0)
    short = gram(sensitivity(setup, course, short_rows, only=ids))
    assert len(short_rows.time) < 0.7 * len(whole.time)
    scale = np.sqrt(np.diag(full))
    assert np.abs(short - full).max() < 2e-3 * np.outer(scale, scale).max()
