"""Where the models and scenarios lie: inside an installed package, or beside it in a checkout."""

from pathlib import Path

from tiltcal.core.errors import TiltcalError


def folder(name: str) -> Path:
    """The folder ``models`` or ``scenarios`` of this installation.

    Raises:
        TiltcalError: it is in neither place.
    """
    package = Path(__file__).resolve().parents[1]
    for place in (package / name, package.parent / name):
        if place.is_dir():
            return place
    raise TiltcalError(
        f"installation in {package}",
        found=f"no folder '{name}'",
        need="the packaged data",
        do="reinstall tiltcal",
    )


def beside(name: str) -> Path | None:
    """A folder of the source checkout this package runs from; None where it is installed by
    itself.
    """
    place = Path(__file__).resolve().parents[2] / name
    return place if place.is_dir() else None
