"""The checks of a log as tests of a calibration."""

from collections.abc import Sequence

import numpy as np

from tiltcal.calibration.validity import Test, threshold_test
from tiltcal.core.arrays import Mask
from tiltcal.core.errors import TiltcalError
from tiltcal.data_quality.check import Finding
from tiltcal.data_quality.registry import BY_NAME, CHECKS
from tiltcal.recordings.means_table import MeansTable
from tiltcal.recordings.quality import inspect_recording
from tiltcal.recordings.recording import Recording
from tiltcal.recordings.segmentation import find_segments
from tiltcal.setup.sensor import Sensor

GUESSES = ("cause", "unit", "columns as named", "second order")
"""Beginnings of the names of tests that infer what is wrong with the readings from a fit."""
OF_TABLE = ("wrap",)
"""Checks of the readout: a calibration reads an angle with or without its whole turns."""
OF_MEANS = ("dead", "equal_columns")
"""Checks that say something of a table of means."""


def data_tests(
    recording: Recording,
    *sensors: Sensor,
    axes: Sequence[str] | None = None,
    temperature: bool = False,
) -> list[Test]:
    """What the checks find in the readings of these sensors, a test each: it fails where the
    readings are used and the fault spoils them.

    Of an accelerometer or an inclinometer the readings at standstill are used, of a rate sensor
    all.

    Args:
        recording: with the sensors.
        sensors: their readings are used.
        axes: of the channels that are used; all unless given.
        temperature: whether the temperature is used as well.

    Raises:
        TiltcalError: a channel that is used is saturated.
    """
    found = findings_of(recording, sensors)
    at_rest = _used_rows(recording, found)
    tests = []
    for finding in found:
        check, owner = BY_NAME[finding.kind], _owner(finding, recording, sensors)
        channels = [c for s, c in _columns(recording, sensors, axes) if s is owner]
        used = owner is not None and any(c in channels for c in finding.columns)
        if owner is not None and owner.is_accelerometer:
            used = used and bool(at_rest[finding.rows].any())
        used = used or (temperature and finding.column.startswith("temperature_"))
        if used and check.answer == "refused":
            raise TiltcalError(
                recording.source,
                found=finding.statement,
                need="readings within its range",
                do="lower the gain, level the base or turn slower, and record again",
            )
        of = owner.name if owner is not None else finding.column.rpartition("_")[0]
        passed = not used or check.answer == "note"
        name = f"{of} {check.test}"
        tests.append(threshold_test(name, finding.count, passed, finding.statement))
    names = ", ".join(s.name for s in sensors)
    if all(t.passed for t in tests):
        text = f"{len(CHECKS)} checks found no fault in what is used of {names}"
        tests.insert(0, threshold_test(f"data of {names}", 0, True, text))
    return tests


def without_causes(tests: Sequence[Test]) -> list[Test]:
    """The tests without those that guess a cause where the readings themselves are at fault: that
    is the cause.
    """
    of_data = tuple(f" {check.test}" for check in CHECKS)
    if all(t.passed or not t.name.endswith(of_data) for t in tests):
        return list(tests)
    return [t for t in tests if t.passed or not t.name.startswith(GUESSES)]


def findings_of(recording: Recording, sensors: Sequence[Sensor]) -> list[Finding]:
    """What the checks find in the readings of these sensors, the stamps and the temperature."""
    there = [s for s in sensors if recording.has(s)]
    if isinstance(recording, MeansTable):
        every = inspect_recording(recording, there).findings
        return [f for f in every if f.kind in OF_MEANS]
    return [f for f in inspect_recording(recording, there).findings if f.kind not in OF_TABLE]


def _columns(
    recording: Recording, sensors: Sequence[Sensor], axes: Sequence[str] | None
) -> list[tuple[Sensor, str]]:
    """Sensor and column of each channel that is used."""
    return [
        (s, str(recording.channel(f"{s.name}_{axis}")))
        for s in sensors
        for axis in s.axes
        if axes is None or axis in axes
    ]


def _owner(finding: Finding, recording: Recording, sensors: Sequence[Sensor]) -> Sensor | None:
    """The sensor that a finding is about."""
    return next((s for s, c in _columns(recording, sensors, None) if c in finding.columns), None)


def _used_rows(recording: Recording, findings: Sequence[Finding]) -> Mask:
    """Rows at standstill, (n,); all where there is nothing to be judged by them, or no dwell."""
    everywhere = np.ones(len(recording.time), bool)
    if all(BY_NAME[f.kind].answer == "note" for f in findings):
        return everywhere
    try:
        dwells = [s for s in find_segments(recording) if s.kind == "dwell"]
    except TiltcalError:
        return everywhere
    at_rest = np.zeros(len(recording.time), bool)
    for s in dwells:
        at_rest[s.first : s.last] = True
    return at_rest if at_rest.any() else everywhere
