"""What a readout tells, kept by its contents: one recording is replayed many times, its columns
read anew.
"""

from functools import lru_cache

import numpy as np

from tiltcal.core.arrays import Array, Index, Mask
from tiltcal.recordings.differentiation import Rates, differentiate, noise_of_stamped
from tiltcal.recordings.rest_edges import edges
from tiltcal.recordings.stamps import sampled_at
from tiltcal.recordings.table_rests import at_rest


def sign_of(angle: Array) -> float:
    """Sign of the angle that is furthest from zero. angle: rad, (n,)."""
    return -1.0 if angle[np.argmax(np.abs(angle))] < 0 else 1.0


@lru_cache(maxsize=24)
def rests_of(time: bytes, angles: bytes, axes: int) -> tuple[Mask, Index]:
    """``at_rest`` of the contents of arrays, (n,) and (n, axes)."""
    return at_rest(np.frombuffer(time), np.frombuffer(angles).reshape(-1, axes))


@lru_cache(maxsize=24)
def edges_of(time: bytes, angle: bytes) -> tuple[Array, Array]:
    """When an axis left a rest, s, (k,), and when it came to one, of the contents of arrays."""
    x = np.frombuffer(angle)
    t = sampled_at(np.frombuffer(time), x)
    if len(t) < 9 or np.ptp(x) == 0:
        return np.zeros(0), np.zeros(0)
    still, parted = rests_of(t.tobytes(), angle, 1)
    noise, step = noise_of_stamped(t, x, still, parted), float(np.median(np.diff(t)))
    if not len(noise):
        return np.zeros(0), np.zeros(0)
    leaves, comes = edges(t / step, x, still, noise, parted)
    return leaves * step, comes * step


@lru_cache(maxsize=24)
def rates_of(time: bytes, angle: bytes) -> Rates:
    """The rates of one axis, of the contents of arrays, (n,): it rests for itself, whatever the
    others do.
    """
    x = np.frombuffer(angle)
    t = sampled_at(np.frombuffer(time), x)
    return differentiate(t, x, *rests_of(t.tobytes(), angle, 1))


def forget_replays() -> None:
    """Free what is kept of the readouts that were replayed last."""
    rests_of.cache_clear()
    edges_of.cache_clear()
    rates_of.cache_clear()
