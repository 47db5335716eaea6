"""Columns that are labelled wrongly: units, signs, exchanged axes, a table counted in the opposite
sense.

Each interpretation of the columns (48 signed permutations of a triad, each axis of the table in
both senses) is compared with the model; one that fits far better than the scenario's is what the
file holds. To gravity an axis that counts in the opposite sense is often a sign of a column: only
motion separates them.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import permutations, product

import numpy as np

from tiltcal.core.arrays import Array
from tiltcal.core.errors import TiltcalError
from tiltcal.design.identifiability import SEPARABLE
from tiltcal.diagnosis.data.channels import meant_matrix
from tiltcal.diagnosis.data_faults.fault import Fault
from tiltcal.effects.base import Effect
from tiltcal.effects.data.labelling_faults import (
    ColumnFault,
    DataAxisSwap,
    DataHand,
    DataRotationSense,
    DataSign,
    DataUnit,
)
from tiltcal.effects.events import active_in
from tiltcal.forward.signal_chain import readings
from tiltcal.laboratory.laboratory import restored
from tiltcal.laboratory.scenario import Scenario
from tiltcal.recordings.recording import Recording
from tiltcal.recordings.replay import Replay, replay
from tiltcal.setup.sensor import Sensor


def labelling_faults_by_hand(scenario: Scenario, recording: Recording) -> list[Fault]:
    """A FOG against a gyro triad turned together: one factor between them, which should be one, and
    the triad's columns.
    """
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
        rate = np.column_stack(
            [np.interp(samples.time[there], triad.time[whole], v[whole]) for v in triad.values.T]
        )
        rate, y = (
            rate - rate.mean(axis=0),
            samples.values[there, 0] - samples.values[there, 0].mean(),
        )
        left, k, P = _fitted_to_fog(rate, y, fog.input_vector)
        if left * FAR > float(y @ y):
            continue  # they do not turn together
        faults += fault_of_factor(
            k, fog, gyros[0], float(np.abs(y).max()), float(np.abs(rate @ fog.input_vector).max())
        )
        faults += faults_of_permutation(P, gyros[0])
    return faults


def _fitted_to_fog(rate: Array, y: Array, input_vector: Array) -> tuple[float, float, Array]:
    """The factor k and the signed permutation P for which ``y = k rate P input_vector`` fits best,
    and what that leaves.

    The columns as they are written, unless they fit far worse.

    Args:
        rate: of the triad, rad/s, (n, 3).
        y: of the FOG, (n,); both without their means.
        input_vector: of the FOG, (3,).
    """
    trials = []
    for P in signed_permutations(3):
        f = rate @ P @ input_vector
        k = float(f @ y) / max(float(f @ f), 1e-300)
        changed = 2.0 * (k < 0) - float(np.trace(P))  # the FOG turned round counts as one column
        trials.append((float(np.sum((y - k * f) ** 2)), changed, k, P))
    written = next(t for t in trials if np.array_equal(t[3], np.eye(3)))
    best = min(trials, key=lambda t: (t[0], t[1]))
    left, _, k, P = written if written[0] < max(FAR * best[0], LEAST * float(y @ y)) else best
    return left, k, P


def signed_permutations(n: int) -> Iterator[Array]:
    """Matrices that exchange channels and change their signs, (n, n)."""
    for order, signs in product(permutations(range(n)), product((1.0, -1.0), repeat=n)):
        P = np.zeros((n, n))
        P[range(n), order] = signs
        yield P


def fault_of_factor(
    k: float, fog: Sensor, gyro: Sensor, fastest: float, gyros: float
) -> list[Fault]:
    """Unit and sign of a FOG whose readings are k times those of the gyros; largest rates rad/s."""
    faults = []
    factor = next(
        (s for c in FACTORS for s in (c, 1 / c) if abs(np.log(abs(k) / s)) < LIKELY), None
    )
    if factor is not None and (abs(k) > 2 or abs(k) < 0.5):
        # a hand turns by about a radian a second
        wrong = fog if abs(np.log(fastest)) > abs(np.log(gyros)) else gyro
        own = factor if wrong is fog else 1 / factor
        effect = DataUnit({"factor": own}, wrong.name, None, "found")
        words = f"{wrong.name} reads {own:.6g} times what its unit says."
        faults.append(Fault(effect, (wrong.name,), wrong.axes, words, sigma={"factor": 1e-3 * own}))
    if k < 0:
        sign = DataSign({"flip_a": 1.0}, fog.name, None, "found")
        faults.append(Fault(sign, (fog.name,), fog.axes, f"{fog.name} has the opposite sign."))
    return faults


def affine_fit(y: Array, f: Array) -> Array:
    """Mean square residual of each column after an affine map of the predictions, (k,)."""
    X = np.column_stack([np.ones(len(f)), f])
    return (
        np.asarray(((y - X @ np.linalg.lstsq(X, y, rcond=None)[0]) ** 2).mean(axis=0))
        if len(y)
        else np.ones(y.shape[1])
    )


def faults_of_sensor(y: Array, f: Array, sensor: Sensor) -> list[Fault]:
    """Unit, exchanged columns and signs of one sensor, by what it read and should have read, (n, k)
    each.
    """
    if len(y) < 16 or float(np.abs(f).max()) == 0:
        return []
    faults = []
    k = float(np.sqrt(np.sum(y * y) / max(np.sum(f * f), 1e-300)))
    factor = next((s for c in FACTORS for s in (c, 1 / c) if abs(np.log(k / s)) < LIKELY), None)
    if factor is not None and (k > 2 or k < 0.5):
        effect = DataUnit({"factor": factor}, sensor.name, None, "found")
        words = f"{sensor.name} reads {factor:.6g} times what its unit says."
        faults.append(
            Fault(effect, (sensor.name,), sensor.axes, words, sigma={"factor": 1e-3 * factor})
        )
        y = y / factor
    return faults + _permuted(y, f, sensor)


def _permuted(y: Array, f: Array, sensor: Sensor) -> list[Fault]:
    """A signed permutation of the channels that fits far better than none."""
    n = f.shape[1]
    size = float(np.abs(f).max())
    y, f = y / size, f / size
    level = misfit_of(y, f, np.eye(n))
    trials = [(misfit_of(y, f, P), -float(np.trace(P)), P) for P in signed_permutations(n)]
    best, _, P = min(trials, key=lambda t: (t[0], t[1]))
    return [] if level < FAR * best or level < LEAST else faults_of_permutation(P, sensor)


def faults_of_permutation(P: Array, sensor: Sensor) -> list[Fault]:
    """Exchanged columns and signs of a sensor that reads P times what it should, (n, n)."""
    n = len(P)
    moved = [i for i in range(n) if P[i, i] == 0]
    flipped = [i for i in range(n) if P[i].sum() < 0]
    faults = []
    if len(moved) == 2:
        pair = "".join(sensor.axes[i] for i in moved)
        swap = f"swap_{'zx' if pair == 'xz' else pair}"
        words = f"The columns {' and '.join(pair)} of {sensor.name} are exchanged."
        faults.append(_exchanged(sensor, (swap,), tuple(pair), words))
    if len(moved) == 3:
        second = "swap_yz" if P[0, 1] or P[0].argmax() == 1 else "swap_zx"
        words = f"The columns of {sensor.name} are exchanged cyclically."
        faults.append(_exchanged(sensor, ("swap_xy", second), sensor.axes, words))
    if flipped:
        axes = tuple(sensor.axes[i] for i in flipped)
        sign = DataSign({f"flip_{a}": 1.0 for a in axes}, sensor.name, None, "found")
        names = (DataSign.id, DataHand.id) if axes == ("y",) and n == 3 else (DataSign.id,)
        words = f"{sensor.name} {', '.join(axes)} has the opposite sign."
        faults.append(Fault(sign, (sensor.name,), axes, words, names=names))
    return faults


def _exchanged(sensor: Sensor, swaps: Sequence[str], axes: Sequence[str], words: str) -> Fault:
    effect = DataAxisSwap(dict.fromkeys(swaps, 1.0), sensor.name, None, "found")
    return Fault(effect, (sensor.name,), tuple(axes), words)


# between the units that people mix up
FACTORS = (
    9.80665,
    57.29577951308232,
    1000.0,
    1e6,
    3600.0,
    206264.806,
    60.0,
)


LIKELY = 0.1  # relative: how near to such a factor


FAR = 9.0  # times the misfit, at least, that the words have to be worse by


LEAST = 1e-3  # of the square of the largest reading: below it the columns mean what they say


def misfit_of(y: Array, f: Array, P: Array) -> float:
    """Mean square of what is left of ``y`` after ``P f`` and a constant. y: (n, i); f: (n, k); P:
    (i, k).
    """
    left = y - f @ P.T
    return float(np.mean((left - left.mean(axis=0)) ** 2))


ROWS = 4000  # compared
EXACT = 1e-9  # of the largest reading: a recording without noise is no nearer than this


@dataclass(frozen=True)
class Version:
    """One interpretation of all columns.

    Args:
        faults: what the file does in it, first the axes that count the other way.
        signs: number of axes and columns that are turned round or exchanged in it.
        misfit: what it leaves of all sensors, over the square of the largest prediction.
        left: mean square that an affine map of each sensor's predictions leaves of its columns, SI,
            all columns.
        rows: that each column was compared in.
    """

    faults: tuple[Fault, ...]
    signs: int
    misfit: float
    left: Array
    rows: Array

    def others(self, version: "Version") -> list[Fault]:
        """Faults of the other that this one does not have."""
        mine = [f.effect for f in self.faults]
        return [f for f in version.faults if f.effect not in mine]


def find_labelling_faults(scenario: Scenario, recording: Recording) -> list[Fault]:
    """Labelling faults of a recording on a table whose angles were read."""
    if any(e.mislabels for e in scenario.effects):
        return []
    if not scenario.rig.axes:
        return labelling_faults_by_hand(scenario, recording)
    try:
        course = restored(
            replay(recording, scenario, scenario.climate.reference_degC), scenario.effects
        )
    except TiltcalError:
        return []
    words, *others = _subsets(scenario.rig.kind.turning)
    as_written = _version(scenario, recording, course, words)
    if not as_written.faults and as_written.misfit < LEAST:
        return []
    return _likeliest(
        [as_written, *(_version(scenario, recording, course, axes) for axes in others)]
    )


def require_labelled_alike(
    scenario: Scenario,
    recordings: Sequence[Recording],
    repaired: Sequence[Recording],
    faults: Sequence[Fault],
) -> None:
    """Refuse recordings whose columns are labelled otherwise than those of the first.

    Args:
        scenario: what is known of all of them.
        recordings: as they were read; repaired: by the labelling faults of the first.
        faults: those.

    Raises:
        TiltcalError: naming the first such recording, and what is wrong there.
    """
    known = [f.effect for f in faults]
    for recording, sound in zip(recordings[1:], repaired[1:], strict=True):
        own = find_labelling_faults(scenario, recording)
        if [f.effect for f in own] == known:
            continue
        # one that tells nothing by itself is as the first, unless that repair is wrong there; how
        # an axis counts is no column's fault, and not repaired
        again = find_labelling_faults(scenario, sound)
        if any(isinstance(f.effect, ColumnFault) or f.effect not in known for f in again):
            said = (
                " ".join(f.words for f in own) or "Its columns are labelled as the scenario says."
            )
            raise TiltcalError(
                recording.source,
                found=f"columns that are labelled otherwise than in {recordings[0].source}: {said}",
                need="recordings that are written alike",
                do="diagnose each by itself, or correct the columns of one",
            )


def _subsets(axes: Sequence[str]) -> list[tuple[str, ...]]:
    """Axes that may count in the opposite sense: none first."""
    return [
        tuple(a for part in parts for a in part)
        for parts in product(*[((), (axis,)) for axis in axes])
    ]


def _likeliest(versions: Sequence[Version]) -> list[Fault]:
    """The faults of the simplest of the interpretations that fit best, with the ids of others as
    simple that fit as well.
    """
    near = [v for v in versions if v.misfit <= FAR * min(v.misfit for v in versions)]
    words = versions[0]
    if not words.faults and words in near:
        return []
    least = np.min([v.left for v in near], axis=0)
    worse = [float(np.sum(v.rows * (v.left / least - 1))) for v in near]
    tied = [v for v, w in zip(near, worse, strict=True) if w < min(worse) + SEPARABLE]
    told = min(tied, key=lambda v: v.signs)
    faults = list(told.faults)
    for other in tied:
        theirs, mine = told.others(other), other.others(told)
        if len(theirs) == len(mine) == 1:  # one for one
            k = faults.index(next(f for f in faults if f.effect == mine[0].effect))
            names = (
                *(faults[k].names or (faults[k].effect.id,)),
                *(theirs[0].names or (theirs[0].effect.id,)),
            )
            faults[k] = replace(faults[k], names=tuple(dict.fromkeys(names)))
    return faults


def _version(
    scenario: Scenario, recording: Recording, course: Replay, reversed_: Sequence[str]
) -> Version:
    """The columns interpreted with these axes in the opposite sense."""
    faults: list[Fault] = []
    for axis in reversed_:
        effect = DataRotationSense({"reversed": 1.0}, None, axis, "found")
        words = f"The {axis} axis of the table is counted in the opposite sense."
        faults.append(
            Fault(effect, (scenario.sensor[0].name,), tuple(scenario.sensor[0].axes), words)
        )
    effects = [*scenario.effects, *(f.effect for f in faults)]
    misfit, left, rows = 0.0, [], []
    for sensor in scenario.sensor:
        if recording.has(sensor):
            y, f = _pair(scenario, recording, course, sensor, effects)
            own = faults_of_sensor(y, f, sensor)
            faults += own
            size = max(float(np.abs(f).max(initial=0.0)), 1e-12)
            misfit += (
                misfit_of(_relabelled(y, own, sensor) / size, f / size, np.eye(f.shape[1]))
                if len(y)
                else 0.0
            )
            left += [max(float(v), (EXACT * size) ** 2) for v in affine_fit(y, f)]
            rows += [len(y)] * y.shape[1]
    signs = sum(
        1 if isinstance(f.effect, DataRotationSense) else len(f.axes)
        for f in faults
        if not isinstance(f.effect, DataUnit)
    )
    return Version(tuple(faults), signs, misfit, np.array(left), np.array(rows))


def _relabelled(y: Array, faults: Sequence[Fault], sensor: Sensor) -> Array:
    """Columns with these labelling faults undone."""
    for fault in reversed(faults):
        y = y @ np.linalg.inv(meant_matrix(fault.effect, sensor)).T
    return y


def _pair(
    scenario: Scenario,
    recording: Recording,
    course: Replay,
    sensor: Sensor,
    effects: Sequence[Effect],
) -> tuple[Array, Array]:
    samples = recording.sensor(sensor)
    turned = restored(course, [e for e in effects if e not in scenario.effects])
    there = np.flatnonzero(~np.isnan(samples.values).any(axis=1) & turned.known[samples.rows])
    some = there[:: max(1, len(there) // ROWS)]
    met = active_in(effects, recording.fingerprint)
    predicted = readings(scenario, turned, {sensor.name: recording.time[samples.rows[some]]}, met)[
        sensor.name
    ]
    told = ~np.isnan(predicted).any(axis=1)  # a stated loss of samples leaves rows without one
    return samples.values[some[told]], predicted[told]
