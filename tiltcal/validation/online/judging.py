"""Running an estimator over a recording sample by sample, and its tilt error by section of the
motion. A program may be the estimator: one line a sample on its standard input, one line a tilt
on its standard output.
"""

import os
import select
import subprocess
import time
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from tiltcal.calibration.methods.registry import calibrate
from tiltcal.calibration.result import Calibration
from tiltcal.core.arrays import Array
from tiltcal.core.errors import TiltcalError
from tiltcal.core.frames import angle_between
from tiltcal.core.units import ARCSEC
from tiltcal.laboratory.laboratory import Laboratory, TruthfulLaboratory
from tiltcal.laboratory.scenario import Scenario
from tiltcal.laboratory.scenario_tables import AcceptOnline, EstimatorTable
from tiltcal.recordings.recording import Recording
from tiltcal.setup.setup import Setup
from tiltcal.validation.online.estimators import Estimator, Sample, make_estimator

PATIENCE = 10.0  # s for one answer


class Process:
    """Feeds ``time_s,<readings of each sensor in SI, in the scenario's order>`` and reads
    ``tilt_x,tilt_y``, rad.

    Cells of a sensor that was not sampled are empty. The next sample is written only after the
    answer to the last: a program cannot look ahead, and has to flush every line.

    Args:
        command: program and arguments; no shell.
        setup: set-up with the sensors that are read.

    Raises:
        TiltcalError: it does not start, ends early, does not answer in time, or answers with
            something else.
    """

    def __init__(self, command: Sequence[str], setup: Setup) -> None:
        self.name, self.remainder = command[0], b""
        self.sensors = [(s.name, len(s.axes)) for s in setup.sensor]
        try:
            self.process = subprocess.Popen(
                list(command), stdin=subprocess.PIPE, stdout=subprocess.PIPE, bufsize=0
            )
        except OSError as error:
            raise TiltcalError(
                f"command {self.name}",
                found=str(error),
                need="a program that runs",
                do="check the path",
            ) from error

    def update(self, sample: Mapping[str, Any]) -> tuple[float, float]:
        """Tilt of x and y, rad."""
        cells = [repr(float(sample["time_s"]))]
        for name, axes in self.sensors:
            cells += [repr(float(v)) for v in sample[name]] if name in sample else [""] * axes
        pipe = self.process.stdin
        try:
            if pipe is not None:
                pipe.write((",".join(cells) + "\n").encode())
        except OSError:
            raise self._broken("a program that has ended") from None
        line = self._line()
        try:
            x, y = (float(cell) for cell in line.split(","))
        except ValueError:
            raise self._broken(f"the answer '{line[:60]}'") from None
        return x, y

    def _line(self) -> str:
        """The next line of its output."""
        assert self.process.stdout is not None
        fd, end = self.process.stdout.fileno(), time.monotonic() + PATIENCE
        while b"\n" not in self.remainder:
            ready, _, _ = select.select([fd], [], [], max(end - time.monotonic(), 0.0))
            if not ready:
                raise self._broken(f"no answer within {PATIENCE:g} s")
            more = os.read(fd, 65536)
            if not more:
                raise self._broken("a program that has ended")
            self.remainder += more
        line, _, self.remainder = self.remainder.partition(b"\n")
        return line.decode(errors="replace").strip()

    def _broken(self, found: str) -> TiltcalError:
        self.close()
        return TiltcalError(
            f"command {self.name}",
            found=found,
            need="a line 'tilt_x,tilt_y' in rad for every sample",
            do="flush standard output after each line",
        )

    def close(self) -> None:
        """End the program."""
        for pipe in (self.process.stdin, self.process.stdout):
            if pipe is not None:
                pipe.close()
        try:
            self.process.wait(timeout=1.0)
        except subprocess.TimeoutExpired:
            self.process.kill()
            self.process.wait()


@dataclass(frozen=True)
class Section:
    """A section of the motion: a standstill, a move or a swing.

    Args:
        kind: rest, move or swing.
        start, end: s.
        rms, worst: tilt error over its answered samples, rad.
    """

    kind: str
    start: float
    end: float
    rms: float
    worst: float

    def to_json(self) -> dict[str, Any]:
        """For machines."""
        return {
            "kind": self.kind,
            "start_s": self.start,
            "end_s": self.end,
            "rms_arcsec": self.rms / ARCSEC,
            "worst_arcsec": self.worst / ARCSEC,
        }


@dataclass(frozen=True)
class OnlineResult:
    """An estimator's tilt error.

    Args:
        time: s, (n,).
        error: angle between the true and the estimated up, rad, (n,), NaN where it gave no answer.
        sections: sections of the motion, in order.
        kinds: kind of the section of each sample, (n,).
        seconds: mean computing time of a sample, s.
    """

    time: Array
    error: Array
    sections: tuple[Section, ...]
    kinds: npt.NDArray[np.str_]
    seconds: float

    @property
    def answered(self) -> float:
        """Share of samples with an answer."""
        return float(np.mean(~np.isnan(self.error)))

    def rms(self, *kinds: str) -> float:
        """Root mean square error, rad, over samples of some kinds; of all when none is named."""
        chosen = self.error[np.isin(self.kinds, kinds)] if kinds else self.error
        chosen = chosen[~np.isnan(chosen)]
        return float(np.sqrt(np.mean(chosen**2))) if len(chosen) else float("nan")

    @property
    def worst(self) -> float:
        """Largest error, rad."""
        return float(np.nanmax(self.error)) if self.answered else float("nan")

    def settling(self, band: float) -> float:
        """Longest time from the end of a move until the error stays within a band (rad) for the
        remainder of the dwell, s.
        """
        longest = 0.0
        for before, s in zip(self.sections[:-1], self.sections[1:], strict=True):
            if s.kind == "rest" and before.kind != "rest":
                inside = (self.time >= s.start) & (self.time < s.end)
                outside = np.flatnonzero(~(self.error[inside] <= band))
                if len(outside):
                    longest = max(longest, float(self.time[inside][outside[-1]] - s.start))
        return longest

    def limits(self, accept: AcceptOnline) -> Iterator[tuple[str, float, str, bool]]:
        """Name, reached, allowed and whether it is met, of each limit."""
        yield (
            "samples answered",
            self.answered,
            f">= {accept.answered:g}",
            self.answered >= accept.answered,
        )
        reached = {
            "tilt error, arcsec rms": (self.rms() / ARCSEC, accept.rms_arcsec),
            "tilt error, arcsec worst": (self.worst / ARCSEC, accept.worst_arcsec),
            "tilt error at rest, arcsec rms": (self.rms("rest") / ARCSEC, accept.rest_arcsec),
            "tilt error in motion, arcsec rms": (
                self.rms("move", "swing") / ARCSEC,
                accept.moving_arcsec,
            ),
            f"settling to {accept.settled_arcsec:g} arcsec, s": (
                self.settling(accept.settled_arcsec * ARCSEC),
                accept.settling_s,
            ),
            "time a sample, us": (self.seconds * 1e6, accept.sample_us),
        }
        for name, (value, allowed) in reached.items():
            if allowed is not None:
                yield name, value, f"<= {allowed:g}", bool(value <= allowed)

    @property
    def statement(self) -> str:
        """As text."""
        parts = ", ".join(
            f"{k} {self.rms(k) / ARCSEC:.4g}"
            for k in ("rest", "move", "swing")
            if np.any(self.kinds == k)
        )
        return (
            f"tilt error {self.rms() / ARCSEC:.4g} arcsec rms ({parts}), {self.worst / ARCSEC:.4g}"
            f" worst, over {len(self.time)} samples, {100 * self.answered:.4g} % answered;"
            f" {self.seconds * 1e6:.3g} us a sample"
        )

    def to_json(self) -> dict[str, Any]:
        """For machines."""
        return {
            "samples": len(self.time),
            "answered": self.answered,
            "rms_arcsec": self.rms() / ARCSEC,
            "worst_arcsec": self.worst / ARCSEC,
            "sample_us": self.seconds * 1e6,
            "sections": [section.to_json() for section in self.sections],
        }


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
    """Tilt error of each sample and section.

    Args:
        stamps: times of the answers, s.
        tilt: (n, 2), rad.
        up: true, (n, 3).
        scenario: scenario of the motion.
        seconds: computing time, s.
    """
    sine = np.sin(tilt)
    third = np.sqrt(np.maximum(1 - (sine**2).sum(axis=1), 0.0)) * np.where(up[:, 2] < 0, -1.0, 1.0)
    error = angle_between(np.column_stack([sine, third]), up)
    legs = scenario.schedule.legs
    which = scenario.schedule.leg_of(stamps)
    kinds = np.array([KINDS[leg.profile] for leg in legs])
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
