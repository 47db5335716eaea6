"""The guide: samples in, state out. It knows nothing of sources and of displays."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from tiltcal.api.certifying import Certificate
from tiltcal.api.scenario import Scenario
from tiltcal.calibration.result import Calibration
from tiltcal.core.arrays import Array
from tiltcal.guide.state import GuideState, Manner
from tiltcal.recordings.recording import Recording
from tiltcal.recordings.segmentation import Segment
from tiltcal.report.stated import Stated


class Guide:
    """Guides an operator through a calibration while it is recorded.

        guide = tc.Guide(scenario, "norm", goal={"bias": "60ug", "scale": "40ppm"})
        for block in source:  # tiltcal.guide.sources, or your own
            guide.feed(block.time, block.columns)
            draw(guide.state)  # tiltcal.guide.state.GuideState; .to_json() for a page
            if guide.state.done:
                break
        guide.save("out")

    Args:
        scenario: site, rig and sensors.
        method: ``six_position`` or ``norm``.
        goal: sigma of each kind of parameter, such as ``{"accel.bias": "50ug"}``; a kind may lack
            the sensor (``bias``) or name one axis (``accel.bias_x``). What is not named gets what
            ``tiltcal design`` expects of a few poses.
        hold_s: length of a dwell, s.
        manner: ``hand``, ``head`` or ``table``; by the scenario and the columns unless given.
        sensor: its name, if the scenario has several that fit.
        options: of the method.

    Raises:
        TiltcalError: the method cannot be guided, the scenario lacks a sensor for it, or a goal
            names no parameter.
    """

    def __init__(
        self,
        scenario: Scenario,
        method: str = "norm",
        *,
        goal: Mapping[str, str | float] | None = None,
        hold_s: float = 5.0,
        manner: Manner | None = None,
        sensor: str | None = None,
        **options: Any,
    ) -> None:
        raise NotImplementedError

    def feed(self, time: Array, columns: Mapping[str, Array]) -> None:
        """Take further samples.

        Args:
            time: stamps, s, (n,).
            columns: readings by column name with its unit (``accel_x_m_s2``), (n,) each, NaN where
                not sampled; the same names at every call.

        Raises:
            TiltcalError: a column of the sensor is missing, or lengths differ.
        """
        raise NotImplementedError

    @property
    def state(self) -> GuideState:
        """What is to be shown now."""
        raise NotImplementedError

    def set_angles(self, angles_deg: Mapping[str, float] | None = None) -> None:
        """State where the dividing head stands in the present dwell, or in the last.

        Args:
            angles_deg: axis -> angle, deg; those of the proposed pose unless given.

        Raises:
            TiltcalError: there is no dwell yet, or the table has no such axis.
        """
        raise NotImplementedError

    def reject(self, number: int = -1) -> None:
        """Leave a dwell out.

        Args:
            number: of the dwell, from 0; the last unless given.

        Raises:
            TiltcalError: there is no such dwell.
        """
        raise NotImplementedError

    def note(self, kind: str, statement: str) -> None:
        """Add a notice, for example of a connection that dropped.

        Args:
            kind: one word.
            statement: one sentence; an empty one removes the notices of this kind.
        """
        raise NotImplementedError

    @property
    def recording(self) -> Recording:
        """All that was fed, with labels and typed angles; readings of rejected dwells left out."""
        raise NotImplementedError

    @property
    def segments(self) -> Sequence[Segment]:
        """The dwells of the recording that are used."""
        raise NotImplementedError

    def calibrate(self) -> Calibration:
        """The calibration of what was recorded so far.

        Raises:
            TiltcalError: the recording does not have what the method needs.
        """
        raise NotImplementedError

    def certify(self, stated: Stated | None = None) -> Certificate:
        """The same with its uncertainty budget, as a certificate.

        Args:
            stated: what only the laboratory knows.

        Raises:
            TiltcalError: the recording does not have what the method needs.
        """
        raise NotImplementedError

    def save(self, folder: Path | str, stated: Stated | None = None) -> dict[str, Path]:
        """Write recording.csv, segments.csv, CAL.json and state.json, with ``stated`` also
        certificate.html and certificate.xml.

        Args:
            folder: made where it does not exist.
            stated: what only the laboratory knows; without it no certificate is written.

        Returns:
            The files that were written, by what they are; no ``calibration`` where there were too
            few dwells for one.

        Raises:
            TiltcalError: a file cannot be written.
        """
        raise NotImplementedError
