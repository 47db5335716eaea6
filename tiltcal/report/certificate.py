"""The calibration certificate: a page of two printed sides, self-contained."""

import base64
import hashlib
import json
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from tiltcal.calibration.result import Calibration, setup_of
from tiltcal.core.files import write_text
from tiltcal.recordings.recording import Recording
from tiltcal.recordings.segmentation import Segment
from tiltcal.report.certificate_scope import not_tested, procedure, validity
from tiltcal.report.certificate_tables import (
    budget_table,
    inverse_matrices,
    parameter_table,
    pose_table,
    table_blocks,
)
from tiltcal.report.improvement import improvements
from tiltcal.report.indication import (
    Indication,
    indication_plots,
    indications,
    repeatability,
)
from tiltcal.report.page import rendered
from tiltcal.report.pose_residuals import (
    PoseRow,
    Tilt,
    expected_tilt,
    measured_tilt,
    pose_rows,
)
from tiltcal.report.stated import NOT_STATED, NOTHING_STATED, Stated
from tiltcal.report.wording import mounting, period
from tiltcal.setup.setup import Setup
from tiltcal.validation.uncertainty_budget import COVERAGE, UncertaintyBudget, budget_of

NO_PICTURE = "it is drawn where the table's model and OpenGL are at hand"


@dataclass(frozen=True)
class Certificate:
    """What a certificate states.

    Args:
        calibration: the result.
        setup: site, table and sensors it belongs to.
        stated: by the laboratory.
        budget: GUM budget; None where only the noise of the record is known.
        poses: residuals by pose; None where no recording is at hand.
        temperature: lowest and highest of the recording, degC; None where it is not known.
        picture: of the instrument on its table, PNG; or why there is none.
    """

    calibration: Calibration
    setup: Setup
    stated: Stated = NOTHING_STATED
    budget: UncertaintyBudget | None = None
    poses: Sequence[PoseRow] | None = None
    temperature: tuple[float, float] | None = None
    picture: bytes | str = NO_PICTURE

    @property
    def assumed(self) -> bool:
        """Whether nobody stated the budget's sources: they are those of a usual laboratory."""
        return any(r.assumed for r in self.calibration.references)

    @cached_property
    def indications(self) -> list[Indication]:
        """Error of indication of each axis."""
        return indications(self.calibration, self.setup, self.poses or ())

    @property
    def equations(self) -> list[str]:
        """The model of each sensor, by its terms; else as the method states it."""
        c = self.calibration
        sensors = [] if c.of_base() or c.bias_tables else map(self.setup.named, c.sensors())
        gravity = self.setup.site.gravity
        found = [c.instrument((s,), gravity).equation(s) for s in sensors]
        return found or [c.equation] * bool(c.equation)

    @cached_property
    def digest(self) -> str:
        """SHA-256 of the calibration's data, hexadecimal."""
        text = json.dumps(self.calibration.to_json(), sort_keys=True, default=str)
        return hashlib.sha256(text.encode()).hexdigest()

    @property
    def number(self) -> str:
        """Number of the certificate: as stated, or from the digest."""
        stated = self.stated.text("number")
        return f"tiltcal-{self.digest[:16]}" if stated == NOT_STATED else stated

    @property
    def expanded(self) -> dict[str, float]:
        """Expanded uncertainty U at k = 2 of each parameter, in its unit."""
        if self.budget is not None:
            return self.budget.expanded
        return {n: COVERAGE * e.sigma for n, e in self.calibration.parameters.items()}

    @property
    def basis(self) -> str:
        """Components of U, as text."""
        if self.budget is not None and self.assumed:
            return (
                "U includes the noise of the record (type A) and sources (type B) whose sizes are"
                " assumed, those of a usual laboratory: the scenario states none."
            )
        if self.budget is not None:
            return "U includes the noise of the record (type A) and the stated sources (type B)."
        return (
            "U includes the noise of the record only (type A): there is no budget of the table,"
            " gravity and other references (type B)."
        )

    @property
    def simulated(self) -> bool:
        """Whether the recording came from the simulator, by its metadata."""
        return "seed" in self.calibration.provenance

    @property
    def tilts(self) -> list[Tilt]:
        """Tilt errors before and after: at the poses, and over the range."""
        found = [measured_tilt(self.poses or ()), expected_tilt(self.calibration, self.setup)]
        return [t for t in found if t is not None]

    @property
    def references(self) -> list[str]:
        """What the result is traced to, one sentence each."""
        site, rig = self.setup.site, self.setup.rig
        lines = [f"Local gravity {site.gravity:.8g} m/s², as the scenario states it."]
        if rig.axis_names:
            lines.append(
                f"Angles of the table's {', '.join(rig.axis_names)} axis by its {rig.readout}."
            )
        stated = list(self.stated.traceability)
        return [*lines, *(stated or ["Traceability of these references to the SI: not stated."])]


def make_certificate(
    calibration: Calibration,
    stated: Stated = NOTHING_STATED,
    recording: Recording | None = None,
    budget: UncertaintyBudget | None = None,
    segments: Sequence[Segment] | None = None,
) -> Certificate:
    """A certificate of a calibration.

    Args:
        calibration: with the set-up in its provenance.
        stated: by the laboratory.
        recording: of the fit, for residuals, tilt errors and the temperature.
        budget: of the calibration; unless given by the references that it carries.
        segments: dwells of the recording; found in it if not given.

    Raises:
        TiltcalError: the calibration carries no set-up.
    """
    setup = setup_of(calibration)
    if budget is None and calibration.references:
        budget = budget_of(calibration)
    if recording is None:
        return Certificate(calibration, setup, stated, budget)
    poses = pose_rows(calibration, recording, setup, segments)
    return Certificate(calibration, setup, stated, budget, poses, _temperature(recording))


def _temperature(recording: Recording) -> tuple[float, float] | None:
    name = recording.channel("temperature")
    values = np.zeros(0) if name is None else recording.column(name)
    values = values[np.isfinite(values)]
    return (float(values.min()), float(values.max())) if len(values) else None


def write_certificate(certificate: Certificate, path: Path) -> None:
    """Write the page, whole or not at all.

    Raises:
        TiltcalError: the file cannot be written.
    """
    write_text(path, certificate_page(certificate))


def certificate_page(certificate: Certificate) -> str:
    """The page as HTML text."""
    c, poses = certificate.calibration, certificate.poses or ()
    start = min((p.start_s for p in c.poses), default=0.0)
    budget = certificate.budget
    return rendered(
        "certificate",
        c=certificate,
        lead=lead(certificate),
        **_picture(certificate.picture),
        cal=c,
        stated=certificate.stated,
        sensors=[certificate.setup.named(n) for n in c.sensors()],
        rig=certificate.setup.rig,
        procedure=procedure(c),
        parameters=parameter_table(c, certificate.expanded),
        budget=budget_table(budget, c) if budget else None,
        improvements=improvements(budget, c) if budget else [],
        poses=pose_table(poses),
        plots_of=indication_plots(certificate.indications),
        repeatability=repeatability(certificate.indications, poses),
        start=start,
        when=period(start, max((p.end_s for p in c.poses), default=0.0)) if c.poses else "",
        mount=mounting(str(c.provenance.get("mount", certificate.setup.rig.mount)), start),
        tables=table_blocks(c),
        matrices=inverse_matrices(c, certificate.setup),
        validity=validity(c, certificate.setup, certificate.temperature),
        not_tested=not_tested(c),
        sources=_sources(c),
    )


def lead(certificate: Certificate) -> str:
    """The result in one sentence."""
    c = certificate.calibration
    names = " and ".join(c.sensors()) or "the table"
    first = (
        f"The {c.method.replace('_', ' ')} calibration of {names} is {c.verdict.replace('_', ' ')}"
    )
    if not certificate.tilts:
        return f"{first}: {len(c.parameters)} parameters with their uncertainties."
    tilt = certificate.tilts[0]
    return (
        f"{first}: it brings the tilt error from {tilt.before:.4g} to {tilt.after:.3g} arcsec rms"
        f" over {tilt.over}."
    )


def _picture(picture: bytes | str) -> dict[str, str]:
    """A picture as text, or why there is none."""
    if isinstance(picture, str):
        return {"picture": "", "no_picture": picture}
    return {"picture": base64.b64encode(picture).decode(), "no_picture": ""}


def _sources(calibration: Calibration) -> dict[str, Any]:
    """What the calibration came from, without the set-up and the mounting."""
    own = {k: v for k, v in calibration.provenance.items() if isinstance(v, str | int | float)}
    own.pop("mount", None)
    if (temperature := own.pop("temperature_degC", None)) is not None:
        own["temperature"] = f"{temperature:.4g} °C"
    return own
