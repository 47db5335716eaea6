"""Pictures that are drawn anew only where the source of the product has changed."""

import hashlib
import io
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path
from typing import Any

Draw = Callable[[], Any]
"""Makes a matplotlib figure."""
BLANK = b'<svg xmlns="http://www.w3.org/2000/svg" width="1" height="1"/>'


class PictureCache:
    """Drawn pictures in a folder, under a digest of the source.

    Args:
        root: of the project, whose source the pictures follow.
        folder: of the cache; pictures of another source are removed from it.
    """

    def __init__(self, root: Path, folder: Path) -> None:
        self._folder = folder / _digest(root)
        if not self._folder.exists():
            for old in folder.glob("*/*"):
                old.unlink()
        self._folder.mkdir(parents=True, exist_ok=True)

    def files(self, wanted: Mapping[str, Draw]) -> dict[str, Path]:
        """The pictures' files by name, drawn where they are missing; the ending is the format."""
        files = {name: self._folder / name for name in wanted}
        missing = {name: draw for name, draw in wanted.items() if not files[name].exists()}
        with ProcessPoolExecutor(2, get_context("fork")) as processes:
            parts = [processes.submit(_write, draw, files[n]) for n, draw in missing.items()]
            for part in parts:
                part.result()
        return files


def _write(draw: Draw, file: Path) -> None:
    file.write_bytes(_drawn(draw, file.suffix[1:]))


def _drawn(draw: Draw, format: str) -> bytes:
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot as plt

    with plt.rc_context({"svg.hashsalt": "tiltcal", "font.size": 9}):
        figure = draw()
        content = io.BytesIO()
        figure.savefig(content, format=format, dpi=90, transparent=True)
        plt.close(figure)
    return content.getvalue()


def _digest(root: Path) -> str:
    found = hashlib.sha256()
    for path in sorted(_sources(root)):
        found.update(str(path.relative_to(root)).encode() + path.read_bytes())
    return found.hexdigest()[:16]


def _sources(root: Path) -> Iterator[Path]:
    yield from (root / "docs" / "site").glob("*.py")
    for folder in ("tiltcal", "sim"):
        yield from (root / folder).rglob("*.py")
    yield from (root / "models").glob("*.xml")
    yield from (root / "scenarios").glob("*.toml")
