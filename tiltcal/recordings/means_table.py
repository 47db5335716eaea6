"""A table of means with stated standard deviations instead of a log: one row a pose."""

from collections.abc import Mapping
from dataclasses import dataclass, field
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
        """Standard deviations of a sensor's means, SI, (m, k).

        Raises:
            TiltcalError: none is stated for a channel.
        """
        found = []
        for axis in sensor.axes:
            names = (f"{sensor.name}_{axis}_{SIGMA}", f"{sensor.name}_{SIGMA}", SIGMA)
            stated = next((self.sigma[n] for n in names if n in self.sigma), None)
            if stated is None or not np.all(stated > 0):
                raise TiltcalError(
                    f"{self.source}, channel {sensor.name}_{axis}",
                    found="no positive standard deviation",
                    need=f"a column {sensor.name}_{SIGMA}_{sensor.column_unit}",
                    do="state the standard deviation of each mean",
                )
            found.append(stated)
        return np.column_stack(found)


def read_log_or_means(path: Path | str) -> Recording:
    """A recording, or a table of means: a CSV file without time_s but with columns of standard
    deviations.

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
    if "time_s" in columns or not sigmas:
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
