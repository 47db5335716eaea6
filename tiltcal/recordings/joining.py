"""Several recordings of one set-up as one, one after the other."""

from collections.abc import Sequence
from functools import reduce
from itertools import pairwise

import numpy as np

from tiltcal.core.arrays import Array
from tiltcal.core.errors import TiltcalError
from tiltcal.recordings.means_table import MeansTable
from tiltcal.recordings.recording import Recording
from tiltcal.recordings.samples import Labels

JOINS = "joined at s"  # metadata: stamps at which another recording begins
GAP = 60.0  # s between them in the joined time: no dwell reaches over it


def joined(recordings: Sequence[Recording], mount: str) -> Recording:
    """One recording of several; a channel that one of them lacks is not sampled there.

    Args:
        recordings: in order; their own times are kept apart by a gap.
        mount: of those whose metadata state none.

    Raises:
        TiltcalError: logs and tables of means are mixed, or several tables of means are given.
    """
    if len(recordings) == 1:
        return recordings[0]
    if any(isinstance(r, MeansTable) for r in recordings):
        raise TiltcalError(
            f"{len(recordings)} recordings",
            found="a table of means among them",
            need="logs, or one table of means",
            do="write the means into one file",
        )
    names = list(dict.fromkeys(n for r in recordings for n in r.column_names if n not in r.extra))
    numbers = [n for n in names if any(n in b.columns for r in recordings for b in r.blocks)]
    starts = _starts(recordings)
    time = np.concatenate([r.time - r.time[0] + s for r, s in zip(recordings, starts, strict=True)])
    columns = {n: np.concatenate([_column(r, n) for r in recordings]) for n in numbers}
    labels = None
    if any(r.labels is not None for r in recordings):
        labels = np.concatenate([_labels(r) for r in recordings])
    metadata = reduce(lambda a, b: {**b, **a}, (dict(r.metadata) for r in recordings))
    if any("mount" in r.metadata for r in recordings):
        metadata["mount"] = _mounts(recordings, starts, mount)
    metadata[JOINS] = ", ".join(f"{s:.9g}" for s in starts[1:])
    source = " + ".join(r.source for r in recordings)
    return Recording.from_columns(time, columns, labels=labels, metadata=metadata, source=source)


def joins_of(recording: Recording) -> Array:
    """Stamps at which another recording begins, s, (j,); none of a single recording.

    Raises:
        TiltcalError: the metadata are no numbers.
    """
    stated = recording.metadata.get(JOINS, "")
    try:
        return np.array([float(stamp) for stamp in stated.split(",") if stamp.strip()])
    except ValueError as error:
        raise TiltcalError(
            f"{recording.source}, metadata '{JOINS}'",
            found=f"'{stated}'",
            need="times in seconds, separated by commas",
            do="correct the line, or delete it",
        ) from error


def parts_of(recording: Recording) -> list[Recording]:
    """The recordings that one was joined of, in its time; itself where it was not."""
    joins = joins_of(recording)
    if not len(joins):
        return [recording]
    cuts = [0, *np.searchsorted(recording.time, joins - GAP / 2).tolist(), len(recording)]
    metadata = {k: v for k, v in recording.metadata.items() if k != JOINS}
    names = [n for n in recording.column_names if any(n in b.columns for b in recording.blocks)]
    return [
        Recording.from_columns(
            recording.time[a:b],
            {n: recording.column(n)[a:b] for n in names},
            labels=None if recording.labels is None else recording.labels[a:b],
            metadata=metadata,
            source=recording.source,
        )
        for a, b in pairwise(cuts)
    ]


def _labels(recording: Recording) -> Labels:
    if recording.labels is None:
        return np.full(len(recording), None, dtype=object)
    return recording.labels


def _starts(recordings: Sequence[Recording]) -> list[float]:
    """When each begins in the joined time, s."""
    starts = [0.0]
    for r in recordings[:-1]:
        starts.append(starts[-1] + float(r.time[-1] - r.time[0]) + GAP)
    return starts


def _column(recording: Recording, name: str) -> Array:
    there = any(name in block.columns for block in recording.blocks)
    return recording.column(name) if there else np.full(len(recording), np.nan)


def _mounts(recordings: Sequence[Recording], starts: Sequence[float], mount: str) -> str:
    """The mountings of all of them with the times from which they are valid."""
    found = []
    for k, (r, start) in enumerate(zip(recordings, starts, strict=True)):
        for part in r.metadata.get("mount", mount).split(";"):
            when, colon, stated = part.partition(":")
            at = start - GAP / 2 if not colon else None
            if at is None:
                at = start + float(when.strip().removesuffix("s")) - float(r.time[0])
            text = (stated if colon else part).strip()
            found.append(text if k == 0 and not colon else f"{at:.9g} s: {text}")
    return "; ".join(found)
