"""LabVIEW TDMS files, by the library nptdms."""

import logging
from dataclasses import replace
from pathlib import Path
from typing import Any

from tiltcal.core.optional_library import library
from tiltcal.recordings.formats.budget import ReadBudget
from tiltcal.recordings.formats.raw_table import DAMAGED, Raw, RawFile, RawTable, by_length, vectors

TIME = "waveform time"
"""Name of the column of times that follow from ``wf_increment``, s."""
_UNIT_KEYS = ("unit_string", "NI_UnitDescription", "unit", "units")
_CELL = 8  # bytes of a value


def read_tdms(path: Path, budget: ReadBudget) -> RawFile:
    """One table a group; channels of a waveform bring their times.

    Raises:
        TiltcalError: the library is missing, or there is no channel of numbers.
    """
    nptdms = library("nptdms", "tdms", "TDMS files")
    library("nptdms.log", "tdms", "TDMS files").log_manager.set_level(logging.ERROR)
    tables: list[RawTable] = []
    with path.open("rb") as raw, nptdms.TdmsFile.open(raw) as file:
        channels = [c for group in file.groups() for c in group.channels()]
        budget.require(_CELL * float(sum(len(c) for c in channels)), path.name)
        for group in file.groups():
            tables += _tables(group, path.name)
        cut = file.file_status.incomplete_final_segment
    if not tables:
        by_length((), {}, path.name)  # raises the error of the missing library
    if cut and tables:
        metadata = {**tables[0].metadata, DAMAGED: "its last segment is not whole"}
        tables[0] = replace(tables[0], metadata=metadata)
    return RawFile(path.name, "TDMS", tuple(tables))


def _tables(group: Any, source: str) -> tuple[RawTable, ...]:
    columns: list[tuple[str, Raw]] = []
    units: dict[str, str] = {}
    for channel in group.channels():
        columns += vectors(channel.name, channel[:])
        stated = next((channel.properties[k] for k in _UNIT_KEYS if k in channel.properties), "")
        if stated:
            units[channel.name] = str(stated)
    first = next((c for c in group.channels() if c.properties.get("wf_increment")), None)
    if first is not None:
        columns.insert(0, (TIME, first.time_track()))
        units[TIME] = "s"
    if not any(len(values) > 1 for _, values in columns):
        return ()
    return by_length(columns, units, source, group.name)
