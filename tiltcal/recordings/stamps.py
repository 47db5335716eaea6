"""The time stamps of a recording: they have to increase."""

import numpy as np

from tiltcal.core.arrays import Array
from tiltcal.core.errors import TiltcalError


def require_onward(time: Array, source: str, before: int = 0, last: float = -np.inf) -> None:
    """Refuse stamps that do not increase.

    Args:
        time: s, (n,).
        source: for the message.
        before: rows of the recording before these; last: the stamp of the last of them, s.

    Raises:
        TiltcalError: naming the first row where time does not run forward.
    """
    if not np.all(np.isfinite(time)):
        row = int(np.argmax(~np.isfinite(time)))
        raise TiltcalError(
            f"{source}, data row {before + row + 1}",
            found=f"the time {time[row]}",
            need="finite time stamps",
            do="correct it",
        )
    step = np.diff(time, prepend=last)
    if np.any(step <= 0):
        row = int(np.argmax(step <= 0))
        what = "time goes back by" if step[row] < 0 else "a repeated time stamp, step"
        raise TiltcalError(
            f"{source}, data row {before + row + 1}",
            found=f"{what} {abs(step[row]):.6g} s (at {time[row]:.10g} s)",
            need="time stamps that increase",
            do="sort it or split it there; `tiltcal diagnose` reads it as it is",
        )
