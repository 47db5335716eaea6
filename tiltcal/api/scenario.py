"""A scenario with what can be done with it: simulate, calibrate, certify, check, diagnose,
design.
"""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from tiltcal.api.calibrating import estimate, estimate_for_certificate, judged, one_recording
from tiltcal.api.certifying import Certificate, certificate_of
from tiltcal.api.designing import DesignedSequence, designed_for_goals
from tiltcal.api.diagnosing import Diagnosis, explain, require_no_truth
from tiltcal.api.simulating import seed_used, simulator, truth_table
from tiltcal.calibration.correction import correct_pieces
from tiltcal.calibration.methods.registry import Method
from tiltcal.calibration.result import Calibration
from tiltcal.core.progress import Progress, silent
from tiltcal.core.units import DEG, G0
from tiltcal.design.gradient_search import Problem
from tiltcal.design.scenario_problem import clock_of, scenario_problem, sensor_of
from tiltcal.design.terms import Wanted
from tiltcal.laboratory import scenario as laboratory
from tiltcal.laboratory.scenario import load_as, parse_as
from tiltcal.recordings.recording import Recording
from tiltcal.recordings.segment_files import read_segments
from tiltcal.recordings.segmentation import Segment
from tiltcal.report.stated import Stated
from tiltcal.validation.cross_check import Check, Limits

Recordings = Recording | Sequence[Recording]
Dwells = Sequence[Segment] | Path | str


class Scenario(laboratory.Scenario):
    """Site, table, sensors and effects, and the operations of the command line on them."""

    def simulate(
        self, *, seed: int | None = None, noise: bool = True, progress: Progress = silent
    ) -> Recording:
        """A recording of its sequence, made in MuJoCo.

        Args:
            seed: of the random effects; the scenario's if not given.
            noise: False: without random effects and quantisation.
            progress: receives what is being done.

        Raises:
            TiltcalError: there is no sequence or no sensor.
        """
        return simulator(progress).record(self, seed_used(self, noise, seed))

    def predict(self, motion: Recording, *, progress: Progress = silent) -> Recording:
        """What another recording should have read by the model, without noise.

        Args:
            motion: recording with the time stamps and the table readout.
            progress: receives what is being done.
        """
        return simulator(progress).predict(self, motion)

    def truth(self, *, seed: int | None = None) -> dict[str, object]:
        """The injected effects, and the true attitude of each stop."""
        return truth_table(self, seed_used(self, True, seed))

    def calibrate(
        self,
        recordings: Recordings,
        method: str | Method,
        *,
        segments: Dwells | None = None,
        **options: Any,
    ) -> Calibration:
        """Parameters with covariance, tests and a verdict.

        Args:
            recordings: one, or several of the same set-up.
            method: its name as in ``tiltcal methods``, or a function of your own.
            segments: dwells, or the file of them; found in the recording if not given.
            options: of the method.

        Raises:
            TiltcalError: the recording does not have what the method needs.
        """
        recording = one_recording(self, _several(recordings))
        return estimate(method, recording, self, options | _dwells(segments, recording))[0]

    def certify(
        self,
        recordings: Recordings,
        method: str | Method,
        stated: Stated | None = None,
        *,
        segments: Dwells | None = None,
        **options: Any,
    ) -> Certificate:
        """A calibration with its uncertainty budget, as a certificate.

        Args:
            recordings: one, or several of the same set-up.
            method: as in ``calibrate``.
            stated: what only the laboratory knows: instrument, customer, day ...
            segments: as in ``calibrate``.
            options: of the method.

        Raises:
            TiltcalError: the recording does not have what the method needs.
        """
        recording = one_recording(self, _several(recordings))
        options |= _dwells(segments, recording)
        calibration, budget = estimate_for_certificate(method, recording, self, options)
        dwells = options.get("segments")
        return certificate_of(calibration, stated or Stated(), recording, budget, dwells)

    def check(
        self,
        calibration: Calibration,
        recording: Recording,
        *,
        limit_arcsec: float | None = None,
        limit_ug: float | None = None,
        limit_ppm: float | None = None,
        limit_deg_h: float | None = None,
        segments: Dwells | None = None,
    ) -> Check:
        """Whether a calibration is good on another recording.

        Args:
            calibration: to judge.
            recording: that it has not seen.
            limit_arcsec: largest accepted rms error of the tilt; without any limit every
                difference has to agree with its own uncertainty.
            limit_ug: of the reading of an accelerometer.
            limit_ppm: of the norm of the force.
            limit_deg_h: of the reading of a rate sensor.
            segments: as in ``calibrate``.

        Raises:
            TiltcalError: the recording lacks the calibrated sensor.
        """
        dwells = _dwells(segments, recording).get("segments")
        limits = Limits.of(limit_arcsec, limit_ug, limit_ppm, limit_deg_h)
        return judged(calibration, recording, self, limits, dwells)

    def diagnose(
        self,
        recordings: Recordings,
        *,
        static: Recording | None = None,
        progress: Progress = silent,
    ) -> Diagnosis:
        """Which physics this scenario leaves out.

        Args:
            recordings: one, or several of the same set-up that are explained together.
            static: a record at standstill to estimate the noise from.
            progress: receives what is being done.

        Raises:
            TiltcalError: a column is missing, or the scenario contains the concealed truth.
        """
        nominal = require_no_truth(self, f"scenario {self.name}")
        return explain(nominal, _several(recordings), static, progress)

    def design(
        self,
        budget_s: float = 300.0,
        *,
        terms: Sequence[str] = (),
        nuisance: Sequence[str] = ("drift",),
        sensor: str | None = None,
        criterion: str = "both",
        grade: str = "mid_mems",
        prior: float | None = None,
        floor_ug: float = 20.0,
        range_deg: float = 180.0,
        rate_deg_s: float = 20.0,
        settle_s: float = 5.0,
        dwell_s: tuple[float, float] = (5.0, 60.0),
        angles_deg: Mapping[str, tuple[float, float]] | None = None,
        step_deg: float = 0.0,
        goals: Sequence[str] = (),
        seed: int = 0,
        progress: Progress = silent,
    ) -> DesignedSequence:
        """The poses with the most information for a table time.

        Args:
            budget_s: table time.
            terms: of interest; by default those of the sensor's adjustable list and of [[effect]]
                tables with fit = true.
            nuisance: terms that are fitted but not of interest.
            sensor: its name, if the scenario has several accelerometers.
            criterion: tilt (or I), D, A, or both.
            grade: of the instrument, sets the prior sizes.
            prior: one relative size instead.
            floor_ug: error of a pose mean that averaging does not reduce.
            range_deg: working range about level for the tilt error.
            rate_deg_s: of moves.
            settle_s: after each.
            dwell_s: shortest and longest reading.
            angles_deg: axis -> lowest and highest angle.
            step_deg: angles are its multiples.
            goals: NAME=VALUE with a unit or without, such as accel.bias=30ug, tilt=5arcsec: the
                least time that reaches all of them is used.
            seed: of the search.
            progress: receives what is being done.

        Raises:
            TiltcalError: no set of poses within the limits determines a term of interest, or a goal
                does not read.
        """
        one = sensor_of(self, sensor)
        seen = self.seen_by(one)
        wanted = Wanted(
            tuple(terms), tuple(nuisance), grade, prior, floor_ug * 1e-6 * G0, range_deg * DEG
        )

        def problem_in(time: float) -> tuple[Problem, tuple[str, ...]]:
            clock = clock_of(seen, time, rate_deg_s, settle_s, dwell_s, angles_deg, step_deg)
            return scenario_problem(seen, one, wanted, clock, criterion)

        return designed_for_goals(
            self, one, problem_in, budget_s, goals, "all" in terms, seed, progress
        )


def load_scenario(path: Path | str) -> Scenario:
    """Read a scenario file.

    Raises:
        TiltcalError: naming every wrong key, with the nearest valid one, in one message.
    """
    return load_as(Scenario, path)


def parse_scenario(
    table: Mapping[str, Any], source: str = "scenario", *, folder: Path | str = "."
) -> Scenario:
    """A scenario from the table of its file, for example ``Diagnosis.amended``.

    Args:
        table: as the file would hold it.
        source: what it is called in messages.
        folder: in which, or below, the model lies that ``[rig] mjcf`` names.

    Raises:
        TiltcalError: naming every wrong key.
    """
    return parse_as(Scenario, dict(table), source, Path(folder))


def correct(calibration: Calibration, recording: Recording) -> Recording:
    """A recording with the corrected columns added, and tilt where defined.

    Raises:
        TiltcalError: the recording lacks the calibrated sensor.
    """
    written: list[Recording] = []
    correct_pieces([recording], calibration, written.append)
    return written[0]


def _several(recordings: Recordings) -> Sequence[Recording]:
    return [recordings] if isinstance(recordings, Recording) else list(recordings)


def _dwells(segments: Dwells | None, recording: Recording) -> dict[str, Any]:
    """The option ``segments`` of a method, where dwells are given."""
    if segments is None:
        return {}
    if isinstance(segments, Path | str):
        return {"segments": read_segments(Path(segments), recording)}
    return {"segments": segments}
