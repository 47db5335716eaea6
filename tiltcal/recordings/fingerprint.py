"""Fingerprints of recordings."""

import hashlib
from collections.abc import Iterable, Mapping

import numpy as np

from tiltcal.core.arrays import Array

FIRST = 4096  # rows of each column of readings


def fingerprint_of(stamps: Iterable[Array], readings: Mapping[str, Array]) -> str:
    """A digest of the stamps of a recording and, where it has any, one of its first readings.

    Args:
        stamps: s, piece by piece.
        readings: of each column, (n,), at least the first ``FIRST`` of them.
    """
    digest_of_stamps = _digest((np.round(time, 6) for time in stamps), 16)
    if not readings:
        return digest_of_stamps
    return f"{digest_of_stamps}-{_digest((readings[n][:FIRST] for n in sorted(readings)), 8)}"


def _digest(columns: Iterable[Array], digits: int) -> str:
    digest = hashlib.sha256()
    for column in columns:
        digest.update(np.ascontiguousarray(column).tobytes())
    return digest.hexdigest()[:digits]
