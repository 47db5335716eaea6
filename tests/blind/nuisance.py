"""What an ordinary recording may have beyond white noise: hooks where noise, stamps and cells are
made. None of them is physics that a model could hold.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from blind.laboratory import Lab

Generator = np.random.Generator


@dataclass(frozen=True)
class Nuisance:
    """One way to be ordinary; a hook that is None leaves things as they are.

    Attributes:
        id: its name in the truth.
        white: (rng, lab, t, e) -> e: white noise in units of a sample's sigma, (n, channels).
        stamps: (rng, t) -> t: when samples are truly taken, s; the file says so.
        written: (t) -> t: stamps as the file has them, s.
        empty: (rng, n, channels) -> (n, channels) bool: cells without a value.
        logged: (t) -> (n,) bool: rows that are in the file.
        coarse: decimals are kept to this share of a sample's sigma; None: as usual, to 1/30.
    """

    id: str
    white: "Callable[[Generator, Lab, np.ndarray, np.ndarray], np.ndarray] | None" = None
    stamps: Callable[[Generator, np.ndarray], np.ndarray] | None = None
    written: Callable[[np.ndarray], np.ndarray] | None = None
    empty: Callable[[Generator, int, int], np.ndarray] | None = None
    logged: Callable[[np.ndarray], np.ndarray] | None = None
    coarse: float | None = None
