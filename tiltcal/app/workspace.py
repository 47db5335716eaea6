"""The folder that the application works in: its files by name, and what was chosen last."""

import json
import re
import shlex
from collections.abc import AsyncIterator
from pathlib import Path
from typing import Any

from pydantic import BaseModel, ValidationError

from tiltcal.core.errors import TiltcalError, shown
from tiltcal.core.files import make_folder, write_json
from tiltcal.core.read_back import read_json

CHOICES = ".tiltcal-app.json"
LONGEST_NAME = 120  # characters
STRANGE = re.compile(r"[^\w .,+=()-]")
RECORDINGS = (".csv", ".npz", ".parquet")
SCENARIOS = (".toml",)
CALIBRATIONS = (".json",)
PAGES = (".html", ".svg")  # that may be shown; everything else is downloaded


class Choices(BaseModel):
    """What was chosen last, by name of file; empty where nothing was.

    Args:
        log: to import.
        recording, scenario, calibration: that everything is done with.
        method: of the calibration.
        options: of it, KEY=VALUE.
        stated: what only the laboratory knows, for the certificate.
        plan: options of the design.
        guide: source, goals and method of the live guide.
        tab: that is shown.
    """

    log: str = ""
    recording: str = ""
    scenario: str = ""
    calibration: str = ""
    method: str = "norm"
    options: str = ""
    stated: dict[str, str] = {}
    plan: dict[str, str] = {}
    guide: dict[str, str] = {}
    tab: str = "Open"


class Workspace:
    """A folder and what was chosen in it.

    Args:
        folder: made where it does not exist.

    Raises:
        TiltcalError: the folder cannot be made.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = make_folder(folder).resolve()
        self.chosen = self._read()

    def _read(self) -> Choices:
        """The stored choices; those that do not read are none."""
        try:
            return Choices.model_validate(read_json(self.folder / CHOICES, "choices", "an object"))
        except (TiltcalError, ValidationError):
            return Choices()

    def choose(self, **changed: Any) -> None:
        """Change choices, and keep them for the next start."""
        for name, value in changed.items():
            setattr(self.chosen, name, value)
        write_json(self.folder / CHOICES, self.chosen.model_dump())

    def names(self, *endings: str) -> list[str]:
        """Files of the folder with one of these endings, all without any, newest first."""
        files = [
            p
            for p in self.folder.iterdir()
            if p.is_file() and not p.name.startswith(".") and not p.is_symlink()
        ]
        files = [p for p in files if not endings or p.suffix.lower() in endings]
        return [p.name for p in sorted(files, key=lambda p: -p.stat().st_mtime)]

    def path(self, name: str) -> Path:
        """Where a file of the folder is, or of a folder of results in it.

        Raises:
            TiltcalError: it would lie outside, or is hidden.
        """
        parts = Path(name).parts
        place = self.folder.joinpath(*parts)
        outside = not parts or len(parts) > 2 or any(p.startswith((".", "/", "\\")) for p in parts)
        if outside or "\0" in name or not place.resolve().is_relative_to(self.folder):
            raise TiltcalError(
                f"file {shown(name)}",
                found="a name that leads out of the workspace",
                need="the plain name of a file",
                do="choose a file of the workspace",
            )
        return place

    def free_name(self, given: str) -> str:
        """A name for a file that comes in: as given where that is plain and free.

        Raises:
            TiltcalError: nothing is left of the name.
        """
        last = given.replace("\\", "/").rsplit("/", 1)[-1]
        plain = STRANGE.sub("_", last).lstrip(". ")[-LONGEST_NAME:].strip()
        if not plain:
            raise TiltcalError(
                f"file {shown(given)}",
                found="no name",
                need="a name with letters or digits",
                do="rename the file",
            )
        stem, dot, ending = plain.rpartition(".")
        name, k = plain, 1
        while (self.folder / name).exists():
            k += 1
            name = f"{stem}-{k}{dot}{ending}" if dot else f"{plain}-{k}"
        return name

    async def take_in(self, given: str, content: AsyncIterator[bytes]) -> str:
        """Store a file that comes in piece by piece; the name that it got.

        Raises:
            TiltcalError: its name is none.
        """
        name = self.free_name(given)
        part = self.folder / f".{name}.part"
        try:
            with part.open("wb") as file:
                async for piece in content:
                    file.write(piece)
            part.replace(self.folder / name)
        finally:
            part.unlink(missing_ok=True)
        return name

    def result(self, name: str) -> dict[str, Any] | None:
        """A result that a command wrote as JSON; None where there is none."""
        try:
            found = json.loads(self.path(name).read_text(encoding="utf-8"))
        except (TiltcalError, OSError, ValueError):
            return None
        return found if isinstance(found, dict) else None


def as_command(words: tuple[str, ...]) -> str:
    """The line of a shell that does the same."""
    return shlex.join(("tiltcal", *words))
