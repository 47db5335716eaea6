"""A wrong written angle of one stop."""

from dataclasses import replace

import numpy as np

from tiltcal.core.arrays import Array, Mask
from tiltcal.diagnosis.data.channels import without_readout
from tiltcal.diagnosis.data.observations import Observations
from tiltcal.diagnosis.data_faults.fault import Fault
from tiltcal.diagnosis.model.fitted_model import FittedModel
from tiltcal.effects.data.labelling_faults import DataPoseLabel
from tiltcal.recordings.recording import Recording
from tiltcal.statistics.dwell_noise import robust_white

APART = 25.0  # times the misfit of others: five times as far off
MARGIN = 4  # rows beside a stop that its wrong readout spoils


def find_wrong_stop(
    observations: Observations, fitted: FittedModel
) -> tuple[Fault, tuple[Recording, ...]] | None:
    """One stop with a wrong written angle: its misfit is large where the others fit, and another
    angle removes it.
    """
    worst = stop_misfits(observations, fitted) if observations.courses else {}
    if not worst:
        return None
    (number, stop), largest = max(worst.items(), key=lambda item: item[1])
    others = sorted(v for k, v in worst.items() if k != (number, stop))
    if largest < 400 or not others or largest < APART * max(float(np.median(others)), 1.0):
        return None
    return _rewritten(observations, fitted, number, stop)


def stop_misfits(observations: Observations, fitted: FittedModel) -> dict[tuple[int, int], float]:
    """Misfit of each stop of each recording, in squares of the noise."""
    worst: dict[tuple[int, int], float] = {}
    for channel, r in zip(
        observations.channels, observations.residuals(fitted.effects), strict=True
    ):
        noise = robust_white(r)
        for stop in range(int(channel.stop.max(initial=-1)) + 1):
            there = channel.stop == stop
            if there.sum() >= 4:
                z = float(np.median(r[there]) ** 2 * there.sum()) / noise**2
                worst[channel.recording, stop] = worst.get((channel.recording, stop), 0.0) + z
    return worst


def stands_alone(observations: Observations, mended: Observations, fitted: FittedModel) -> bool:
    """Whether the misfit of a stop is far from all others, once the stop no longer spoils the
    fit.
    """
    rest = stop_misfits(mended, fitted)
    return max(stop_misfits(observations, fitted).values()) > APART * max(
        rest.values(), default=1.0
    )


def _rewritten(
    observations: Observations, fitted: FittedModel, number: int, stop: int
) -> tuple[Fault, tuple[Recording, ...]] | None:
    """The axis and error that remove the misfit of a stop; None when none does."""
    course = observations.courses[number]
    rows = course.stop == stop
    best: tuple[float, float, str] | None = None
    before = _misfit(observations, fitted, number, stop, course.angles)
    for axis in observations.scenario.rig.kind.turning:
        errors: Array = np.linspace(-np.pi, np.pi, 361)[1:]
        for width in (0.0, 2e-2, 2e-3, 2e-4, 2e-5):
            if width and best is not None and best[2] == axis:
                errors = best[1] + np.linspace(-width, width, 21)
            elif width:
                break
            for error in errors:
                angles = {**course.angles, axis: course.angles[axis] - error * rows}
                value = _misfit(observations, fitted, number, stop, angles)
                if best is None or value < best[0]:
                    best = (value, float(error), axis)
    if best is None or best[0] > 0.02 * before:
        return None
    _, error, axis = best
    repaired = list(observations.recordings)
    fault, repaired[number] = mistyped(
        observations, number, repaired[number], rows, axis, error, 2e-5
    )
    return fault, tuple(repaired)


def mistyped(
    observations: Observations,
    number: int,
    recording: Recording,
    rows: Mask,
    axis: str,
    error: float,
    sigma: float,
) -> tuple[Fault, Recording]:
    """The fault of a wrong angle (rad) written on some rows, (n,) mask, of one stop, and the
    recording without its readout.
    """
    # it need not have been found itself
    stop = observations.courses[number].stop[: np.argmax(rows)].max(initial=-1) + 1
    time = recording.time[rows] - recording.time[0]
    effect = DataPoseLabel(
        {"error": error, "stop": float(stop)}, None, axis, "found", seen_in=recording.fingerprint
    )
    names = tuple(dict.fromkeys(c.sensor for c in observations.channels))
    axes = tuple(dict.fromkeys(c.axis for c in observations.channels))
    interval = (float(time[0]), float(time[-1]))
    words = (
        f"The {axis} angle written from {interval[0]:.1f} s to {interval[1]:.1f} s is"
        f" {np.degrees(error):.5g} deg off."
    )
    spoiled = np.convolve(rows, np.ones(2 * MARGIN + 1), "same") > 0
    return Fault(effect, names, axes, words, interval, sigma={"error": sigma}), without_readout(
        recording, np.flatnonzero(spoiled)
    )


def _misfit(
    observations: Observations,
    fitted: FittedModel,
    number: int,
    stop: int,
    angles: dict[str, Array],
) -> float:
    """Misfit of one stop, in squares of the noise, when its angles are these."""
    from tiltcal.forward.signal_chain import readings

    course = observations.courses[number]
    middle = np.flatnonzero(course.stop == stop)
    row = middle[len(middle) // 2 : len(middle) // 2 + 1]
    one = replace(
        course,
        time=course.time[row],
        angles={k: v[row] for k, v in angles.items()},
        known=course.known[row],
        temperature=course.temperature[row],
        stop=course.stop[row],
    )
    total = 0.0
    names = sorted({c.sensor for c in observations.channels})
    predicted = readings(observations.scenario, one, dict.fromkeys(names, one.time), fitted.effects)
    for c in observations.channels:
        there = c.stop == stop
        if c.recording == number and there.any():
            total += float((np.median(c.values[there]) - predicted[c.sensor][0, c.column]) ** 2)
    return total
