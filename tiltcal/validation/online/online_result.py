"""The tilt error of an estimator that was fed sample by sample."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from tiltcal.core.arrays import Array
from tiltcal.core.units import ARCSEC
from tiltcal.laboratory.scenario_tables import AcceptOnline


@dataclass(frozen=True)
class Section:
    """A stretch of the motion: at rest, a move or a swing.

    Args:
        kind: rest, move or swing; start, end: s; rms, worst: tilt error over its answered samples,
            rad.
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
        time: s, (n,); error: angle between the true and the found up, rad, (n,), NaN where it gave
            no answer.
        sections: of the motion, in order; kinds: of each sample, (n,).
        seconds: mean time a sample.
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
        rest of the dwell, s.
        """
        longest = 0.0
        for before, s in zip(self.sections[:-1], self.sections[1:], strict=True):
            if s.kind == "rest" and before.kind != "rest":
                inside = (self.time >= s.start) & (self.time < s.end)
                late = np.flatnonzero(~(self.error[inside] <= band))
                if len(late):
                    longest = max(longest, float(self.time[inside][late[-1]] - s.start))
        return longest

    def limits(self, accept: AcceptOnline) -> Iterator[tuple[str, float, str, bool]]:
        """Name, reached, allowed and whether it holds, of each limit."""
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
        """In words."""
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
