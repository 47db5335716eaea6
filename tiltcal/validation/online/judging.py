"""Running an estimator over a recording sample by sample, and its tilt error by section of the
motion.
"""

import os
import time
from collections.abc import Iterable, Iterator
from typing import Any

import numpy as np

from tiltcal.calibration.methods.registry import calibrate
from tiltcal.calibration.result import Calibration
from tiltcal.core.arrays import Array
from tiltcal.core.errors import TiltcalError
from tiltcal.core.frames import angle_between
from tiltcal.laboratory.laboratory import Laboratory, TruthfulLaboratory
from tiltcal.laboratory.scenario import Scenario
from tiltcal.laboratory.scenario_tables import EstimatorTable
from tiltcal.recordings.recording import Recording
from tiltcal.validation.online.estimators import Estimator, Sample, make_estimator
from tiltcal.validation.online.online_result import OnlineResult, Section
from tiltcal.validation.online.process import Process

CHUNK = 4096  # samples made ready at a time
KINDS = {"rest": "rest", "ramp": "move", "swing": "swing"}


def run_estimator(
    scenario: Scenario, table: EstimatorTable, recording: Recording, laboratory: Laboratory
) -> OnlineResult:
    """Feed a recording to an estimator and judge its tilt against the laboratory's truth.

    Raises:
        TiltcalError: the laboratory knows no truth, nothing is left to judge, or the estimator
            fails.
    """
    if not isinstance(laboratory, TruthfulLaboratory):
        raise TiltcalError(
            f"estimator {table.title}",
            found="a laboratory without truth",
            need="a simulated one",
            do="simulate it",
        )
    live = recording.time >= recording.time[0] + table.from_s
    if not live.any():
        raise TiltcalError(
            f"estimator {table.title}",
            found=f"from_s = {table.from_s:g} beyond the recording",
            need="samples to judge",
            do=f"choose less than {np.ptp(recording.time):.6g} s",
        )
    found = None
    if table.calibrate is not None:
        options = table.calibrate_options
        found = calibrate(table.calibrate, part_of(recording, ~live), scenario, **options)
    estimator = _made(table, scenario, found)
    try:
        tilt, seconds = feed(estimator, samples_of(part_of(recording, live), scenario), table.title)
    finally:
        getattr(estimator, "close", lambda: None)()
    stamps = recording.time[live]
    return judge(
        stamps, tilt, laboratory.true_up(scenario, scenario.seed, stamps), scenario, seconds
    )


def _made(table: EstimatorTable, scenario: Scenario, found: Calibration | None) -> Estimator:
    if table.command is not None:
        return Process(table.command, scenario)
    return make_estimator(str(table.name), scenario, found, table.options)


def part_of(recording: Recording, rows: "np.ndarray[tuple[int], np.dtype[np.bool_]]") -> Recording:
    """Some rows of a recording.

    Raises:
        TiltcalError: there are none.
    """
    if not rows.any():
        raise TiltcalError(
            recording.source,
            found="no sample before from_s",
            need="some to calibrate on",
            do="raise from_s",
        )
    labels = None if recording.labels is None else recording.labels[rows]
    columns = {n: recording.column(n)[rows] for n in recording.column_names}
    return Recording.from_columns(
        recording.time[rows],
        columns,
        labels=labels,
        metadata=recording.metadata,
        source=recording.source,
    )


def samples_of(recording: Recording, scenario: Scenario) -> Iterator[list[Sample]]:
    """The samples of a recording in SI, in lists of some thousand; a sensor that was not sampled
    then is left out.
    """
    sensed = []
    for sensor in scenario.sensor:
        samples = recording.sensor(sensor)
        full = np.full((len(recording), len(sensor.axes)), np.nan)
        full[samples.rows] = samples.values
        sensed.append((sensor.name, full))
    for start in range(0, len(recording), CHUNK):
        part = slice(start, start + CHUNK)
        chunk: list[Sample] = [{"time_s": t} for t in recording.time[part].tolist()]
        for name, values in sensed:
            taken = ~np.isnan(values[part]).all(axis=1)
            for sample, value, known in zip(
                chunk, map(tuple, values[part].tolist()), taken.tolist(), strict=True
            ):
                if known:
                    sample[name] = value  # type: ignore[index]
        yield chunk


def feed(
    estimator: Estimator, chunks: Iterable[list[Sample]], title: str, numbers: int = 2
) -> tuple[Array, float]:
    """All answers, (n, numbers), and the mean time a sample, s.

    Args:
        estimator: that is fed.
        title: its name in messages.
        chunks: of samples.
        numbers: in an answer: tilt_x and tilt_y in rad unless the estimator names other columns.

    Raises:
        TiltcalError: it fails, or answers with something else than so many numbers.
    """
    answers: list[Any] = []
    took = 0.0
    try:
        for chunk in chunks:
            start = time.perf_counter()
            answers += [estimator.update(sample) for sample in chunk]
            took += time.perf_counter() - start
        tilt = np.array(answers, dtype=float)
    except TiltcalError:
        raise
    except Exception as error:
        if os.environ.get("TILTCAL_TRACEBACK"):
            raise
        raise TiltcalError(
            f"estimator {title}, sample {len(answers) + 1}",
            found=f"an error in it ({type(error).__name__}: {error})",
            need="update(sample) -> (tilt_x, tilt_y)",
            do="mend it; TILTCAL_TRACEBACK=1 shows where",
        ) from error
    if tilt.ndim != 2 or tilt.shape[1] != numbers:
        raise TiltcalError(
            f"estimator {title}",
            found=f"answers of shape {tilt.shape[1:]}",
            need="two numbers, tilt_x and tilt_y in rad" if numbers == 2 else f"{numbers} numbers",
            do="return (tilt_x, tilt_y)" if numbers == 2 else "return them as a tuple",
        )
    return tilt, took / len(tilt)


def judge(
    stamps: Array, tilt: Array, up: Array, scenario: Scenario, seconds: float
) -> OnlineResult:
    """Tilt error of each sample and section. tilt: (n, 2), rad; up: true, (n, 3)."""
    sine = np.sin(tilt)
    third = np.sqrt(np.maximum(1 - (sine**2).sum(axis=1), 0.0)) * np.where(up[:, 2] < 0, -1.0, 1.0)
    error = angle_between(np.column_stack([sine, third]), up)
    legs = scenario.schedule.legs
    which = scenario.schedule.leg_of(stamps)
    kinds = np.array([KINDS[leg.law] for leg in legs])
    sections = []
    for k in np.unique(which):
        e = error[which == k]
        e = e[~np.isnan(e)]
        rms = worst = float("nan")
        if len(e):
            rms, worst = float(np.sqrt(np.mean(e**2))), float(e.max())
        start = max(legs[k].t0, float(stamps[0]))
        sections.append(Section(str(kinds[k]), start, legs[k].t1, rms, worst))
    return OnlineResult(stamps, error, tuple(sections), kinds[which], seconds)
