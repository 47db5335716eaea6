"""Statistics of the source code, room by room: limits that it keeps, and targets that it is held
to.

    python -m tests.checks.structure

A code line is one that holds a token other than a comment or a docstring. A numeric constant is a
module-level name that is given a number. A body is a function without its docstring.
Exit status: 0 all limits are kept, whether targets are met or not; 1 a limit is not kept.
"""

import ast
import io
import statistics
import sys
import tokenize
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

PACKAGE = Path(__file__).parents[2] / "tiltcal"
SKIPPED = {
    tokenize.COMMENT,
    tokenize.NL,
    tokenize.NEWLINE,
    tokenize.INDENT,
    tokenize.DEDENT,
    tokenize.ENDMARKER,
}
TARGETS = {
    "tokens a code line, median room": 9.0,
    "tokens a code line, densest room": 10.0,
    "numeric constants per 1000 lines outside effects": 5.0,
}
LIMITS = {
    "largest file, lines": 300,
    "largest body, lines": 40,
    "modules and rooms at the top": 16,
    "circles of imports between modules": 0,
}


@dataclass(frozen=True)
class Source:
    """One file.

    Args:
        room: the folder below the package, or the file itself.
        lines, code: all lines, and those with code.
        tokens: on code lines.
        constants: module-level names given a number.
        bodies: (lines, name) of each function.
        imports: modules of the package that are imported at the top of the file.
    """

    module: str
    room: str
    lines: int
    code: int
    tokens: int
    constants: int
    bodies: tuple[tuple[int, str], ...]
    imports: frozenset[str]


def read(path: Path, package: Path = PACKAGE) -> Source:
    """Measure one file."""
    text = path.read_text(encoding="utf-8")
    tree = ast.parse(text)
    documented = {line for node in docstrings(tree) for line in lines_of(node)}
    tokens, code = 0, set()
    for token in tokenize.generate_tokens(io.StringIO(text).readline):
        if token.type not in SKIPPED and token.start[0] not in documented:
            tokens += 1
            code.update(range(token.start[0], token.end[0] + 1))
    parts = path.relative_to(package.parent).with_suffix("").parts
    return Source(
        module=".".join(parts).removesuffix(".__init__"),
        room=parts[1],
        lines=len(text.splitlines()),
        code=len(code),
        tokens=tokens,
        constants=sum(numbers_given(statement) for statement in tree.body),
        bodies=tuple(bodies(tree)),
        imports=frozenset(imported(tree)),
    )


def lines_of(node: ast.stmt) -> range:
    """Numbers of the lines of a statement."""
    return range(node.lineno, (node.end_lineno or node.lineno) + 1)


def docstrings(tree: ast.Module) -> Iterator[ast.Expr]:
    """Every docstring, those of constants included."""
    for node in ast.walk(tree):
        if not isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef):
            continue
        for statement in node.body:
            if isinstance(statement, ast.Expr) and isinstance(statement.value, ast.Constant):
                yield statement


def numbers_given(statement: ast.stmt) -> int:
    """How many names a module-level assignment gives a number."""
    if not isinstance(statement, ast.Assign | ast.AnnAssign) or statement.value is None:
        return 0
    value = statement.value
    values = value.elts if isinstance(value, ast.Tuple) else [value]
    plain = all(is_number(v) for v in values)
    return len(values) if plain and values else 0


def is_number(node: ast.expr) -> bool:
    """Whether an expression is a number, with a sign perhaps."""
    if isinstance(node, ast.UnaryOp):
        node = node.operand
    return (
        isinstance(node, ast.Constant)
        and isinstance(node.value, int | float)
        and not isinstance(node.value, bool)
    )


def bodies(tree: ast.Module) -> Iterator[tuple[int, str]]:
    """Lines of each function without its head and docstring."""
    for node in ast.walk(tree):
        if isinstance(node, ast.FunctionDef):
            body = node.body[1:] if ast.get_docstring(node) is not None else node.body
            if body:
                yield (body[-1].end_lineno or 0) - body[0].lineno + 1, node.name


def imported(tree: ast.Module) -> Iterator[str]:
    """Modules of the package that a file imports at its top."""
    for node in tree.body:
        if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("tiltcal"):
            yield str(node.module)
            yield from (f"{node.module}.{alias.name}" for alias in node.names)


def circles(sources: list[Source]) -> list[list[str]]:
    """Groups of modules that import each other, by Tarjan's algorithm."""
    graph = {s.module: sorted(s.imports & {t.module for t in sources}) for s in sources}
    index: dict[str, int] = {}
    low: dict[str, int] = {}
    stack: list[str] = []
    found = []

    def visit(name: str) -> None:
        index[name] = low[name] = len(index)
        stack.append(name)
        for other in graph[name]:
            if other not in index:
                visit(other)
                low[name] = min(low[name], low[other])
            elif other in stack:
                low[name] = min(low[name], index[other])
        if low[name] == index[name]:
            group = stack[stack.index(name) :]
            del stack[stack.index(name) :]
            if len(group) > 1:
                found.append(group)

    for name in graph:
        if name not in index:
            visit(name)
    return found


def density(sources: list[Source]) -> float:
    """Tokens a code line."""
    return sum(s.tokens for s in sources) / max(sum(s.code for s in sources), 1)


def measured(sources: list[Source]) -> dict[str, float]:
    """The figures that have a target or a limit."""
    rooms = by_room(sources)
    dense = [density(s) for s in rooms.values()]
    outside = [s for s in sources if s.room != "effects"]
    constants = sum(s.constants for s in outside) / sum(s.lines for s in outside)
    top = [p for p in PACKAGE.iterdir() if p.suffix == ".py" or (p / "__init__.py").exists()]
    figures = (
        statistics.median(dense),
        max(dense),
        1000 * constants,
        max(s.lines for s in sources),
        max(n for s in sources for n, _ in s.bodies),
        len(top),
        len(circles(sources)),
    )
    return dict(zip((*TARGETS, *LIMITS), figures, strict=True))


def by_room(sources: list[Source]) -> dict[str, list[Source]]:
    """The files of each room; those at the top are none."""
    rooms: dict[str, list[Source]] = {}
    for source in sources:
        if not source.room.startswith("__"):
            rooms.setdefault(source.room, []).append(source)
    return dict(sorted(rooms.items()))


def main() -> int:
    """Print the statistics, and what exceeds its limit."""
    sources = [read(path) for path in sorted(PACKAGE.rglob("*.py"))]
    print(f"{'room':<14} {'files':>5} {'lines':>6} {'largest':>8} {'tokens/line':>12} {'body':>5}")
    for room, inside in by_room(sources).items():
        body = max((n for s in inside for n, _ in s.bodies), default=0)
        largest, lines = max(s.lines for s in inside), sum(s.lines for s in inside)
        print(
            f"{room:<14} {len(inside):>5} {lines:>6} {largest:>8} {density(inside):>12.1f}"
            f" {body:>5}"
        )
    print(f"{'all':<14} {len(sources):>5} {sum(s.lines for s in sources):>6}\n")
    failed = 0
    for name, value in measured(sources).items():
        kind, least = ("limit", LIMITS[name]) if name in LIMITS else ("target", TARGETS[name])
        above = value > least
        failed += above and kind == "limit"
        print(f"{name:<50} {value:>7.4g}  {kind} {least:g}{'  EXCEEDED' if above else ''}")
    for group in circles(sources):
        print("circle: " + " -> ".join(group))
    for source in sources:
        for n, name in source.bodies:
            if n > LIMITS["largest body, lines"]:
                print(f"body of {n} lines: {source.module}.{name}")
        if source.lines > LIMITS["largest file, lines"]:
            print(f"file of {source.lines} lines: {source.module}")
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
