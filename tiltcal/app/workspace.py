"""The folder that the application works in: what lies there, and which names may be added."""

import json
import re
from dataclasses import dataclass
from pathlib import Path

from tiltcal.core.errors import TiltcalError, shown
from tiltcal.core.files import TEMPORARY, write_text
from tiltcal.core.safe_text import COMMANDING

LONGEST_NAME = 120  # characters: 480 bytes of UTF-8 at most are cut by no part name
RESERVED = re.compile(r"(?:con|prn|aux|nul|com\d|lpt\d)(?:\..*)?", re.IGNORECASE)
"""Names of devices on Windows, with any ending."""
CALIBRATION = r'\s*\{\s*"schema"[^{]*"method"'
"""Beginning of CAL.json: its method comes before any table."""
PEEK = 4096  # bytes that tell a kind of file
DEPTH = 2  # folders of results are one below; their parts are not listed
LOGS = {
    ".bag", ".bin", ".csv", ".dat", ".db3", ".h5", ".hdf5", ".log", ".mat", ".mcap", ".npz",
    ".parquet", ".tdms", ".tsv", ".txt", ".ulg",
}  # fmt: skip
STATE = ".tiltcal-app.json"
"""What was chosen and entered, in the workspace."""


@dataclass(frozen=True)
class Entry:
    """A file of the workspace.

    Args:
        name: path from the workspace, with ``/``.
        kind: recording, log, scenario, mapping, calibration, segments, report or other.
        size: bytes.
        modified: s since 1970.
    """

    name: str
    kind: str
    size: int
    modified: float


class Workspace:
    """A folder, with paths that do not leave it.

    Args:
        folder: existing.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder.resolve()

    def path(self, name: str) -> Path:
        """The path of a file by its name from the workspace.

        Raises:
            TiltcalError: it leads out of the workspace, also by a link, or to a hidden file.
        """
        path = (self.folder / name).resolve() if "\0" not in name else None
        if path is None or not path.is_relative_to(self.folder) or path == self.folder:
            raise _no_name(name, "a path out of the workspace")
        if any(part.startswith(".") for part in path.relative_to(self.folder).parts):
            raise _no_name(name, "a hidden file")
        return path

    def new(self, name: str) -> Path:
        """The path for a new file; a number is added where one of that name exists.

        Raises:
            TiltcalError: it is no name for a file.
        """
        path = self.folder / file_name(name)
        for number in range(2, 10_000):
            if not path.exists() and not path.is_symlink():
                return path
            stem, suffix = Path(name).stem, Path(name).suffix
            path = self.folder / f"{stem}-{number}{suffix}"
        raise _no_name(name, "10 000 files of that name")

    def unused(self, name: str) -> str:
        """A name that no file has, near the wanted one."""
        return self.new(name).name

    def entries(self) -> list[Entry]:
        """The files, the latest first."""
        found = [e for p in self._files(self.folder, DEPTH) if (e := self._entry(p)) is not None]
        return sorted(found, key=lambda e: e.modified, reverse=True)

    def _files(self, folder: Path, depth: int) -> list[Path]:
        found: list[Path] = []
        for path in folder.iterdir():
            if path.name.startswith((".", TEMPORARY)) or path.is_symlink():
                continue
            if path.is_dir() and depth > 1:
                found += self._files(path, depth - 1)
            elif path.is_file():
                found.append(path)
        return found

    def _entry(self, path: Path) -> Entry | None:
        try:
            about = path.stat()
            kind = kind_of(path)
        except OSError:  # it went away
            return None
        name = path.relative_to(self.folder).as_posix()
        return Entry(name, kind, about.st_size, about.st_mtime)

    def load_state(self) -> dict[str, object]:
        """What was kept of an earlier run; empty where nothing legible was."""
        try:
            found = json.loads((self.folder / STATE).read_text(encoding="utf-8"))
        except (OSError, ValueError):
            return {}
        return found if isinstance(found, dict) else {}

    def save_state(self, values: dict[str, object]) -> None:
        """Keep it for the next run, whole or not at all.

        Raises:
            TiltcalError: the file cannot be written.
        """
        write_text(self.folder / STATE, json.dumps(values, indent=1))


def file_name(text: str) -> str:
    """A name from a browser as that of a file.

    Raises:
        TiltcalError: it is a path, hidden, reserved, or no text.
    """
    if "/" in text or "\\" in text or text in ("", ".", ".."):
        raise _no_name(text, "a path")
    if COMMANDING.search(text) or not text.isprintable():
        raise _no_name(text, "control characters in it")
    if text.startswith("."):
        raise _no_name(text, "a hidden name")
    if RESERVED.fullmatch(text) or ":" in text or text[-1] in ". ":
        raise _no_name(text, "a reserved name")
    if len(text) > LONGEST_NAME or len(text.encode()) > 2 * LONGEST_NAME:
        raise _no_name(text, f"{len(text)} characters")
    return f"_{text}" if text[0] in "-+@= " else text  # not taken for an option


def _no_name(text: str, found: str) -> TiltcalError:
    return TiltcalError(
        f"file name {shown(text)}",
        found=found,
        need=f"a plain name of at most {LONGEST_NAME} characters, without folders",
        do="rename the file",
    )


def kind_of(path: Path) -> str:
    """What a file is, by its ending and its beginning."""
    suffix = path.suffix.lower()
    if suffix in (".html", ".xml"):
        return "report"
    if suffix not in (".csv", ".toml", ".json"):
        return "recording" if suffix in (".parquet", ".npz") else _other(suffix)
    with path.open("rb") as file:
        text = file.read(PEEK).decode("utf-8", errors="replace")
    if suffix == ".csv":
        return _kind_of_csv(text)
    if suffix == ".json":
        return "calibration" if re.match(CALIBRATION, text) else "other"
    if "[[column]]" in text:
        return "mapping"
    return "scenario" if "[rig]" in text or "[[sensor]]" in text else "other"


def _other(suffix: str) -> str:
    return "log" if suffix in LOGS else "other"


def _kind_of_csv(text: str) -> str:
    header = next((line for line in text.splitlines() if not line.startswith("#")), "")
    names = [name.strip() for name in header.split(",")]
    if {"start_s", "end_s", "kind"} <= set(names):
        return "segments"
    return "recording" if "time_s" in names else "log"
