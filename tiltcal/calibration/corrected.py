"""What came of correcting a stream: counts, and notes for the user."""

from dataclasses import dataclass, field

import numpy as np

from tiltcal.calibration.result import Calibration
from tiltcal.core.arrays import Array
from tiltcal.recordings.recording import Recording


@dataclass
class Corrected:
    """What came of a stream: rows written, readings of each axis left empty because its table does
    not hold there, and the range of every channel.
    """

    rows: int = 0
    beyond: dict[str, int] = field(default_factory=dict)
    range: dict[str, tuple[float, float]] = field(default_factory=dict)

    def count(self, chunk: Recording, added: dict[str, Array], calibration: Calibration) -> None:
        """Add a chunk. added: columns of the chunk, (n,) each."""
        self.rows += len(chunk)
        for name in added:
            self._widen(chunk, name)
        for key in calibration.bias_tables:
            name, _, axis = key.partition(".")
            sampled = np.isfinite(chunk.column(str(chunk.channel(f"{name}_{axis}"))))
            column = next(c for c in added if c.startswith(f"{name}_{axis}_corrected_"))
            self.beyond[key] = self.beyond.get(key, 0) + int(
                np.sum(sampled & np.isnan(added[column]))
            )

    def _widen(self, chunk: Recording, corrected: str) -> None:
        """Take up the least and the largest reading behind a corrected column."""
        name = chunk.channel(corrected.partition("_corrected_")[0])
        if "_corrected_" not in corrected or name is None:
            return
        values = chunk.column(name)
        if np.isfinite(values).any():
            low, high = self.range.get(name, (np.inf, -np.inf))
            self.range[name] = (
                min(low, float(np.nanmin(values))),
                max(high, float(np.nanmax(values))),
            )

    @property
    def notes(self) -> list[str]:
        """What the user should know."""
        notes = [
            f"{n} readings of {key} at placing angles that its table does not hold are left empty"
            for key, n in self.beyond.items()
            if n
        ]
        dead = [name for name, (low, high) in self.range.items() if low == high]
        if dead and self.rows > 1:
            notes.append(f"{', '.join(dead)}: constant throughout, dead or disconnected")
        return notes
