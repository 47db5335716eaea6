"""One mutated input: which command, which file of it, and how it is changed. The seed and its
number decide everything.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from tests.fuzz.arguments import mutated_arguments
from tests.fuzz.arrays import mutated_npz, mutated_parquet
from tests.fuzz.commands import LINES, Line
from tests.fuzz.text import mutated_bytes, mutated_csv
from tests.fuzz.values import mutated_json, mutated_toml

BY_ENDING = {
    ".csv": mutated_csv,
    ".txt": mutated_csv,
    ".npz": mutated_npz,
    ".parquet": mutated_parquet,
    ".toml": mutated_toml,
    ".json": mutated_json,
    ".journal": mutated_bytes,
}
RAW = 0.12
ARGUMENTS = 0.2


@dataclass(frozen=True)
class Case:
    """A mutated input.

    Args:
        number: of it.
        arguments: of the command line.
        files: by path below the working folder.
        changed: what was mutated, in words.
    """

    number: int
    arguments: tuple[str, ...]
    files: Mapping[str, bytes]
    changed: str

    def write(self, place: Path) -> None:
        """Its files."""
        for name, content in self.files.items():
            path = place / name
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_bytes(content)


def make_case(seed: int, number: int, originals: Mapping[str, bytes]) -> Case:
    """The mutated input of that number."""
    rng = np.random.default_rng((seed, number))
    line = drawn(rng)
    files = {name: originals[name] for name in line.inputs}
    mutable = [name for name in files if Path(name).suffix in BY_ENDING]
    if not mutable or rng.random() < ARGUMENTS:
        words = mutated_arguments(line.arguments, rng)
        return Case(number, tuple(words), files, "arguments")
    name = mutable[rng.integers(len(mutable))]
    files[name] = mutated(name, files[name], rng)
    return Case(number, tuple(line.arguments), files, name)


def drawn(rng: np.random.Generator) -> Line:
    """A command line, by weight."""
    weights = np.array([line.weight for line in LINES])
    return LINES[rng.choice(len(LINES), p=weights / weights.sum())]


def mutated(name: str, content: bytes, rng: np.random.Generator) -> bytes:
    """A file with a few changes."""
    if rng.random() < RAW:
        return mutated_bytes(content, rng)
    return BY_ENDING[Path(name).suffix](content, rng)
