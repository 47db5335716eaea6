"""Pictures of the table for commands that write pages."""

import io
from collections.abc import Sequence

import numpy as np

from tiltcal.api.simulating import simulator
from tiltcal.core.errors import TiltcalError
from tiltcal.laboratory.scene import Stage
from tiltcal.report.plots import Plot
from tiltcal.report.poses import Pose, drive_of
from tiltcal.report.scenes import table_plot
from tiltcal.setup.setup import Setup

PICTURE = (840, 630)  # px


def stage() -> Stage:
    """The laboratory as one that shows its table.

    Raises:
        TiltcalError: the installed one does not.
    """
    laboratory = simulator()
    if isinstance(laboratory, Stage):
        return laboratory
    raise TiltcalError(
        "simulator",
        found="one that shows no table",
        need="one with scene() and pictures()",
        do="install tiltcal with its simulator",
    )


def table_in(poses: Sequence[Pose], setup: Setup) -> Plot | None:
    """The table in some poses; None in hand-held recordings, without poses, or without its
    model.
    """
    if not poses or not setup.rig.axes:
        return None
    try:
        scene = stage().scene(setup, drive_of(poses, setup))
    except TiltcalError:
        return None
    return table_plot(scene, [f"pose {k}: {p.angles_and_time}" for k, p in enumerate(poses, 1)])


def table_picture(setup: Setup) -> bytes | str:
    """The instrument on its table, all angles zero, as PNG; or why there is no picture."""
    from PIL import Image

    at_zero = Pose(np.array([0.0, 0.0, 1.0]), {}, 0.0, "", setup.rig.mount_rotation)
    try:
        (pixels,) = stage().pictures(setup, drive_of([at_zero], setup), *PICTURE)
    except TiltcalError as error:
        return str(error)
    with io.BytesIO() as file:
        image = Image.frombytes("RGB", PICTURE, pixels).quantize(64)
        image.save(file, "PNG", optimize=True)
        return file.getvalue()
