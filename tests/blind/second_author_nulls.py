"""Ordinary recordings by a second author: noise, stamps and cells as real logs have them, with
nothing concealed. The right verdict on each is that the model matches.
"""

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from blind.laboratory import Lab
from blind.nuisance import Nuisance
from blind.second_author_terms import hinge
from blind.world import Past, felt

Make = Callable[[np.random.Generator, Lab], Nuisance | None]
SEEN_SIGMA = 0.2  # of the error that rounded stamps make while moving: more would be a fault
TICKS_S = (1e-3, 1 / 1024, 1 / 8192, 1e-4, 1 / 32768)
TAIL_SIGMA = 6.0  # Student's tails end here: 7.7 sigma of its quartiles, below a gross value


def ordinary(rng: np.random.Generator, lab: Lab) -> Lab | None:
    """The laboratory with one nuisance drawn; None where it would be a fault there."""
    names = sorted(NULLS)
    nuisance = NULLS[names[int(rng.integers(len(names)))]](rng, lab)
    return nuisance and replace(lab, noise=replace(lab.noise, nuisance=nuisance))


# --------------------------------------------------------------------------------------------------
# sizes of the noise


def unequal(rng: np.random.Generator, lab: Lab) -> Nuisance:
    """One channel is three times as noisy as it is said to be; where one stands alone, all."""
    factor = np.ones(len(lab.channels))
    factor[int(rng.integers(len(factor)))] = 3.0
    return Nuisance("n_unequal_axes", white=lambda rng, lab, t, e: e * factor)


def of_load(rng: np.random.Generator, lab: Lab) -> Nuisance:
    """Noise grows with the load across: two and a half times at 1 g."""

    def white(rng: np.random.Generator, lab: Lab, t: np.ndarray, e: np.ndarray) -> np.ndarray:
        f = felt(lab, (), t, Past(lab)).f / lab.gravity
        return e * (1 + 1.5 * np.hypot(f[:, 0], f[:, 1]))[:, None]

    return Nuisance("n_noise_of_tilt", white=white)


def of_rate(rng: np.random.Generator, lab: Lab) -> Nuisance:
    """Noise grows with the rate of turn: twice at 0.3 rad/s."""

    def white(rng: np.random.Generator, lab: Lab, t: np.ndarray, e: np.ndarray) -> np.ndarray:
        rate = np.linalg.norm(felt(lab, (), t, Past(lab)).w, axis=1)
        return e * (1 + np.minimum(rate / 0.3, 3.0))[:, None]

    return Nuisance("n_noise_of_rate", white=white)


def of_temperature(rng: np.random.Generator, lab: Lab) -> Nuisance:
    """Noise grows above the mean temperature: by 0.7 a degree."""
    return Nuisance(
        "n_noise_of_temperature",
        white=lambda rng, lab, t, e: e * (1 + 0.7 * hinge(lab.room.at(t) - lab.T0, 0.2))[:, None],
    )


def bursts(rng: np.random.Generator, lab: Lab) -> Nuisance:
    """Three to six times the noise while moving, in half of the moves."""
    factor = float(rng.uniform(3, 6))

    def white(rng: np.random.Generator, lab: Lab, t: np.ndarray, e: np.ndarray) -> np.ndarray:
        since, begun = lab.track.since_move(t)
        loud = rng.random(begun.max() + 1) < 0.5
        return e * np.where((since == 0) & loud[begun], factor, 1.0)[:, None]

    return Nuisance("n_moving_bursts", white=white)


def growing(rng: np.random.Generator, lab: Lab) -> Nuisance:
    """The noise doubles from start to end."""
    return Nuisance(
        "n_growing", white=lambda rng, lab, t, e: e * (1 + t / lab.track.end_s)[:, None]
    )


# --------------------------------------------------------------------------------------------------
# kinds of the noise


def student(rng: np.random.Generator, lab: Lab) -> Nuisance:
    """Student's t with 4 degrees of freedom, unit variance; the farthest are drawn again."""

    def white(rng: np.random.Generator, lab: Lab, t: np.ndarray, e: np.ndarray) -> np.ndarray:
        out = rng.standard_t(4, e.shape) / np.sqrt(2)
        while (far := np.abs(out) > TAIL_SIGMA).any():
            out[far] = rng.standard_t(4, int(far.sum())) / np.sqrt(2)
        return out

    return Nuisance("n_student", white=white)


def correlated(rng: np.random.Generator, lab: Lab) -> Nuisance:
    """Neighbouring samples share 0.2 to 0.4 of their noise, as behind a filter against aliases."""
    share = float(rng.uniform(0.2, 0.4))

    def white(rng: np.random.Generator, lab: Lab, t: np.ndarray, e: np.ndarray) -> np.ndarray:
        out = e * np.sqrt(1 - share**2)
        out[0] = e[0]
        for k in range(1, len(out)):
            out[k] += share * out[k - 1]
        return out

    return Nuisance("n_correlated", white=white)


def common(rng: np.random.Generator, lab: Lab) -> Nuisance | None:
    """Two channels of a sensor share 0.4 to 0.8 of their noise: the table trembles."""
    pairs = [c for c in range(1, len(lab.channels)) if lab.channels[c][0] == lab.channels[c - 1][0]]
    if not pairs:
        return None
    second, share = int(rng.choice(pairs)), float(rng.uniform(0.4, 0.8))

    def white(rng: np.random.Generator, lab: Lab, t: np.ndarray, e: np.ndarray) -> np.ndarray:
        out = e.copy()
        out[:, second] = share * e[:, second - 1] + np.sqrt(1 - share**2) * e[:, second]
        return out

    return Nuisance("n_common", white=white)


# --------------------------------------------------------------------------------------------------
# stamps, cells and digits


def rounded(rng: np.random.Generator, lab: Lab) -> Nuisance | None:
    """Stamps rounded to the coarsest tick that hardly shows, samples taken when they were."""
    t = np.arange(0.0, lab.track.end_s, 0.02)
    state = felt(lab, (), t, Past(lab))
    steep = {"gyro": state.w, "fog": state.w}
    shown = 0.0  # error of the readings while moving, in sigma, by a second of rms error in time
    for sensor in lab.sensors:
        slope = np.abs(np.gradient(steep.get(sensor.kind, state.f), t, axis=0)).max(1)
        moving = slope[slope > 0.05 * slope.max()]
        shown = max(shown, float(np.sqrt(np.mean(moving**2))) / sensor.sigma)
    fine = [tick for tick in TICKS_S if shown * tick / np.sqrt(12) <= SEEN_SIGMA]
    if not fine:
        return None
    return Nuisance("n_rounded_stamps", stamps=scattered(0.05), written=ticks(fine[0]))


def ticks(tick_s: float) -> Callable[[np.ndarray], np.ndarray]:
    """Rounds to whole ticks."""
    return lambda t: np.round(t / tick_s) * tick_s


def scattered(share: float) -> Callable[[np.random.Generator, np.ndarray], np.ndarray]:
    """Instants moved by up to ``share`` of the interval."""

    def stamps(rng: np.random.Generator, t: np.ndarray) -> np.ndarray:
        moved = t + share * np.median(np.diff(t)) * rng.uniform(-1, 1, len(t))
        return moved - moved[0]

    return stamps


def ticking(rng: np.random.Generator, lab: Lab) -> Nuisance:
    """Samples taken at whole ticks of 1/1024 s or 1 ms, not evenly: the stamps are true."""
    tick = float(rng.choice([1e-3, 1 / 1024]))
    late = scattered(float(rng.uniform(0.03, 0.1)))
    return Nuisance("n_ticking", stamps=lambda rng, t: ticks(tick)(late(rng, t)))


def jittered(rng: np.random.Generator, lab: Lab) -> Nuisance:
    """True stamps that come a tenth to a third of the interval early or late."""
    return Nuisance("n_true_jitter", stamps=scattered(float(rng.uniform(0.1, 0.33))))


def blocks(rng: np.random.Generator, lab: Lab) -> Nuisance:
    """Eight times a stretch of 5 to 60 rows has no values."""

    def empty(rng: np.random.Generator, n: int, channels: int) -> np.ndarray:
        out = np.zeros((n, channels), bool)
        for start in rng.integers(20, n - 80, 8):
            out[start : start + int(rng.integers(5, 61))] = True
        return out

    return Nuisance("n_empty_blocks", empty=empty)


def sparse(rng: np.random.Generator, lab: Lab) -> Nuisance:
    """One channel lacks a fifth to a half of its cells."""
    which, share = int(rng.integers(len(lab.channels))), float(rng.uniform(0.2, 0.5))

    def empty(rng: np.random.Generator, n: int, channels: int) -> np.ndarray:
        out = np.zeros((n, channels), bool)
        out[:, which] = rng.random(n) < share
        return out

    return Nuisance("n_sparse_channel", empty=empty)


def digits(rng: np.random.Generator, lab: Lab) -> Nuisance:
    """Decimals of the file end below a third of sigma."""
    return Nuisance("n_few_digits", coarse=1 / 3)


def pause(rng: np.random.Generator, lab: Lab) -> Nuisance:
    """The log pauses for 4 to 12 s; the stamps are true."""
    start, length = rng.uniform(0.25, 0.7) * lab.track.end_s, rng.uniform(4, 12)
    return Nuisance("n_pause", logged=lambda t: (t < start) | (t > start + length))


NULLS: dict[str, Make] = {
    make.__name__: make
    for make in (
        unequal,
        of_load,
        of_rate,
        of_temperature,
        bursts,
        growing,
        student,
        correlated,
        common,
        rounded,
        ticking,
        jittered,
        blocks,
        sparse,
        digits,
        pause,
    )
}
