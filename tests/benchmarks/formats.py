"""Seconds to import a million rows of eight columns from text and from Parquet, and how many
variants of a log are proposed right.
"""

import sys
import tempfile
import time
from collections import Counter
from pathlib import Path

import numpy as np
import pyarrow as pa
from pyarrow import csv, parquet

from tests.benchmarks import sized

ROWS = sized(1_000_000, 1000)
LIMITS = {"a.csv": 1.0, "a.parquet": 0.2}
NAMES = ("t", "ax", "ay", "az", "gx", "gy", "gz", "temperature")
CHANNELS = (
    *(f"accel_{a}_m_s2" for a in "xyz"),
    *(f"gyro_{a}_deg_s" for a in "xyz"),
    "temperature_degC",
)


def main() -> None:
    """Five runs each; medians, the checks of the data included."""
    from tiltcal.recordings.foreign_files import import_recording
    from tiltcal.recordings.mapping import parse_mapping
    from tiltcal.recordings.proposal.propose import propose_mapping

    text = '[time]\ncolumn = "t"\n' + "".join(
        f'[[column]]\nfrom = "{a}"\nto = "{b}"\n' for a, b in zip(NAMES[1:], CHANNELS, strict=True)
    )
    mapping = parse_mapping(text, "mapping")
    with tempfile.TemporaryDirectory() as name:
        place = Path(name)
        write(place)
        for file, limit in LIMITS.items():
            seconds = []
            for _ in range(5):
                begin = time.perf_counter()
                recording = import_recording(place / file, mapping)
                seconds.append(time.perf_counter() - begin)
            size = (place / file).stat().st_size / 1e6
            print(
                f"import {file}, {len(recording)} rows x {len(NAMES)} columns, {size:.0f} MB:"
                f" {np.median(seconds):.2f} s (limit {limit:g})"
            )
        begin = time.perf_counter()
        propose_mapping(place / "a.csv")
        print(f"propose a mapping of it: {time.perf_counter() - begin:.2f} s")
        count = proposals(place / "log.txt")
        print(f"proposals, items of {count.pop('logs')} logs: {dict(count)} (limit: none wrong)")


def write(place: Path) -> None:
    """The same noise as CSV with six decimals, and as Parquet."""
    rng = np.random.default_rng(1)
    values = [np.arange(ROWS) / 100, *rng.normal(size=(3, ROWS)), *rng.normal(size=(3, ROWS))]
    values.append(25 + rng.normal(size=ROWS))
    values[3] += 9.81
    table = pa.table([v.round(6) for v in values], names=list(NAMES))
    csv.write_csv(table, place / "a.csv")
    parquet.write_table(table, place / "a.parquet")


def proposals(path: Path) -> Counter[str]:
    """How the items of all variants of a log are proposed."""
    sys.path.insert(0, str(Path(__file__).parents[1]))
    from foreign_logs import VARIANTS, score

    from tiltcal.recordings.proposal.propose import propose_mapping

    found = Counter({"logs": sized(len(VARIANTS), 2)})
    for log in list(VARIANTS.values())[: sized(None, 2)]:
        found.update(how for _, how in score(log, propose_mapping(log.write(path)).toml()))
    return found
