"""Calibration certificates that can be shown, saved and tabulated."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from html import escape
from pathlib import Path
from typing import Any

from tiltcal.calibration.result import Calibration
from tiltcal.core.errors import TiltcalError
from tiltcal.core.tabular import Tabular
from tiltcal.recordings.recording import Recording
from tiltcal.recordings.segmentation import Segment
from tiltcal.report import certificate
from tiltcal.report.dcc import write_dcc
from tiltcal.report.indication import indication_plots
from tiltcal.report.plots import Plot
from tiltcal.report.pose_residuals import residual_plot
from tiltcal.report.stated import Stated
from tiltcal.validation.uncertainty_budget import UncertaintyBudget

ENDINGS = (".html", ".xml")


@dataclass(frozen=True)
class Certificate(certificate.Certificate, Tabular):
    """A certificate: ``calibration``, ``budget``, ``number``, ``expanded`` and what it states."""

    @classmethod
    def of(cls, made: certificate.Certificate) -> "Certificate":
        """The same certificate with what this class adds."""
        return cls(**{f.name: getattr(made, f.name) for f in fields(made)})

    def as_columns(self) -> Mapping[str, Sequence[Any]]:
        """Each parameter with its expanded uncertainty U at k = 2."""
        columns = self.calibration.as_columns()
        names = columns["parameter"]
        return {
            "parameter": names,
            "value": columns["value"],
            "U": [float(self.expanded[name]) for name in names],
            "unit": columns["unit"],
        }

    def headline(self) -> str:
        """Number and verdict."""
        return f"certificate {self.number}; {self.calibration.headline()}"

    def plots(self) -> Sequence[Plot]:
        """The residual of each dwell, and the error of indication over the working range before
        and after; those that the result and its recording have.
        """
        residuals = residual_plot(self.poses or [])
        return [*([residuals] if residuals else []), *indication_plots(self.indications)]

    def page(self) -> str:
        """The page as HTML text."""
        return certificate.certificate_page(self)

    def save(self, path: Path | str) -> None:
        """Write the page (.html) or the digital calibration certificate (.xml).

        Raises:
            TiltcalError: another ending, no day of measurement for the latter, or the file cannot
                be written.
        """
        path = Path(path)
        if path.suffix == ".html":
            certificate.write_certificate(self, path)
        elif path.suffix == ".xml":
            write_dcc(self, path)
        else:
            raise TiltcalError(
                f"certificate {path.name}",
                found=f"the ending '{path.suffix}'",
                need="one of " + ", ".join(ENDINGS),
                do="rename it",
            )

    def _repr_html_(self) -> str:
        """The page in a frame, for notebooks."""
        return f'<iframe srcdoc="{escape(self.page())}" width="100%" height="600"></iframe>'


def certificate_of(
    calibration: Calibration,
    stated: Stated,
    recording: Recording,
    budget: UncertaintyBudget | None,
    dwells: Sequence[Segment] | None = None,
) -> Certificate:
    """The certificate of a calibration with its recording.

    Args:
        calibration: the result.
        stated: by the laboratory.
        recording: of the fit.
        budget: of the calibration; None where it could not be evaluated.
        dwells: of the recording; found in it if not given.
    """
    made = certificate.make_certificate(calibration, stated, recording, budget, dwells)
    return Certificate.of(made)
