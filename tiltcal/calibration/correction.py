"""Correcting a recording with a calibration, in fixed memory: chunk in, chunk out."""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import IO, Any

import numpy as np
from pydantic import ValidationError

from tiltcal.calibration.result import Calibration, tilt_angles
from tiltcal.core.arrays import Array
from tiltcal.core.errors import TiltcalError
from tiltcal.core.files import require_file
from tiltcal.core.frames import force_of_tilt, tilt_of_force
from tiltcal.core.units import COLUMN_UNITS, DEG
from tiltcal.recordings.csv_files import csv_head, is_number, write_head
from tiltcal.recordings.recording import Recording
from tiltcal.recordings.recording_files import assemble, read_recording
from tiltcal.setup.sensor import Sensor
from tiltcal.setup.setup import Setup

CHUNK = 1 << 20  # bytes of text read at a time


def setup_of(calibration: Calibration) -> Setup:
    """The set-up a calibration was made with.

    Raises:
        TiltcalError: it does not carry one, or one that is none.
    """
    stated = calibration.provenance.get("setup")
    if stated is None:
        raise TiltcalError(
            f"calibration by {calibration.method}",
            found="no provenance.setup",
            need="the set-up it belongs to",
            do="make it with `tiltcal calibrate`, which adds the set-up",
        )
    try:
        return Setup.model_validate(stated)
    except ValidationError as error:
        first = error.errors()[0]
        raise TiltcalError(
            f"calibration by {calibration.method},"
            f" provenance.setup.{'.'.join(map(str, first['loc']))}",
            found=first["msg"].lower(),
            need="the set-up as `tiltcal calibrate` writes it",
            do="make the calibration again",
        ) from error


def corrected_columns(
    recording: Recording, calibration: Calibration, setup: Setup
) -> dict[str, Array]:
    """The columns that correction adds, full length: corrected readings in their own unit, and tilt
    where defined.

    ``<sensor>_<axis>_corrected_<unit>``, ``tilt_x_deg``, ``tilt_y_deg``.
    """
    columns: dict[str, Array] = {}
    g = setup.site.gravity
    for name in calibration.sensors():
        sensor = setup.named(name)
        samples = recording.sensor(sensor)
        values = (
            force_of_tilt(samples.values, g) if sensor.kind == "inclinometer" else samples.values
        )
        fixed = calibration.correct(
            sensor, values - _pulled(recording, calibration, setup, sensor, samples.time), g
        )
        shown = tilt_of_force(fixed, g) if sensor.kind == "inclinometer" else fixed
        for i, axis in enumerate(sensor.axes):
            unit = _unit(samples.units[i], sensor)
            key = f"{name}_{axis}_corrected_{unit}"
            columns[key] = _full(
                shown[:, i] / COLUMN_UNITS[unit].factor, samples.rows, len(recording)
            )
        if sensor.is_accelerometer:
            angles = tilt_angles(fixed, sensor, g)
            # a level of two axes: what its z channel reads is not corrected
            if calibration.bias_tables:
                angles = {
                    axis: tilt_of_force(fixed[:, sensor.axes.index(axis)], g) for axis in angles
                }
            for axis, angle in angles.items():
                columns.setdefault(
                    f"tilt_{axis}_deg", _full(angle / DEG, samples.rows, len(recording))
                )
    return columns


def _pulled(
    recording: Recording, calibration: Calibration, setup: Setup, sensor: Sensor, time: Array
) -> Array | float:
    """What a gyro's g-sensitivity adds at these stamps, rad/s, (n, k), by the accelerometer triad
    beside it.

    Raises:
        TiltcalError: it was calibrated, but there is no triad to take the force from.
    """
    G = calibration.g_sensitivity(sensor)
    if G is None:
        return 0.0
    triads = [s for s in setup.sensors("accelerometer") if len(s.axes) == 3 and recording.has(s)]
    if not triads:
        raise TiltcalError(
            recording.source,
            found=f"no accelerometer triad beside {sensor.name}",
            need="the force its g-sensitivity follows",
            do="record one, or calibrate without gsens",
        )
    force = recording.sensor(triads[0])
    known = ~np.isnan(force.values).any(axis=1)
    along = [np.interp(time, force.time[known], force.values[known, i]) for i in range(3)]
    return np.asarray(np.column_stack(along) @ G.T)


def _unit(written: str, sensor: Sensor) -> str:
    """The unit of the reading, or SI where it was raw."""
    known = COLUMN_UNITS[written].quantity
    return (
        written
        if known != "raw"
        else {"acceleration": "m_s2", "angle": "deg", "rate": "rad_s"}[sensor.quantity]
    )


def _full(values: Array, rows: "np.ndarray[tuple[int], np.dtype[np.intp]]", n: int) -> Array:
    full = np.full(n, np.nan)
    full[rows] = values
    return full


@dataclass
class Corrected:
    """What came of a stream: rows written, and readings of each axis left empty because its table
    does not hold there.
    """

    rows: int = 0
    beyond: dict[str, int] = field(default_factory=dict)

    def count(self, chunk: Recording, added: dict[str, Array], calibration: Calibration) -> None:
        """Add a chunk."""
        self.rows += len(chunk)
        for key in calibration.bias_tables:
            name, _, axis = key.partition(".")
            sampled = np.isfinite(chunk.column(str(chunk.channel(f"{name}_{axis}"))))
            column = next(c for c in added if c.startswith(f"{name}_{axis}_corrected_"))
            self.beyond[key] = self.beyond.get(key, 0) + int(
                np.sum(sampled & np.isnan(added[column]))
            )

    @property
    def notes(self) -> list[str]:
        """What the user should know."""
        return [
            f"{n} readings of {key} at placing angles that its table does not hold are left empty"
            for key, n in self.beyond.items()
            if n
        ]


def correct_stream(path: Path, calibration: Calibration, out: IO[bytes]) -> Corrected:
    """Read a recording chunk by chunk and write it corrected as CSV.

    Raises:
        TiltcalError: the recording does not read, or lacks the calibrated sensor.
    """
    import pyarrow as pa
    from pyarrow import csv as pacsv

    setup = setup_of(calibration)
    done, last = Corrected(), -np.inf
    writer, names = None, []
    for chunk in _chunks(path):
        last = _require_onward(chunk, last)
        added = corrected_columns(chunk, calibration, setup)
        columns = _columns(chunk, added)
        if writer is None:
            names = list(columns)
            write_head(out, chunk.metadata, names)
            schema = pa.schema([(name, column.type) for name, column in columns.items()])
            writer = pacsv.CSVWriter(
                out, schema, write_options=pacsv.WriteOptions(include_header=False)
            )
        # gaps may order a chunk otherwise
        writer.write_table(pa.table([columns[name] for name in names], names=names))
        done.count(chunk, added, calibration)
    if writer is not None:
        writer.close()
    return done


def _require_onward(chunk: Recording, last: float) -> float:
    """The last stamp of a chunk, when time runs forward in it and from the stamp before it."""
    chunk.require_increasing()
    if chunk.time[0] <= last:
        raise TiltcalError(
            f"{chunk.source}, time {chunk.time[0]:.10g} s",
            found="time going back or a repeated stamp",
            need="time stamps that increase",
            do="sort it or split it there",
        )
    return float(chunk.time[-1])


def _columns(chunk: Recording, added: dict[str, Array]) -> dict[str, Any]:
    """All columns of a chunk and those added, as Arrow arrays."""
    import pyarrow as pa

    numbers = (
        {"time_s": chunk.time} | {name: chunk.column(name) for name in chunk.column_names} | added
    )
    texts = dict(chunk.extra) | ({} if chunk.labels is None else {"label": chunk.labels})
    arrays: dict[str, Any] = {
        name: pa.array(v, pa.float64(), from_pandas=True) for name, v in numbers.items()
    }
    return arrays | {
        name: pa.array([t or None for t in v], pa.string()) for name, v in texts.items()
    }


def _chunks(path: Path) -> Iterator[Recording]:
    """The recording in pieces: CSV by blocks of text, Parquet by row groups, NPZ whole."""
    path = require_file(path, "recording")
    if path.suffix == ".parquet" and path.stat().st_size > CHUNK:
        yield from _parquet_chunks(path)
    elif path.suffix == ".csv" and path.stat().st_size > CHUNK:
        yield from _csv_chunks(path)
    else:
        yield read_recording(path)


def _csv_chunks(path: Path) -> Iterator[Recording]:
    import pyarrow as pa
    from pyarrow import csv as pacsv

    metadata, names, skip = csv_head(path)
    types = {name: pa.float64() if is_number(name) else pa.string() for name in names}
    try:
        reader = pacsv.open_csv(
            path,
            read_options=pacsv.ReadOptions(
                skip_rows=skip, column_names=names, block_size=CHUNK, use_threads=False
            ),
            convert_options=pacsv.ConvertOptions(
                column_types=types, null_values=[""], strings_can_be_null=True
            ),
        )
        yield from _batches(reader, names, metadata, path.name)
    except pa.ArrowInvalid:
        read_recording(path)  # names the bad line
        raise


def _parquet_chunks(path: Path) -> Iterator[Recording]:
    import pyarrow as pa
    from pyarrow import parquet

    try:
        head = read_recording_head(path)
        with parquet.ParquetFile(path) as file:
            yield from _batches(
                file.iter_batches(batch_size=65536), file.schema_arrow.names, head, path.name
            )
    except (pa.ArrowException, ValueError):
        read_recording(path)  # names what is wrong
        raise


def read_recording_head(path: Path) -> dict[str, str]:
    """Metadata of a Parquet recording."""
    import json

    from pyarrow import parquet

    stored = (parquet.read_schema(path).metadata or {}).get(b"tiltcal.metadata")
    return json.loads(stored) if stored else {}


def _batches(
    batches: Iterable[Any], names: list[str], metadata: dict[str, str], source: str
) -> Iterator[Recording]:
    for batch in batches:
        if batch.num_rows == 0:
            continue
        columns = {}
        for i, name in enumerate(names):
            values = batch.column(i).to_numpy(zero_copy_only=False)
            columns[name] = np.array(values, dtype=float if is_number(name) else object)
        yield assemble(columns, metadata, source)
