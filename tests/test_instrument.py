"""The instrument on another simulation: the laboratory's readings, step by step, for the whole
catalogue; delays, noise, lost samples, episodes, refusals, and what wraps what.
"""

import numpy as np
import pytest
from catalogue_cases import lively, plausible, sensors_for

from tiltcal.core.errors import TiltcalError
from tiltcal.effects import CATALOGUE
from tiltcal.effects.base import SignalEffect
from tiltcal.effects.stepwise import Stepping
from tiltcal.forward.kinematics import closed_form
from tiltcal.forward.signal_chain import make_sense, readings, stream
from tiltcal.laboratory.instrument.instrument import Instrument
from tiltcal.laboratory.laboratory import SimulatedLaboratory
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


def stepped(scenario, *, seed=None, envs=1, lost="nan", step_s=1 / RATE):
    """The readings of an instrument that is fed the laboratory's motion, (steps, envs, k)."""
    start, end = scenario.schedule.times
    time = start + np.arange(int((end - start) / step_s + 1e-9) + 1) * step_s
    motion = closed_form(scenario, scenario.schedule.drive(time))
    instrument = Instrument(scenario, step_s, envs=envs, seed=seed, lost=lost)
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
ALIKE = [i for i in SIGNAL if i not in NEED_MORE and not CATALOGUE[i].id.endswith("_bandwidth")]


@pytest.mark.parametrize("id", ALIKE)
def test_each_effect_reads_what_the_laboratory_reads(id):
    """Row by row of a lively recording, the first environment against the laboratory's array."""
    setup, course, times = lively("three")
    time = times["accel"]
    drive = course.drive(time)
    motion = closed_form(setup, drive)
    for sensor in sensors_for(CATALOGUE[id], setup):
        effect = plausible(id, setup, sensor)
        stepping = Stepping(sensor, 1, [stream(7, id, sensor.name)])
        part = effect.stepwise(stepping)
        if id.endswith("_hysteresis"):
            effect = plausible(id, setup, sensor, size=1.0)
        if part is None:  # shapes with a memory that the whole recording sets
            assert effect.value("lag") or effect.value("rounded") or id.startswith("data_")
            continue
        part.restart(slice(None))
        sense = make_sense(sensor, setup, motion, drive)
        if id.endswith("_noise"):
            continue  # its numbers: see below
        whole = effect.apply(sense.true_input(), sense, stream(7, id, sensor.name))
        again = [
            part(one.true_input(), one, slice(None))[0]
            for one in (row_of(sense, k) for k in range(len(time)))
        ]
        np.testing.assert_allclose(np.array(again), whole, rtol=0, atol=1e-14, equal_nan=True)


def row_of(sense, k):
    """The sense of one row."""
    from dataclasses import replace

    rows = ("time", "elapsed", "force", "rate", "up", "north", "angular_acceleration")
    parts = {name: getattr(sense, name)[k : k + 1] for name in (*rows, "temperature")}
    return replace(sense, **parts)
