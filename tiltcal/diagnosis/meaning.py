"""Columns that do not mean what they say: units, signs, exchanged axes, a table counted the other way.

Every reading of the columns (48 signed permutations of a triad, each axis of the table either way) is compared with the
model; one that fits far better than the words of the scenario is what the file holds.
"""

from collections.abc import Iterator, Sequence
from itertools import permutations, product

import numpy as np

from tiltcal.chain import readings
from tiltcal.diagnosis.faults import Fault
from tiltcal.effects import CATALOGUE
from tiltcal.effects.base import Effect
from tiltcal.effects.events import as_met
from tiltcal.errors import TiltcalError
from tiltcal.frames import Array
from tiltcal.laboratory import restored
from tiltcal.recording import Recording
from tiltcal.replay import replay
from tiltcal.scenario import Scenario
from tiltcal.setup import Sensor

FACTORS = (9.80665, 57.29577951308232, 1000.0, 1e6, 3600.0, 206264.806, 60.0)  # between the units that people mix up
LIKELY = 0.1  # relative: how near to such a factor
FAR = 9.0  # times the misfit, at least, that the words have to be worse by
LEAST = 1e-3  # of the square of the largest reading: below it the columns mean what they say
ROWS = 4000  # compared


def meaning(scenario: Scenario, recording: Recording) -> list[Fault]:
    """Faults of what the columns mean, on a table whose angles were read."""
    known = {e.id for e in scenario.effects}
    if known & {"data_unit", "data_sign", "data_axis_swap", "data_hand", "data_rotation_sense"}:
        return []
    if not scenario.rig.axes:
        return _by_hand(scenario, recording)
    try:
        course = restored(replay(recording, scenario, scenario.climate.reference_degC), scenario.effects)
    except TiltcalError:
        return []
    faults: list[Fault] = []
    best = _best_sense(scenario, recording, course)
    for axis in best:
        effect = CATALOGUE["data_rotation_sense"]({"reversed": 1.0}, None, axis, "found")
        names = tuple(s.name for s in scenario.sensor)
        words = f"The {axis} axis of the table is counted the other way."
        faults.append(Fault(effect, names[:1], tuple(scenario.sensor[0].axes), words, names=_sense_names(scenario)))
    known_effects = [*scenario.effects, *(f.effect for f in faults)]
    for sensor in scenario.sensor:
        if recording.has(sensor):
            faults += _of_sensor(scenario, recording, course, sensor, known_effects)
    return faults


def _by_hand(scenario: Scenario, recording: Recording) -> list[Fault]:
    """A FOG against a gyro triad turned together: one factor between them, which should be one."""
    faults: list[Fault] = []
    gyros = [s for s in scenario.sensors("gyro") if recording.has(s) and len(s.axes) == 3]
    for fog in scenario.sensors("fog") if gyros else ():
        if not recording.has(fog):
            continue
        samples, triad = recording.sensor(fog), recording.sensor(gyros[0])
        whole = ~np.isnan(triad.values).any(axis=1)
        there = ~np.isnan(samples.values[:, 0])
        if whole.sum() < 16 or there.sum() < 16:
            continue
        rate = np.column_stack([np.interp(samples.time[there], triad.time[whole], v[whole]) for v in triad.values.T])
        f, y = rate @ fog.input_vector, samples.values[there, 0]
        f, y = f - f.mean(), y - y.mean()
        k = float(f @ y / max(f @ f, 1e-300))
        if float(np.sum((y - k * f) ** 2)) * FAR > float(y @ y):
            continue  # they do not turn together
        faults += _of_factor(k, fog, gyros[0], float(np.abs(y).max()), float(np.abs(f).max()))
    return faults


def _of_factor(k: float, fog: Sensor, gyro: Sensor, fastest: float, gyros: float) -> list[Fault]:
    """Unit and sign behind a FOG's readings that are k times what the gyros say; largest rates rad/s."""
    faults = []
    factor = next((s for c in FACTORS for s in (c, 1 / c) if abs(np.log(abs(k) / s)) < LIKELY), None)
    if factor is not None and (abs(k) > 2 or abs(k) < 0.5):
        wrong = fog if abs(np.log(fastest)) > abs(np.log(gyros)) else gyro  # a hand turns by about a radian a second
        own = factor if wrong is fog else 1 / factor
        effect = CATALOGUE["data_unit"]({"factor": own}, wrong.name, None, "found")
        words = f"{wrong.name} reads {own:.6g} times what its unit says."
        faults.append(Fault(effect, (wrong.name,), wrong.axes, words, sigma={"factor": 1e-3 * own}))
    if k < 0:
        effect = CATALOGUE["data_sign"]({"flip_a": 1.0}, fog.name, None, "found")
        faults.append(Fault(effect, (fog.name,), fog.axes, f"{fog.name} has the opposite sign."))
    return faults


def _sense_names(scenario: Scenario) -> tuple[str, ...]:
    if scenario.rig.table == "placing":
        return ("data_rotation_sense", "data_sign")  # turning back and x upside down are the same on one axis
    return ("data_rotation_sense",)


def _best_sense(scenario: Scenario, recording: Recording, course: "object") -> tuple[str, ...]:
    """Axes that count the other way, all sensors considered; none unless it is far better."""
    misfit: dict[tuple[str, ...], float] = {}
    for flipped in product(*[((), (axis,)) for axis in scenario.rig.axis_names]):
        axes = tuple(a for part in flipped for a in part)
        effects = [*scenario.effects, *(CATALOGUE["data_rotation_sense"]({"reversed": 1.0}, None, a, "found") for a in axes)]
        misfit[axes] = sum(_misfit(y, f, np.eye(f.shape[1])) for y, f in _pairs(scenario, recording, course, effects))
    best = min(misfit, key=lambda a: (misfit[a], len(a)))
    return best if best and misfit[()] > FAR * misfit[best] and misfit[()] > LEAST else ()


def _pairs(scenario: Scenario, recording: Recording, course: "object", effects: Sequence[Effect]) -> Iterator[tuple[Array, Array]]:
    """Measured and predicted readings of each sensor, thinned, both over the largest prediction."""
    for sensor in scenario.sensor:
        if recording.has(sensor):
            y, f = _pair(scenario, recording, course, sensor, effects)
            size = max(float(np.abs(f).max(initial=0.0)), 1e-12)
            yield y / size, f / size


def _pair(
    scenario: Scenario, recording: Recording, course: "object", sensor: Sensor, effects: Sequence[Effect]
) -> tuple[Array, Array]:  # fmt: skip
    samples = recording.sensor(sensor)
    turned = restored(course, [e for e in effects if e not in scenario.effects])  # type: ignore[arg-type]
    there = np.flatnonzero(~np.isnan(samples.values).any(axis=1) & turned.known[samples.rows])
    some = there[:: max(1, len(there) // ROWS)]
    met = as_met(effects, recording.fingerprint)
    predicted = readings(scenario, turned, {sensor.name: recording.time[samples.rows[some]]}, met)[sensor.name]
    return samples.values[some], predicted


def _misfit(y: Array, f: Array, P: Array) -> float:
    """Mean square of what is left of ``y`` after ``P f`` and a constant."""
    left = y - f @ P.T
    return float(np.mean((left - left.mean(axis=0)) ** 2))


def _of_sensor(
    scenario: Scenario, recording: Recording, course: "object", sensor: Sensor, effects: Sequence[Effect]
) -> list[Fault]:  # fmt: skip
    y, f = _pair(scenario, recording, course, sensor, effects)
    if len(y) < 16 or float(np.abs(f).max()) == 0:
        return []
    faults = []
    k = float(np.sqrt(np.sum(y * y) / max(np.sum(f * f), 1e-300)))
    factor = next((s for c in FACTORS for s in (c, 1 / c) if abs(np.log(k / s)) < LIKELY), None)
    if factor is not None and (k > 2 or k < 0.5):
        effect = CATALOGUE["data_unit"]({"factor": factor}, sensor.name, None, "found")
        words = f"{sensor.name} reads {factor:.6g} times what its unit says."
        faults.append(Fault(effect, (sensor.name,), sensor.axes, words, sigma={"factor": 1e-3 * factor}))
        y = y / factor
    return faults + _permuted(y, f, sensor)


def _permuted(y: Array, f: Array, sensor: Sensor) -> list[Fault]:
    """A signed permutation of the channels that fits far better than none."""
    n = f.shape[1]
    size = float(np.abs(f).max())
    y, f = y / size, f / size
    level = _misfit(y, f, np.eye(n))
    trials = []
    for order, signs in product(permutations(range(n)), product((1.0, -1.0), repeat=n)):
        P = np.zeros((n, n))
        P[range(n), order] = signs
        trials.append((_misfit(y, f, P), -np.trace(P), P))
    best, _, P = min(trials, key=lambda t: (t[0] * (1 + 1e-6), t[1]))
    if np.array_equal(P, np.eye(n)) or level < FAR * best or level < LEAST:
        return []
    moved = [i for i in range(n) if P[i, i] == 0]
    flipped = [i for i in range(n) if P[i].sum() < 0]
    faults = []
    if len(moved) == 2:
        pair = "".join(sensor.axes[i] for i in moved)
        name = f"swap_{'zx' if pair == 'xz' else pair}"
        effect = CATALOGUE["data_axis_swap"]({name: 1.0}, sensor.name, None, "found")
        faults.append(
            Fault(effect, (sensor.name,), tuple(pair), f"The columns {' and '.join(pair)} of {sensor.name} are exchanged.")
        )
    if len(moved) == 3:
        first, second = ("swap_xy", "swap_yz") if P[0, 1] or P[0].argmax() == 1 else ("swap_xy", "swap_zx")
        effect = CATALOGUE["data_axis_swap"]({first: 1.0, second: 1.0}, sensor.name, None, "found")
        faults.append(Fault(effect, (sensor.name,), sensor.axes, f"The columns of {sensor.name} are exchanged in a ring."))
    if flipped:
        axes = tuple(sensor.axes[i] for i in flipped)
        effect = CATALOGUE["data_sign"]({f"flip_{a}": 1.0 for a in axes}, sensor.name, None, "found")
        names = ("data_sign", "data_hand") if axes == ("y",) and n == 3 else ("data_sign",)
        faults.append(Fault(effect, (sensor.name,), axes, f"{sensor.name} {', '.join(axes)} has the opposite sign.", names=names))
    return faults
