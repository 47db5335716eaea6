"""A table of means instead of a log: one row a pose, with stated standard deviations or with poses
that were repeated.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from itertools import groupby
from pathlib import Path

import numpy as np

from tiltcal.core.arrays import Array
from tiltcal.core.errors import TiltcalError
from tiltcal.core.files import require_file
from tiltcal.core.units import COLUMN_UNITS, split_unit
from tiltcal.recordings.csv_files import read_csv
from tiltcal.recordings.recording import Recording
from tiltcal.recordings.recording_files import assemble, read_recording
from tiltcal.recordings.samples import Labels
from tiltcal.setup.sensor import Sensor

SIGMA = "sigma"
DWELL_ROWS = 6  # of the shortest dwell of a log: the narrowest window that finds one
LEAST_REPEATS = 3  # degrees of freedom of a scatter: fewer leave its size unknown by half
ANGLE_PLACES = 3  # of an angle in the column's unit: a dial is set again to the same
SPACING = 1.0  # s between the stamps that rows are given: only their order is known


@dataclass(frozen=True)
class MeansTable(Recording):
    """Means of poses as a recording whose rows are the poses.

    Args:
        sigma: column of standard deviations -> values, SI, (m,): ``sigma`` for all channels, of a
            sensor ``accel_sigma``, or of a channel ``accel_x_sigma``.
    """

    sigma: Mapping[str, Array] = field(default_factory=dict)

    def sigma_of(self, sensor: Sensor) -> Array:
        """Standard deviations of a sensor's means, SI, (m, k): as stated, else the scatter of poses
        that were repeated.

        Raises:
            TiltcalError: none is stated for a channel, and no pose was repeated.
        """
        found = []
        for axis in sensor.axes:
            names = (f"{sensor.name}_{axis}_{SIGMA}", f"{sensor.name}_{SIGMA}", SIGMA)
            stated = next((self.sigma[n] for n in names if n in self.sigma), None)
            if stated is None:
                stated = self._scatter(sensor, sensor.axes.index(axis))
            if stated is None or not np.all(stated > 0):
                raise TiltcalError(
                    f"{self.source}, channel {sensor.name}_{axis}",
                    found="no positive standard deviation, and no pose that was repeated",
                    need=f"a column {sensor.name}_{SIGMA}_{sensor.column_unit}, or every pose"
                    " several times",
                    do="state the standard deviation of each mean",
                )
            found.append(stated)
        return np.column_stack(found)

    def _scatter(self, sensor: Sensor, channel: int) -> Array | None:
        """Pooled standard deviation of a channel over rows of the same pose, at each row, SI, (m,);
        None where too few were repeated.
        """
        samples = self.sensor(sensor)
        values = samples.values[:, channel]
        poses = np.unique(self._poses()[samples.rows], return_inverse=True)[1]
        known = ~np.isnan(values)
        values, poses = values[known], poses[known]
        counts = np.bincount(poses)
        freedom = int(counts.sum() - np.sum(counts > 0))
        if freedom < LEAST_REPEATS:
            return None
        means = np.bincount(poses, values) / np.maximum(counts, 1)
        variance = float(np.sum((values - means[poses]) ** 2)) / freedom
        return np.full(len(self), np.sqrt(variance))

    def _poses(self) -> Labels:
        """What every row says of its pose: label and angles, (m,)."""
        columns = [n for n in self.column_names if n.startswith("table_")]
        angles = [np.round(self.column(n), ANGLE_PLACES) for n in columns]
        labels = np.full(len(self), None) if self.labels is None else self.labels
        return np.array([str(row) for row in zip(labels, *angles, strict=True)])


def read_log_or_means(path: Path | str) -> Recording:
    """A recording, or a table of means: a CSV file without time_s but with columns of standard
    deviations, or one in which every row has a label and no label is repeated as in a dwell.

    Raises:
        TiltcalError: it is neither.
    """
    path = Path(path)
    if path.suffix != ".csv":
        return read_recording(path)
    require_file(path, "recording")
    if path.stat().st_size == 0:
        return read_recording(path)
    columns, metadata = read_csv(path)
    sigmas = {name for name in columns if _is_sigma(name)}
    if not (is_a_row_a_pose(columns.get("label")) or ("time_s" not in columns and sigmas)):
        return assemble(columns, metadata, path.name)
    rows = len(next(iter(columns.values())))
    stamps: dict[str, Array | Labels] = {"time_s": SPACING * np.arange(rows, dtype=float)}
    others = {n: c for n, c in columns.items() if n not in sigmas}
    plain = assemble(stamps | others, metadata, path.name)
    return MeansTable(
        plain.time,
        plain.blocks,
        plain.labels,
        plain.extra,
        plain.metadata,
        plain.source,
        sigma={split_unit(n)[0]: _si(n, columns[n], path.name) for n in sorted(sigmas)},
    )


def is_a_row_a_pose(labels: Array | Labels | None) -> bool:
    """Whether every row has a label and none is followed by as many of the same as a dwell has: no
    log, whose dwells and moves have rows enough to be found.

    Args:
        labels: of the rows, (n,); None where there is no such column.
    """
    if labels is None or labels.dtype != object or len(labels) < 2:
        return False
    words = [str(w).strip() if w is not None else "" for w in labels]
    longest = max(len(list(same)) for _, same in groupby(words))
    return all(words) and longest < DWELL_ROWS


def _is_sigma(name: str) -> bool:
    channel = split_unit(name)[0]
    return channel == SIGMA or channel.endswith(f"_{SIGMA}")


def _si(name: str, values: Array | Labels, source: str) -> Array:
    unit = split_unit(name)[1]
    if unit is None or COLUMN_UNITS[unit].quantity == "raw" or values.dtype == object:
        raise TiltcalError(
            f"recording {source}, column {name}",
            found="no number in a physical unit",
            need="a unit such as m_s2, g, deg or rad_s",
            do="state the standard deviations so",
        )
    return np.asarray(values, dtype=float) * COLUMN_UNITS[unit].factor
