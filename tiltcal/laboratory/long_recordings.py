"""Long recordings made piece by piece, to the bit as in one go.

That needs every effect to act row by row, or, as noise does, to go on where it stopped. What looks
over the whole recording (a filter, a table run by time steps, a hand's motion) is made in one go.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from tiltcal.core.arrays import Array
from tiltcal.core.budget import require_within
from tiltcal.effects.base import Effect
from tiltcal.effects.sensor.noise import Noise, NoiseDraw
from tiltcal.forward.signal_chain import stream
from tiltcal.laboratory.scenario import Scenario
from tiltcal.recordings.parquet_files import PIECE

CELL = 64  # bytes of working memory for a cell of a recording made in one go, measured
# columns in addition to those of sensors and table axes: time, temperature, label
OTHER_COLUMNS = 3
ROW_S, STEP_S = 1e-6, 3e-5  # of computing for a row, and for a time step, measured


@dataclass(frozen=True)
class Stamps:
    """When a sensor is sampled.

    Args:
        start: s.
        rate_hz: of the samples.
        n: samples.
    """

    start: float
    rate_hz: float
    n: int

    @classmethod
    def between(cls, start: float, end: float, rate_hz: float) -> "Stamps":
        """From the first instant of a sequence to the last, s."""
        return cls(start, rate_hz, int(np.floor((end - start) * rate_hz + 1e-9)) + 1)

    def part(self, first: int, last: int) -> Array:
        """Stamps of the samples from ``first`` to before ``last``, s. (last - first,)."""
        return self.start + np.arange(first, min(last, self.n)) / self.rate_hz

    def before(self, time: float) -> int:
        """How many samples are taken before an instant, s."""
        if np.isinf(time):
            return self.n
        about = int((time - self.start) * self.rate_hz)
        near = self.part(max(about - 2, 0), about + 3)
        return min(max(about - 2, 0) + int(np.searchsorted(near, time)), self.n)


def require_recordable(scenario: Scenario, in_one_go: bool = True) -> None:
    """Refuse a recording that is over the budget, before anything of it is allocated.

    Args:
        scenario: that would be recorded.
        in_one_go: whether all of it is in memory at the same time.

    Raises:
        TiltcalError: stating its rows and bytes.
    """
    start, end = scenario.schedule.times
    rows = [(end - start) * s.rate_hz + 1 for s in scenario.sensor]
    cells = sum(n * len(s.axes) for n, s in zip(rows, scenario.sensor, strict=True))
    others = OTHER_COLUMNS + len(scenario.rig.axis_names)
    total = max(rows, default=0.0) if len({s.rate_hz for s in scenario.sensor}) < 2 else sum(rows)
    steps = (end - start) / scenario.dynamics.timestep_s if scenario.dynamics else 0.0
    require_within(
        f"scenario {scenario.name}",
        rows=total,
        size=CELL * (cells + total * others) if in_one_go else 0.0,
        seconds=STEP_S * steps + ROW_S * total,
        less="shorten the sequence or lower rate_hz",
    )


def whole(stamps: dict[str, Stamps]) -> dict[str, Array]:
    """All stamps of each sensor, s. (n,) each."""
    return {name: s.part(0, s.n) for name, s in stamps.items()}


def works_in_pieces(scenario: Scenario, stamps: dict[str, Stamps]) -> bool:
    """Whether a recording is long, and every effect of its scenario acts in pieces."""
    if max(s.n for s in stamps.values()) <= PIECE or scenario.dynamics is not None:
        return False
    if not scenario.rig.axes or any(s.converter is not None for s in scenario.sensor):
        return False
    return all(
        NoiseDraw.possible(stamps[str(e.sensor)].n, stamps[str(e.sensor)].rate_hz)
        if isinstance(e, Noise)
        else e.row_wise
        for e in scenario.effects
        if not e.is_identity
    )


def in_pieces(
    scenario: Scenario, effects: Sequence[Effect], stamps: dict[str, Stamps], seed: int | None
) -> Sequence[Effect]:
    """The effects, noise as one that continues from piece to piece."""
    if seed is None:
        return effects
    return [
        e.in_pieces(
            scenario.named(str(e.sensor)),
            stamps[str(e.sensor)].n,
            stream(seed, e.id, str(e.sensor)),
        )
        if isinstance(e, Noise) and not e.is_identity
        else e
        for e in effects
    ]


def piece_stamps(stamps: dict[str, Stamps]) -> Iterator[dict[str, Array]]:
    """The stamps of each sensor, piece by piece, s; a piece is an interval of time. The last takes
    what is left, so that none is small. (n,) each.
    """
    most = max(stamps.values(), key=lambda s: s.n)
    done = dict.fromkeys(stamps, 0)
    ends = [most.part(k, k + 1)[0] for k in range(PIECE, most.n - PIECE + 1, PIECE)]
    for end in [*ends, np.inf]:
        upto = {name: s.before(end) for name, s in stamps.items()}
        yield {name: s.part(done[name], upto[name]) for name, s in stamps.items()}
        done = upto


def first_stamps(scenario: Scenario, stamps: dict[str, Stamps]) -> Array:
    """The stamps next to the beginnings of the legs of a sequence, s: where mountings and labels
    change. (m,).
    """
    starts = [leg.t0 for leg in scenario.schedule.legs]
    found = [
        s.part(max(s.before(t) - 1, 0), s.before(t) + 2) for s in stamps.values() for t in starts
    ]
    return np.unique(np.concatenate(found))
