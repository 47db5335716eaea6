"""The on-line corrector: speed in blocks, sample by sample and as exported C; memory over a day;
look-up errors.
"""

import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

from tests.benchmarks import sized
from tiltcal.core.units import ARCSEC, DEG, G0
from tiltcal.instrument.placing import LOOKUPS, BiasTable, PlacingCorrector

G, DAY, RATE = 9.80123, sized(86_400, 7200), 50
SAMPLES = sized(1_000_000, 10_000)


def wave(n: int) -> BiasTable:
    """1 mg cos(n beta) every degree."""
    terms = [0.0] * (2 * n + 1)
    terms[2 * n - 1] = 1e-3 * G0
    return BiasTable(
        0.0, DEG, 1e-3 * G0 * np.cos(n * np.arange(91) * DEG), np.zeros(91), tuple(terms)
    )


def forces(n: int) -> np.ndarray:
    """A level that swings inside its tables, (n, 2)."""
    t = np.arange(n) / RATE
    return np.column_stack([-2.5 + 2 * np.sin(t / 7), 2.5 + 2 * np.cos(t / 11)])


def day() -> dict[str, float]:
    """A day at 50 Hz sample by sample: peak RSS after one hour and after the day, MiB."""
    import resource

    peak = lambda: resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024  # noqa: E731
    corrector, hour = (
        PlacingCorrector({"x": wave(2), "y": wave(3)}, G),
        forces(3600 * RATE).tolist(),
    )
    for row in hour:
        corrector.update(row)
    first = peak()
    for _ in range(DAY // 3600 - 1):
        for row in hour:
            corrector.update(row)
    return {"hour_MiB": first, "day_MiB": peak()}


def exported() -> str:
    """Nanoseconds a sample of the C header at -O2."""
    sys.path.insert(0, str(Path(__file__).resolve().parents[1]))
    import host
    from test_c_export import SETUP, calibration

    from tiltcal.calibration.firmware.header import header

    if host.compiler() is None:
        return "no C compiler"
    f = np.column_stack([forces(SAMPLES), np.full(SAMPLES, np.nan)])
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "level.h"
        path.write_text(header(calibration(), SETUP, "level"))
        program = host.build(path)
        found = {w: host.run(program, w, f)[1] for w in ("correct", "tilt")}
        found["integer"] = host.run(program, "integer", np.round(f * 1e6))[1]
    return ", ".join(f"{what} {ns:.0f} ns" for what, ns in found.items())


def main() -> None:
    """All of it."""
    beta = np.linspace(0, 90, 90_001) * DEG
    for look in LOOKUPS:
        errors = [
            np.abs(wave(n).at(beta, look) - 1e-3 * G0 * np.cos(n * beta)).max() / G0 / ARCSEC
            for n in (1, 2, 4, 8)
        ]
        print(
            f"1 mg cos(n beta) at 1 deg, {look}: "
            + ", ".join(f"{e:.3g}" for e in errors)
            + " arcsec for n = 1, 2, 4, 8"
        )
    for look in LOOKUPS:
        corrector = PlacingCorrector({"x": wave(2), "y": wave(3)}, G, look)
        block, rows = forces(2 * SAMPLES), forces(SAMPLES // 5).tolist()
        start = time.process_time()
        corrector.tilt(block)
        fast = len(block) / (time.process_time() - start)
        start = time.process_time()
        for row in rows:
            corrector.update(row)
        alone = (time.process_time() - start) / len(rows)
        print(
            f"corrector, {look}: {fast / 1e6:.1f} million samples/s in blocks (>= 2),"
            f" {alone * 1e6:.2f} us alone (<= 5)"
        )
    print(f"exported C at -O2, two channels (<= 100): {exported()}")
    code = "import json; from tests.benchmarks.placing import day; print(json.dumps(day()))"
    found = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True
    ).stdout
    print(
        f"{DAY // 3600} h at {RATE} Hz sample by sample, peak RSS after an hour and after the day:"
        f" {found.strip()}"
    )
