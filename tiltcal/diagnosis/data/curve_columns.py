"""How the channels of a table change with each coefficient of a curve: the curve times what a
place of the chain answers to it.

Changes of a channel by the coefficients of a curve, as factors: the curve, which many places
share, and what the channel answers to it at one of them.

At an instant the motion depends on a turn's angle, rate and acceleration at that instant only: the
curve's value, rate and acceleration, each times the answer to it, are the change.
"""

from collections.abc import Iterator, Sequence

import numpy as np

from tiltcal.core.arrays import Array
from tiltcal.diagnosis.data.block_grid import Sampling
from tiltcal.diagnosis.data.observations import Channel, CurveFactors, SharedCurve
from tiltcal.effects.learned import Learned
from tiltcal.forward.nominal_motion import Answers, NominalMotion
from tiltcal.setup.trajectory import Jet


class CurveColumns:
    """The changes of the channels of recordings on a table by curves.

    Args:
        channels: of all recordings.
        samplings: of each channel, from where a model is asked to its samples.
    """

    def __init__(self, channels: Sequence[Channel], samplings: Sequence[Sampling]) -> None:
        self._channels, self._samplings = channels, samplings
        self._shared: dict[tuple[object, ...], SharedCurve] = {}
        self._last: dict[int, tuple[Jet, object, list[Array]]] = {}

    def columns(
        self, effect: Learned, names: Sequence[str], watches: Sequence[NominalMotion]
    ) -> dict[int, tuple[list[int], Array]]:
        """Change of each channel by each coefficient alone.

        Args:
            effect: at plausible sizes; names: of the coefficients.
            watches: nominal motion of each recording.

        Returns:
            By channel: numbers of the coefficients, and the changes, SI, (coefficients, n).
        """
        which = [int(name[1:]) for name in names]
        sizes = np.array([effect.values[name] for name in names])
        found: dict[int, tuple[list[int], Array]] = {}
        for number, watch in enumerate(watches):
            parts = self._parts_of(number, watch, effect, which, sizes)
            for i, answers in self._answered(number, watch.answers(effect), len(parts)):
                pairs = zip(answers, parts, strict=True)
                total = sum((a * part for a, part in pairs if a is not None), np.zeros(1))
                block = self._samplings[i].of(total.T).T
                some = np.flatnonzero(block.any(axis=1))
                if len(some):
                    found[i] = (some.tolist(), block if len(some) == len(block) else block[some])
        return found

    def _parts_of(
        self,
        recording: int,
        watch: NominalMotion,
        effect: Learned,
        which: Sequence[int],
        sizes: Array,
    ) -> list[Array]:
        """Value, rate and acceleration of a curve by some coefficients at their sizes, (p, m) each:
        the next is often the same in another place.
        """
        curve = watch.curve(effect)
        last, key = self._last.get(recording), (tuple(which), tuple(sizes))
        if last is None or last[0] is not curve or last[1] != key:
            parts = [np.ascontiguousarray(part.T[which]) * sizes[:, None] for part in _parts(curve)]
            last = self._last[recording] = curve, key, parts
        return last[2]

    def factors(self, effect: Learned, watches: Sequence[NominalMotion]) -> dict[int, CurveFactors]:
        """Change of each channel by each coefficient of a product of two angles, by channel, its
        rows weighed.

        Args:
            effect: at plausible sizes.
            watches: nominal motion of each recording.
        """
        found = {}
        for number, watch in enumerate(watches):
            curve = self._curve_of(number, watch, effect)
            for i, answers in self._answered(number, watch.answers(effect), len(curve.parts)):
                singles = tuple(None if a is None else a.astype(np.float32) for a in answers)
                spread = self._channels[i].spread
                found[i] = CurveFactors(
                    curve,
                    singles,
                    self._samplings[i],
                    None if spread is None else spread.astype(np.float32),
                )
        return found

    def _curve_of(self, recording: int, watch: NominalMotion, effect: Learned) -> SharedCurve:
        sizes = effect.coefficients
        key = (recording, effect.coordinate, effect.beside, tuple(sizes))
        if key not in self._shared:
            parts = [part.T * sizes[:, None] for part in _parts(watch.curve(effect))]
            self._shared[key] = SharedCurve(tuple(part.astype(np.float32) for part in parts))
        return self._shared[key]

    def _answered(
        self, recording: int, answers: Answers, count: int
    ) -> Iterator[tuple[int, tuple[Array | None, ...]]]:
        """The channels of a recording that answer to the first ``count`` parts of a curve, and
        their answers, (m,) each.
        """
        for i, c in enumerate(self._channels):
            if c.recording == recording and c.sensor in answers:
                own = [None if a is None else a[:, c.column] for a in answers[c.sensor][:count]]
                mine = tuple(None if a is None or not a.any() else a for a in own)
                if any(a is not None for a in mine):
                    yield i, mine


def _parts(curve: Jet) -> list[Array]:
    """Value, rate and acceleration of a curve, (m, p) each, without those at the end that are
    zero.
    """
    parts = [np.asarray(part) for part in (curve.x, curve.v, curve.a)]
    last = max((k for k, part in enumerate(parts) if part.any()), default=0)
    return parts[: last + 1]
