"""Which files a model names: all of them lie in the scenario's folder.

MuJoCo looks for a file from the main model's folder and from that of the file that names it, in the
folders that any part of the model states for its assets.
"""

from collections.abc import Iterator
from pathlib import Path
from xml.etree import ElementTree
from xml.etree.ElementTree import Element

from tiltcal.core.errors import TiltcalError

LARGEST = 64 * 2**20  # bytes
FOLDERS = ("meshdir", "texturedir", "assetdir")
PARTS = ("include", "model")  # elements that name further XML
SCHEMES = ("file://", "package://")  # of URDF


def require_inside(folder: Path, path: Path, words: str) -> Path:
    """A file inside a folder, with its links resolved.

    Raises:
        TiltcalError: it lies elsewhere, is no file, or is too large.
    """
    found = path.resolve()
    if not found.is_relative_to(folder.resolve()):
        raise _error(words, "a path outside the scenario's folder", "files inside it")
    if not found.is_file():
        raise _error(words, "no such file", "a file in the scenario's folder")
    if found.stat().st_size > LARGEST:
        raise _error(words, f"{found.stat().st_size} bytes", f"at most {LARGEST}")
    return found


def check_files(main: Path, folder: Path) -> None:
    """Every file that a model and its parts name lies in a folder; one that is missing is MuJoCo's
    to say.

    Raises:
        TiltcalError: one does not, or a part is no XML.
    """
    roots: dict[Path, Element] = {}
    waiting = [main]
    while waiting:
        path = waiting.pop()
        if path in roots:
            continue
        roots[path] = _parsed(path)
        for name, tag in _named(roots[path]):
            for place in (main.parent, path.parent) if tag in PARTS else ():
                target = (place / name).resolve()
                if target.is_file():
                    waiting.append(require_inside(folder, target, name))
    stated = {e.get(k) or "" for r in roots.values() for e in r.iter("compiler") for k in FOLDERS}
    for path, root in roots.items():
        for name, _ in _named(root):
            for place in (main.parent, path.parent):
                for assets in stated | {""}:
                    target = (place / assets / name).resolve()
                    if not target.is_relative_to(folder.resolve()):
                        require_inside(folder, target, name)


def _named(root: Element) -> Iterator[tuple[str, str]]:
    """Each file that a part names, with the element that does."""
    for element in root.iter():
        for key, value in element.attrib.items():
            if key.startswith("file") and value:  # file, filename, fileright ...
                for scheme in SCHEMES:
                    value = value.removeprefix(scheme)
                yield value, element.tag


def _parsed(path: Path) -> Element:
    try:
        return ElementTree.fromstring(path.read_bytes())
    except ElementTree.ParseError as error:
        raise _error(path.name, f"no XML: {error}", "MJCF or URDF") from error


def _error(words: str, found: str, need: str) -> TiltcalError:
    return TiltcalError(
        f"model file {words}",
        found=found,
        need=need,
        do="correct it, or copy it beside the scenario",
    )
