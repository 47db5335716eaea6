"""One mutated input: which command, which file of it, and how it is changed. The seed and its
number decide everything.
"""

import os
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from tests.fuzz.arguments import mutated_arguments
from tests.fuzz.arrays import mutated_npz, mutated_parquet
from tests.fuzz.commands import LINES, Line
from tests.fuzz.text import mutated_bytes, mutated_csv, mutated_xml
from tests.fuzz.values import mutated_json, mutated_toml

BY_ENDING = {
    ".csv": mutated_csv,
    ".txt": mutated_csv,
    ".npz": mutated_npz,
    ".parquet": mutated_parquet,
    ".toml": mutated_toml,
    ".json": mutated_json,
    ".xml": mutated_xml,
} | dict.fromkeys(
    (".journal", ".h5", ".tdms", ".bag", ".ulg", ".mat", ".mcap", ".yaml"), mutated_bytes
)
RAW = 0.12
ODD_PLACE = 0.03
ARGUMENTS = 0.2


@dataclass(frozen=True)
class Case:
    """A mutated input.

    Args:
        number: of it.
        arguments: of the command line.
        files: by path below the working folder: the content, or the name of what is there instead.
        changed: what was mutated, in words.
    """

    number: int
    arguments: tuple[str, ...]
    files: Mapping[str, bytes | str]
    changed: str

    def write(self, place: Path) -> None:
        """Its files."""
        for name, content in self.files.items():
            path = place / name
            path.parent.mkdir(parents=True, exist_ok=True)
            if isinstance(content, str):
                ODD_PLACES[content](path)
            else:
                path.write_bytes(content)


def sparse(path: Path) -> None:
    """Bytes of zero that fill no disk, more than any memory."""
    with path.open("wb") as file:
        file.truncate(1 << 36)


ODD_PLACES: Mapping[str, Callable[[Path], object]] = {
    "folder": Path.mkdir,
    "loop": lambda path: path.symlink_to(path.name),
    "nowhere": lambda path: path.symlink_to("nothing"),
    "pipe": os.mkfifo,
    "device": lambda path: path.symlink_to("/dev/zero"),
    "sparse": sparse,
}


def make_case(seed: int, number: int, originals: Mapping[str, bytes]) -> Case:
    """The mutated input of that number."""
    rng = np.random.default_rng((seed, number))
    line = drawn(rng)
    files: dict[str, bytes | str] = {name: originals[name] for name in line.inputs}
    mutable = [name for name in files if Path(name).suffix in BY_ENDING]
    if not mutable or rng.random() < ARGUMENTS:
        words = mutated_arguments(line.arguments, rng)
        return Case(number, tuple(words), files, "arguments")
    name = mutable[rng.integers(len(mutable))]
    place = rng.random() < ODD_PLACE
    files[name] = (
        str(rng.choice(list(ODD_PLACES))) if place else mutated(name, originals[name], rng)
    )
    return Case(number, tuple(line.arguments), files, f"{name} {files[name] if place else ''}")


def drawn(rng: np.random.Generator) -> Line:
    """A command line, by weight."""
    weights = np.array([line.weight for line in LINES])
    return LINES[rng.choice(len(LINES), p=weights / weights.sum())]


def mutated(name: str, content: bytes, rng: np.random.Generator) -> bytes:
    """A file with a few changes."""
    if rng.random() < RAW:
        return mutated_bytes(content, rng)
    return BY_ENDING[Path(name).suffix](content, rng)
