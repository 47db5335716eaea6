"""The folder that the figures of one command's reports are written into as well."""

from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass, field
from pathlib import Path


@dataclass
class FigureFolder:
    """Where figures go.

    Args:
        path: of the folder.
        pages: number of pages of each kind so far.
        written: files.
    """

    path: Path
    pages: dict[str, int] = field(default_factory=dict)
    written: list[Path] = field(default_factory=list)


_folder: ContextVar[FigureFolder | None] = ContextVar("folder of figures", default=None)


def figure_folder() -> FigureFolder | None:
    """The folder of the command that runs; None: no figures are wanted."""
    return _folder.get()


@contextmanager
def figures_into(path: Path | None) -> Iterator[FigureFolder | None]:
    """Figures of pages that are made meanwhile are written into a folder, too."""
    folder = None if path is None else FigureFolder(path)
    token = _folder.set(folder)
    try:
        yield folder
    finally:
        _folder.reset(token)
