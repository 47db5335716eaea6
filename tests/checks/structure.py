"""Limits of the source: lines of a function's body and of a file, and no circle of imports.

    python -m tests.checks.structure

A body is a function without its head and docstring. The import contract between rooms is checked
by ``lint-imports``. Exit status: 0 all limits are kept; 1 one is not.
"""

import ast
import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from graphlib import CycleError, TopologicalSorter
from pathlib import Path

ROOT = Path(__file__).parents[2]
PACKAGES = (ROOT / "tiltcal", ROOT / "sim" / "tiltsim")
LONGEST_BODY = 40  # lines
LONGEST_FILE = 600  # lines


@dataclass(frozen=True)
class Source:
    """One file.

    Args:
        lines: of the whole file.
        bodies: (lines, name) of each function.
        imports: modules of the same package that are imported at the top of the file.
    """

    module: str
    lines: int
    bodies: tuple[tuple[int, str], ...]
    imports: frozenset[str]


def read(path: Path, package: Path) -> Source:
    """Measure one file of a package."""
    text = path.read_text(encoding="utf-8")
    tree = ast.parse(text)
    module = ".".join(path.relative_to(package.parent).with_suffix("").parts)
    return Source(
        module=module.removesuffix(".__init__"),
        lines=len(text.splitlines()),
        bodies=tuple(bodies(tree)),
        imports=frozenset(imported(tree, package.name)),
    )


def bodies(tree: ast.Module) -> Iterator[tuple[int, str]]:
    """Lines of each function without its head and docstring."""
    for node in ast.walk(tree):
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
            body = node.body[1:] if ast.get_docstring(node) is not None else node.body
            if body:
                yield (body[-1].end_lineno or 0) - body[0].lineno + 1, node.name


def imported(tree: ast.Module, package: str) -> Iterator[str]:
    """Modules of the package that a file imports at its top."""
    for node in tree.body:
        if isinstance(node, ast.ImportFrom) and (node.module or "").split(".")[0] == package:
            yield str(node.module)
            yield from (f"{node.module}.{alias.name}" for alias in node.names)


def circle(sources: Sequence[Source]) -> list[str]:
    """Modules that import each other in a circle, first and last the same; empty if none do."""
    modules = {s.module for s in sources}
    try:
        TopologicalSorter({s.module: s.imports & modules for s in sources}).prepare()
    except CycleError as error:
        return list(error.args[1])
    return []


def complaints(sources: Sequence[Source]) -> Iterator[str]:
    """What exceeds a limit, a line each."""
    for source in sources:
        if source.lines > LONGEST_FILE:
            yield f"{source.module}: {source.lines} lines, at most {LONGEST_FILE}"
        for lines, name in source.bodies:
            if lines > LONGEST_BODY:
                yield f"{source.module}.{name}: body of {lines} lines, at most {LONGEST_BODY}"
    if found := circle(sources):
        yield "circle of imports: " + " -> ".join(found)


def main() -> int:
    """Print what exceeds its limit, and return the exit status."""
    sources = [read(path, p) for p in PACKAGES for path in sorted(p.rglob("*.py"))]
    found = list(complaints(sources))
    print("\n".join(found) or "structure: bodies, files and imports keep their limits")
    return 1 if found else 0


if __name__ == "__main__":
    sys.exit(main())
