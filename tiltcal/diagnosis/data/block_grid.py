"""Instants at which a model is asked for means over blocks of samples."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from tiltcal.core.arrays import Array, Index, Real
from tiltcal.core.units import DEG
from tiltcal.statistics.cosine_transform import quick_length

TURN = 20 * DEG  # between instants while a table turns
SPREAD = 0.5  # of the time since a table came to rest: between the next instants


def blocks_of(rows: int, block: int) -> int:
    """Whole blocks among the rows of a recording; one where they are fewer than a block."""
    return max(rows // block, 1)


def mean_times(time: Array, starts: Index) -> Array:
    """Mean time of each group of samples. time: s, (n,); starts: first sample of each, (k,)."""
    if len(starts) == len(time):
        return time
    since = np.add.reduceat(time - time[0], starts) / np.diff(starts, append=len(time))
    return np.asarray(time[0] + since)


@dataclass(frozen=True)
class SampleBlocks:
    """Samples of a channel in the blocks of its recording's rows: blocks of all channels are of the
    same instants, whatever cells are missing.

    Args:
        starts: first sample of each block that has any, (blocks,).
        counts: samples in each, (blocks,).
    """

    starts: Index
    counts: Index

    @classmethod
    def of(cls, rows: Index, block: int, total: int) -> "SampleBlocks":
        """As many blocks as have a quick transform.

        Args:
            rows: of the samples in the recording, increasing, (n,).
            block: rows in each.
            total: rows of the recording.
        """
        number = rows // block
        number = number[number < blocks_of(total, block)]
        starts = np.flatnonzero(np.diff(number, prepend=-1))
        taken = slice(quick_length(len(starts)))
        return cls(starts[taken], np.diff(starts, append=len(number))[taken])

    @property
    def samples(self) -> int:
        """Samples in all of them."""
        return int(self.counts.sum())

    def means(self, values: Array) -> Array:
        """Means over the samples of each block, (..., n) -> (..., blocks)."""
        values = values[..., : self.samples]
        if values.shape[-1] == len(self.starts):
            return values
        return np.asarray(np.add.reduceat(values, self.starts, axis=-1) / self.counts)


@dataclass(frozen=True)
class BlockGrid:
    """Instants of blocks of samples.

    Args:
        time: of the instants, s, (k,).
        starts: first instant of each block, (blocks,).
        weight: of each instant in the mean of its block, (k,).
    """

    time: Array
    starts: Index
    weight: Array

    @classmethod
    def middles(cls, time: Array, block: int) -> "BlockGrid":
        """The middles of blocks, which lie between two samples where a block has an even number of
        them. time: of samples, s, (n,).
        """
        blocks = blocks_of(len(time), block)
        middle = mean_times(time[: blocks * block], np.arange(blocks) * block)
        return cls(middle, np.arange(len(middle)), np.ones(len(middle)))

    @classmethod
    def by_motion(
        cls, time: Array, block: int, angles: Mapping[str, Array], stop: Index
    ) -> "BlockGrid":
        """Blocks that are long beside the moves in them: many instants while a table turns and
        shortly after, few while it rests.

        Args:
            time: of samples, s, (n,).
            block: samples.
            angles: of each axis, rad, (n,).
            stop: number of the stop, -1 while moving, (n,).
        """
        blocks = blocks_of(len(time), block)
        time, stop = time[: blocks * block], stop[: blocks * block]
        angles = {name: angle[: blocks * block] for name, angle in angles.items()}
        turned = sum(
            (np.abs(np.diff(a, prepend=a[0])) for a in angles.values()), np.zeros(len(time))
        )
        step = np.diff(time, prepend=2 * time[0] - time[1])
        came = np.maximum.accumulate(np.where(stop < 0, time, time[0]))
        rested = np.maximum(time - came, step)
        moved = np.where(stop < 0, turned / TURN, np.minimum(step / (SPREAD * rested), 1.0))
        part = np.floor(np.cumsum(np.minimum(moved, 1.0))).astype(np.intp)
        number = np.minimum(np.arange(len(time)) // block, blocks - 1)
        begins = (np.diff(part, prepend=-1) != 0) | (np.diff(number, prepend=-1) != 0)
        first = np.flatnonzero(begins)
        counts = np.diff(first, append=len(time))
        starts = np.searchsorted(number[first], np.arange(number[-1] + 1))
        size = np.bincount(number)
        return cls(mean_times(time, first), starts, counts / size[number[first]])

    def means(self, values: Real) -> Real:
        """Means over blocks of values at the instants, (k, ...) -> (blocks, ...)."""
        if len(self.starts) == len(self.time):
            return values
        return np.add.reduceat(values * self._weight_of(values), self.starts, axis=0)

    def means_adjoint(self, values: Real) -> Real:
        """What has the inner products with values at the instants that ``values`` have with their
        means, (blocks, ...) -> (k, ...).
        """
        if len(self.starts) == len(self.time):
            return values
        counts = np.diff(self.starts, append=len(self.time))
        return np.repeat(values, counts, axis=0) * self._weight_of(values)

    def _weight_of(self, values: Real) -> Real:
        return self.weight.reshape(-1, *[1] * (values.ndim - 1)).astype(values.dtype)


@dataclass(frozen=True)
class Sampling:
    """The way from the instants at which a model is asked to the samples of a channel.

    Args:
        grid: the instants, in blocks.
        rows: blocks that the channel has, (n,); a slice where one follows the other.
    """

    grid: BlockGrid
    rows: Index | slice

    def of(self, values: Real) -> Real:
        """Values at the samples, (k, ...) -> (n, ...)."""
        return self.grid.means(values)[self.rows]

    def adjoint(self, values: Real) -> Real:
        """What has the inner products with values at the instants that ``values`` have with those
        at the samples, (n, ...) -> (k, ...).
        """
        if len(values) == len(self.grid.starts) and isinstance(self.rows, slice):
            return self.grid.means_adjoint(values)
        whole = np.zeros((len(self.grid.starts), *values.shape[1:]), values.dtype)
        if isinstance(self.rows, slice) or bool((np.diff(self.rows) > 0).all()):
            whole[self.rows] = values
        else:
            np.add.at(whole, self.rows, values)
        return self.grid.means_adjoint(whole)
