"""How the channels of a table change with each coefficient of a curve: the curve times what a
place of the chain answers to it.

Changes of a channel by the coefficients of a curve, as factors: the curve, which many places
share, and what the channel answers to it at one of them.

At an instant the motion depends on a turn's angle, rate and acceleration at that instant only: the
curve's value, rate and acceleration, each times the answer to it, are the change.
"""

from collections.abc import Sequence
from weakref import WeakKeyDictionary

import numpy as np

from tiltcal.core.arrays import Array
from tiltcal.diagnosis.data.block_grid import Sampling
from tiltcal.diagnosis.data.observations import Channel, CurveFactors, SharedCurve
from tiltcal.effects.learned import Learned
from tiltcal.forward.nominal_motion import NominalMotion
from tiltcal.setup.trajectory import Jet

Answered = list[tuple[int, tuple[Array | None, ...]]]
"""Numbers of channels, and what each answers to the parts of a curve, (m,) each."""


class CurveColumns:
    """The changes of the channels of recordings on a table by curves.

    Args:
        channels: of all recordings.
        samplings: of each channel, from where a model is asked to its samples.
    """

    def __init__(self, channels: Sequence[Channel], samplings: Sequence[Sampling]) -> None:
        self._channels, self._samplings = channels, samplings
        self._shared: dict[tuple[object, ...], SharedCurve] = {}
        self._answers: WeakKeyDictionary[NominalMotion, dict[object, Answered]] = (
            WeakKeyDictionary()
        )
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
            for i, answers in self._answered(number, watch, effect):
                known = [(a, p) for a, p in zip(answers, parts, strict=False) if a is not None]
                if not known:
                    continue
                total = known[0][0] * known[0][1]
                for answer, part in known[1:]:
                    total += answer * part
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
            for i, answers in self._answered(number, watch, effect):
                own = answers[: len(curve.parts)]
                singles = tuple(None if a is None else a.astype(np.float32) for a in own)
                if all(a is None for a in singles):
                    continue
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

    def _answered(self, recording: int, watch: NominalMotion, effect: Learned) -> Answered:
        """The channels of a recording that answer to a curve where an effect acts: many curves act
        there.
        """
        places = self._answers.setdefault(watch, {})
        key = effect.answer_id
        if key not in places:
            answers, places[key] = watch.answers(effect), []
            for i, c in enumerate(self._channels):
                if c.recording == recording and c.sensor in answers:
                    parts = answers[c.sensor]
                    own = [None if a is None else a[:, c.column].copy() for a in parts]
                    mine = tuple(None if a is None or not a.any() else a for a in own)
                    if any(a is not None for a in mine):
                        places[key].append((i, mine))
        return places[key]


def _parts(curve: Jet) -> list[Array]:
    """Value, rate and acceleration of a curve, (m, p) each, without those at the end that are
    zero.
    """
    parts = [np.asarray(part) for part in (curve.x, curve.v, curve.a)]
    last = max((k for k, part in enumerate(parts) if part.any()), default=0)
    return parts[: last + 1]
