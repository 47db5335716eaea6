"""Stated random settings of a table's axes, and mountings of the instrument, as part of the
covariance of the readings.

The rotation of each stop, or mounting, is normal with the stated standard deviation: one more
observation, "rotation / sigma = 0 with unit noise", and one more column. Least squares over all of
these rotations is least squares of readings and columns that are multiplied by the inverse square
root of their covariance 1 + Z Z', in units of the noise (Z: what one sigma of each rotation does).
That is done once under a noise, where the readings are whitened anyway; no model carries a column
for each stop.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from tiltcal.core.arrays import Array
from tiltcal.diagnosis.data.observations import Columns
from tiltcal.statistics.least_squares import CommonErrors


@dataclass(frozen=True)
class SettingWaves:
    """What one standard deviation of each random setting of a recording does to its readings.

    Args:
        channels: numbers of the channels that change.
        waves: cosine coefficients by channel, their rows weighed, SI, (n, stops) each.
    """

    channels: tuple[int, ...]
    waves: tuple[Array, ...]

    def of(self, channel: int) -> list[Array]:
        """Those of one channel, (n, stops), where it is among these."""
        return [w for i, w in zip(self.channels, self.waves, strict=True) if i == channel]

    def under(self, roots: Sequence[Array]) -> "SettingCovariance":
        """In units of the noise. roots: square roots of the spectra of all channels, (n,) each."""
        parts = [w / roots[i][:, None] for i, w in zip(self.channels, self.waves, strict=True)]
        columns = np.concatenate(parts)
        errors = CommonErrors(columns, np.ones(columns.shape[1], bool))
        return SettingCovariance(self.channels, tuple(len(part) for part in parts), errors)


@dataclass(frozen=True)
class SettingCovariance:
    """The covariance of the whitened readings of a recording by its random settings.

    Args:
        channels: numbers of the channels that change.
        counts: coefficients of each.
        errors: the settings, their columns in units of the noise, one channel after the other.
    """

    channels: tuple[int, ...]
    counts: tuple[int, ...]
    errors: CommonErrors

    def independent(self, vectors: Columns) -> Columns:
        """Vectors multiplied by the inverse square root of the covariance. By channel, (n,) or
        (n, q) each; one without any of these channels stays as it is.
        """
        if not any(i in vectors for i in self.channels):
            return vectors
        like = next(vectors[i] for i in self.channels if i in vectors)
        whole = np.concatenate(
            [
                vectors[i] if i in vectors else np.zeros((n, *like.shape[1:]))
                for i, n in zip(self.channels, self.counts, strict=True)
            ]
        )
        parts = np.split(self.errors.weight(whole), np.cumsum(self.counts)[:-1])
        return vectors | dict(zip(self.channels, parts, strict=True))

    def log_ratio(self, vectors: Columns) -> float:
        """By how much a residual in units of the noise is more probable with these settings than
        without, nats. By channel, (n,) each.
        """
        along = np.sum([vectors[i] @ part for i, part in self.lost.items()], axis=0)
        return float(along @ along - self.errors.log_det) / 2

    @cached_property
    def lost(self) -> Columns:
        """What the covariance takes off the information of whitened columns: of the inner products
        of two columns those along these directions are lost, by channel, (n, rank) each.
        """
        parts = np.split(self.errors.lost(), np.cumsum(self.counts)[:-1])
        return dict(zip(self.channels, parts, strict=True))
