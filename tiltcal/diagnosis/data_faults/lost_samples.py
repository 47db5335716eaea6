"""Samples that were lost while the stamps continued: from an instant on, every move comes early by
a whole number of samples.
"""

from collections.abc import Sequence
from functools import reduce

import numpy as np

from tiltcal.core.arrays import Array, Index
from tiltcal.diagnosis.data.channels import shifted
from tiltcal.diagnosis.data.observations import Channel, Observations
from tiltcal.diagnosis.data_faults.fault import Fault
from tiltcal.diagnosis.model.fitted_model import FittedModel
from tiltcal.effects.data.faults import DataDrop
from tiltcal.recordings.recording import Recording
from tiltcal.setup.sensor import Sensor
from tiltcal.statistics.dwell_noise import robust_white

MOST = 80  # samples
FAR = 8.0  # times the noise: a smaller misfit in moves is left to the scan of small effects
BESIDE = 1.0  # s of rest beside a move
SURE = 4.0  # sigma, of the instant
# moves that tell of a loss: lags without meaning agree to a sample in 3 of MOST, five times 1e-7
FEWEST = 6
# share of them, at least, in time before it and early by it afterwards: one in ten is spoiled
AGREEING = 0.9


def find_lost_samples(
    observations: Observations, fitted: FittedModel
) -> tuple[list[Fault], tuple[Recording, ...]]:
    """Losses of two samples and more, sensor by sensor, and the recordings with the later samples
    moved back to their time.
    """
    repaired = list(observations.recordings)
    faults: list[Fault] = []
    if not observations.courses:
        return faults, tuple(repaired)
    predicted = observations.predict(fitted.effects)
    for number, recording in enumerate(observations.recordings):
        mine = [
            (c, p)
            for c, p in zip(observations.channels, predicted, strict=True)
            if c.recording == number
        ]
        channels = {
            s.name: [(c, p) for c, p in mine if c.sensor == s.name]
            for s in observations.scenario.sensor
        }
        losses = {
            name: _loss(own) if own and _disturbed(own) else None for name, own in channels.items()
        }
        told = next((loss for loss in losses.values() if loss is not None), None)
        for sensor in observations.scenario.sensor:
            own, loss = channels[sensor.name], losses[sensor.name]
            if loss is None and told is not None and own and lost_as_another(own, *told):
                loss = told
            if loss is None:
                continue
            time, lost = loss
            repaired[number] = shifted(repaired[number], sensor, time, lost)
            faults.append(_lost(recording, sensor, time, lost))
    return faults, tuple(repaired)


def _lost(recording: Recording, sensor: Sensor, time: float, lost: int) -> Fault:
    """So many samples of a sensor that were lost at an instant, s."""
    start = time - float(recording.time[0])
    values = {"samples": float(lost), "time": start}
    effect = DataDrop(values, sensor.name, None, "found", seen_in=recording.fingerprint)
    words = (
        f"{lost} samples of {sensor.name} are lost at about {start:.1f} s: all later moves"
        " come early."
    )
    interval, sigma = (start, None), {"samples": 0.3}
    return Fault(effect, (sensor.name,), sensor.axes, words, interval, sigma=sigma)


def lost_as_another(own: Sequence[tuple[Channel, Array]], time: float, lost: int) -> bool:
    """Whether a sensor lost what another one lost: the loss explains most of its misfit from that
    instant on. own: channels with their residuals, SI, (n,); time: s.
    """
    before = after = 0.0
    for channel, p in own:
        rows = np.arange(int(np.searchsorted(channel.time, time)), len(p) - lost)
        before += float(np.nansum((channel.values[rows] - p[rows]) ** 2))
        after += float(np.nansum((channel.values[rows] - p[rows + lost]) ** 2))
    return after < before / 2


def _disturbed(own: Sequence[tuple[Channel, Array]]) -> bool:
    """Whether the model misses moves by much more than noise."""
    for channel, p in own:
        r = np.nan_to_num(channel.values - p)
        moving = channel.stop < 0
        if moving.sum() > 32 and np.sqrt(np.mean(r[moving] ** 2)) > FAR * robust_white(r):
            return True
    return False


def _loss(own: Sequence[tuple[Channel, Array]]) -> tuple[float, int] | None:
    """Instant, s, and number of samples of a loss; None when moves are not late from one of them
    on.
    """
    lags = [found for span in _moves(own[0][0]) if (found := _lag(own, *span)) is not None]
    found = loss_by_moves(np.array([lag for *_, lag in lags]))
    if found is None:
        return None
    last, first, lost = found
    return _instant(own, lags[last][0], lags[first][1], lost), lost


def loss_by_moves(early: Index) -> tuple[int, int, int] | None:
    """The last move in time, the first that comes early as a whole, and by how many samples; None
    when moves are not early from one of them on.

    One move between the two may come early by any part of that: what is lost amid a move leaves its
    beginning in time.

    Args:
        early: by how many samples each move comes early, (m,).
    """
    best: tuple[float, int, int, int] | None = None
    for first in range(2, len(early) - 1):
        lost = int(np.median(early[first:]))
        for last in (first - 1, first - 2):
            amid = early[last + 1 : first]
            told = np.abs(np.concatenate([early[: last + 1], early[first:] - lost])) <= 1
            if last < 1 or lost < 2 or len(told) < FEWEST or np.any((amid < 0) | (amid > lost)):
                continue
            agree = float(np.mean(told))
            if best is None or agree > best[0]:
                best = (agree, last, first, lost)
    alike = float(np.mean(np.abs(early - np.median(early)) <= 1)) if len(early) else 0.0
    # as early from the first move on
    return None if best is None or best[0] < AGREEING or best[0] <= alike else best[1:]


def _instant(own: Sequence[tuple[Channel, Array]], start: float, end: float, lost: int) -> float:
    """When samples were lost, between the last move in time and the end of the first early one, s.

    The middle of all instants that the readings allow: between two moves any is possible, within a
    move hardly one. Judged by changes from row to row, because the loss has spoiled the fit.
    """
    common = reduce(np.intersect1d, [channel.rows for channel, _ in own])
    ahead = common + lost * int(np.median(np.diff(common)))
    time = own[0][0].time[np.searchsorted(own[0][0].rows, common)]
    there = np.flatnonzero((time >= start) & (time <= end) & np.isin(ahead, common))
    misfit = np.zeros(len(there) - 1)  # of a loss just before each row but the first
    for channel, p in own:
        now, later = (np.searchsorted(channel.rows, rows[there]) for rows in (common, ahead))
        before, after = (channel.values[now] - p[rows] for rows in (now, later))
        steps = np.stack([np.diff(before), after[1:] - before[:-1], np.diff(after)]) ** 2
        whole = np.cumsum(steps, axis=1)
        misfit += (whole[0] - steps[0] + steps[1] + whole[2][-1] - whole[2]) / (
            2 * robust_white(channel.values - p) ** 2
        )
    allowed = np.flatnonzero(misfit < misfit.min() + SURE**2)
    return float((time[there[allowed[0]]] + time[there[allowed[-1] + 1]]) / 2)


def _moves(channel: Channel) -> list[tuple[float, float]]:
    """Start and end of each move, s."""
    moving = np.concatenate([[False], channel.stop < 0, [False]])
    edges = np.flatnonzero(np.diff(moving.astype(int)))
    time = channel.time
    return [
        (float(time[a]), float(time[b - 1]))
        for a, b in zip(edges[::2], edges[1::2], strict=True)
        if b - a > 4
    ]


def _lag(
    own: Sequence[tuple[Channel, Array]], start: float, end: float
) -> tuple[float, float, int] | None:
    """A move, and by how many samples the readings come early in it; None where too little was
    read.
    """
    cost = np.zeros(MOST)
    for channel, p in own:
        step = float(np.median(np.diff(channel.time)))
        rows = np.flatnonzero(
            (channel.time > start - BESIDE - MOST * step) & (channel.time < end + BESIDE)
        )
        rows = rows[rows + MOST < len(p)]
        if len(rows) < 8:
            return None
        ahead = p[rows[:, None] + np.arange(MOST)]
        off = channel.values[rows, None] - ahead
        cost += (
            np.nanmean((off - np.nanmedian(off, axis=0)) ** 2, axis=0)
            / robust_white(channel.values - p) ** 2
        )
    return start, end, int(np.argmin(cost))
