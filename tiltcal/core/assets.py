"""Folders of the models and scenarios: inside an installed package, or next to it in a checkout."""

from pathlib import Path

from tiltcal.core.errors import TiltcalError


def folder(name: str) -> Path:
    """The folder ``models`` or ``scenarios`` of this installation.

    Raises:
        TiltcalError: neither has it.
    """
    package = Path(__file__).resolve().parents[1]
    for path in (package / name, package.parent / name):
        if path.is_dir():
            return path
    raise TiltcalError(
        f"installation in {package}",
        found=f"no folder '{name}'",
        need="the packaged data",
        do="reinstall tiltcal",
    )


def checkout_folder(name: str) -> Path | None:
    """A folder of the source checkout this package runs from; None where it is installed by
    itself.
    """
    folder = Path(__file__).resolve().parents[2] / name
    return folder if folder.is_dir() else None
