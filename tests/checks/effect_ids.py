"""Ids of effects that stand as literals outside the effects: what is known of an effect stands in
its class.

    python -m tests.checks.effect_ids

Exit status: 0 none but the exceptions; 1 another literal, or an exception that is not needed.
"""

import ast
import sys
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

from tiltcal.effects import CATALOGUE

ROOT = Path(__file__).parents[2]
SEARCHED = ("tiltcal", "sim")
LEFT_OUT = ("tiltcal/effects",)
MOST = 10  # exceptions
EXCEPTIONS: dict[tuple[str, str], str] = {
    ("tiltcal/calibration/methods/fog_scale.py", "fog_scale"): "name of the calibration method",
    ("tiltcal/calibration/methods/registry.py", "fog_scale"): "name of the calibration method",
    ("tiltcal/report/certificate_scope.py", "fog_scale"): "name of the calibration method",
    ("tiltcal/validation/accuracy.py", "fog_scale"): "name of the calibration method",
}
"""(path, id) of the literals that may stand, with the reason."""


@dataclass(frozen=True)
class Literal:
    """An id of an effect as a string constant.

    Args:
        path: of the module, from the root of the project.
    """

    path: str
    line: int
    id: str

    def __str__(self) -> str:
        return f"{self.path}:{self.line}: '{self.id}'"


def literals(path: str, source: str) -> Iterator[Literal]:
    """The ids of effects among the string constants of a module."""
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Constant) and node.value in CATALOGUE:
            yield Literal(path, node.lineno, node.value)


def modules(root: Path) -> Iterator[tuple[str, str]]:
    """Path and source of each module that is searched."""
    for folder in SEARCHED:
        for file in sorted((root / folder).rglob("*.py")):
            path = file.relative_to(root).as_posix()
            if not path.startswith(tuple(f"{left}/" for left in LEFT_OUT)):
                yield path, file.read_text(encoding="utf-8")


def complaints(found: Iterable[Literal], exceptions: Mapping[tuple[str, str], str]) -> list[str]:
    """What is wrong with the literals and with the exceptions."""
    found = list(found)
    places = {(literal.path, literal.id) for literal in found}
    words = [
        f"{literal}: make it an attribute or a method of the class, or import the class"
        for literal in found
        if (literal.path, literal.id) not in exceptions
    ]
    words += [
        f"exception {path} '{id}': no such literal; remove it"
        for path, id in exceptions
        if (path, id) not in places
    ]
    if len(exceptions) > MOST:
        words.append(f"exceptions: found {len(exceptions)}, need {MOST} at most; remove some")
    return words


def main() -> int:
    found = [literal for path, source in modules(ROOT) for literal in literals(path, source)]
    wrong = complaints(found, EXCEPTIONS)
    print(f"{len(found)} literals of effect ids outside the effects")
    for literal in found:
        print(f"  {literal} ({EXCEPTIONS.get((literal.path, literal.id), 'no exception')})")
    for words in wrong:
        print(words, file=sys.stderr)
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main())
