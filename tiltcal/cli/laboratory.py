"""The MuJoCo laboratory for commands that simulate."""

from importlib.metadata import entry_points

from tiltcal.core.errors import TiltcalError
from tiltcal.core.progress import Progress, silent
from tiltcal.laboratory.laboratory import Laboratory


def simulator(progress: Progress = silent) -> Laboratory:
    """The MuJoCo laboratory, found by its entry point; time-stepped runs report to ``progress``.

    Raises:
        TiltcalError: it is not installed.
    """
    for entry in entry_points(group="tiltcal.laboratories"):
        if entry.name == "mujoco":
            return entry.load()(progress=lambda done, steps: progress(f"step {done} of {steps}"))
    raise TiltcalError(
        "simulator",
        found="none installed",
        need="the package tiltsim",
        do="install tiltcal with its simulator",
    )
