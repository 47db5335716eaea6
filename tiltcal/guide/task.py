"""What a guide calibrates: a method on a sensor of a scenario."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

from tiltcal.api.certifying import Certificate
from tiltcal.api.scenario import Scenario
from tiltcal.calibration.methods.common import require_triad
from tiltcal.calibration.methods.norm import number_of_terms
from tiltcal.calibration.methods.terms import LINEAR, require_names
from tiltcal.calibration.result import Calibration
from tiltcal.core.errors import TiltcalError, one_of
from tiltcal.effects.sensor.noise import Noise
from tiltcal.guide.planner import Fitted
from tiltcal.recordings.recording import Recording
from tiltcal.recordings.segmentation import Segment
from tiltcal.report.stated import Stated
from tiltcal.setup.sensor import Sensor

KINDS = {"six_position": ("accelerometer", "inclinometer"), "norm": ("accelerometer",)}
"""Kinds of sensors of each method that can be guided: those that use dwells alone."""


@dataclass(frozen=True)
class Task:
    """What is calibrated.

    Args:
        scenario: site, rig and sensors.
        method: its name.
        sensor: that the method works on.
        options: of the method.
    """

    scenario: Scenario
    method: str
    sensor: Sensor
    options: Mapping[str, Any]

    @property
    def by_norm(self) -> bool:
        """Whether the method needs no attitudes."""
        return self.method == "norm"

    @cached_property
    def fitted(self) -> Fitted:
        """What the method fits."""
        terms = self.options.get("terms")
        if self.by_norm:
            return Fitted(self.scenario, self.sensor, (), number_of_terms(terms, self.sensor))
        return Fitted(self.scenario, self.sensor, tuple(LINEAR if terms is None else terms))

    @property
    def seen(self) -> Scenario:
        """The scenario with the instrument where the sensor sits."""
        return self.scenario.seen_by(self.sensor)

    @property
    def noise_is_stated(self) -> bool:
        """Whether the scenario has the noise of the sensor."""
        name = self.sensor.name
        return any(isinstance(e, Noise) and e.sensor == name for e in self.scenario.effects)

    def require_columns(self, recording: Recording) -> None:
        """Refuse a stream without the sensor.

        Raises:
            TiltcalError: a column is missing, or its unit does not fit.
        """
        recording.sensor(self.sensor)

    def calibrate(self, recording: Recording, segments: Sequence[Segment]) -> Calibration:
        """The calibration of a recording.

        Args:
            recording: so far.
            segments: its dwells.

        Raises:
            TiltcalError: the recording does not have what the method needs.
        """
        options = {"sensor": self.sensor.name, **self.options}
        return self.scenario.calibrate(recording, self.method, segments=segments, **options)

    def certify(
        self, recording: Recording, segments: Sequence[Segment], stated: Stated | None
    ) -> Certificate:
        """The same with its uncertainty budget.

        Args:
            recording: so far.
            segments: its dwells.
            stated: what only the laboratory knows.

        Raises:
            TiltcalError: the recording does not have what the method needs.
        """
        options = {"sensor": self.sensor.name, **self.options}
        return self.scenario.certify(recording, self.method, stated, segments=segments, **options)


def task_of(
    scenario: Scenario, method: str, sensor: str | None, options: Mapping[str, Any]
) -> Task:
    """What is calibrated.

    Args:
        scenario: site, rig and sensors.
        method: its name.
        sensor: its name; None: the only one that fits.
        options: of the method.

    Raises:
        TiltcalError: the method cannot be guided, no sensor or several fit, or an option is wrong.
    """
    one_of(method, tuple(KINDS), "method of a guide")
    fitting = [s for s in scenario.sensors(*KINDS[method]) if sensor in (None, s.name)]
    if len(fitting) != 1:
        names = ", ".join(s.name for s in fitting) or "none"
        raise TiltcalError(
            f"guide, method {method}",
            found=f"{len(fitting)} sensors that fit ({names})",
            need=f"one {' or '.join(KINDS[method])}",
            do="name it with --sensor" if fitting else "use a scenario that has one",
        )
    if method == "norm":
        require_triad(fitting[0], method, "use six_position")
    elif "terms" in options:
        require_names(options["terms"], method)
    return Task(scenario, method, fitting[0], dict(options))
