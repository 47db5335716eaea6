"""Labelling faults of recordings turned by hand."""

import numpy as np

from tiltcal.core.arrays import Array
from tiltcal.diagnosis.data_faults.fault import Fault
from tiltcal.diagnosis.data_faults.labelling import (
    FAR,
    LEAST,
    fault_of_factor,
    faults_of_permutation,
    signed_permutations,
)
from tiltcal.laboratory.scenario import Scenario
from tiltcal.recordings.recording import Recording


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
