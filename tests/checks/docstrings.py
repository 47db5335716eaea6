"""Docstrings of public functions: shapes of arrays, units of quantities, the users' errors.

    python -m tests.checks.docstrings

Ruff checks that there is a docstring. Beside it:

- An Args section names every argument; several of one meaning may share a line (``x, y: (n,)``).
- A function that takes or returns an array says its shape, such as ``(n,)`` or ``(n, axes)``.
- A number that its name says is a time, an angle, a rate, a gravity ... has its unit in the name
  (``budget_s``) or in the docstring.
- A function that raises the users' error in its own body has it under Raises.

Commands are left out: their docstrings are the help of a terminal. Exit status: 0 none is missing;
1 something is.
"""

import ast
import re
import sys
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).parents[2]
SEARCHED = ("tiltcal", "sim")
COMMANDS = ("tiltcal/cli",)
ARRAYS = {"Array", "Index", "Mask", "NDArray", "ArrayLike"}
SHAPE = re.compile(r"\((?:[\w. +*/-]+,)+(?: ?[\w. +*/-]+)*\)|\(\)")
UNIT = re.compile(
    r"\b(?:s|min|h|ms|us|ns|rad|deg|arcsec|m|mm|g|mg|ug|Hz|K|degC|SI|V|LSB|ppm|px|MiB|bytes|nats)\b"
    r"|°|per cent|\bunits?\b|rad/s|m/s"
)
QUANTITIES = {
    "time", "start", "end", "duration", "horizon", "rate", "gravity", "angle", "angles", "latitude",
    "height", "temperature", "dwell", "tilt", "step", "width", "speed", "seconds", "roll", "pitch",
    "azimuth", "heading", "frequency", "acceleration", "up_rate",
}  # fmt: skip
NAMED_UNIT = re.compile(r"_(?:s|min|h|ms|deg|rad|arcsec|hz|ug|g|px|mib|m|deg_s|rad_s|m_s2)$")
NUMBERS = {"float"} | ARRAYS
ERROR = "TiltcalError"
Function = ast.FunctionDef | ast.AsyncFunctionDef


def main() -> int:
    """Print what is missing, a line each, and return the exit status."""
    missing = [line for path in modules() for line in missing_in(path)]
    print("\n".join(missing) or "docstrings: shapes, units and errors are all there")
    return 1 if missing else 0


def modules() -> list[Path]:
    """The modules that are checked."""
    found = [path for folder in SEARCHED for path in sorted((ROOT / folder).rglob("*.py"))]
    return [p for p in found if not str(p.relative_to(ROOT)).startswith(COMMANDS)]


def missing_in(path: Path) -> Iterator[str]:
    """What the public functions of a module do not say."""
    tree = ast.parse(path.read_text(encoding="utf-8"))
    makers = errors_made_by(tree)
    for function in public_functions(tree):
        text = ast.get_docstring(function)
        if text is None:
            continue
        where = f"{path.relative_to(ROOT)}:{function.lineno}: {function.name}"
        if needs_shape(function) and not SHAPE.search(" ".join(text.split())):
            yield f"{where}: shape of an array"
        if unsized := [a for a in quantities(function) if not UNIT.search(text)]:
            yield f"{where}: unit of {', '.join(unsized)}"
        if unnamed := unnamed_arguments(function, text):
            yield f"{where}: {', '.join(unnamed)} under Args"
        if raises(function, makers) and not re.search(rf"^Raises:\n +{ERROR}", text, re.M):
            yield f"{where}: Raises {ERROR}"


def public_functions(tree: ast.Module) -> Iterator[Function]:
    """Functions and methods whose names are public, of public classes."""
    for node in tree.body:
        if isinstance(node, ast.ClassDef) and not node.name.startswith("_"):
            own = [n for n in node.body if isinstance(n, Function)]
            yield from (n for n in own if not n.name.startswith("_"))
        elif isinstance(node, Function) and not node.name.startswith("_"):
            yield node


def errors_made_by(tree: ast.Module) -> set[str]:
    """The users' error, and functions of the module that make one."""
    functions = (node for node in tree.body if isinstance(node, Function))
    return {ERROR} | {f.name for f in functions if f.returns and ERROR in ast.unparse(f.returns)}


def needs_shape(function: Function) -> bool:
    """Whether it takes or returns an array."""
    kinds = [a.annotation for a in arguments(function)] + [function.returns]
    return any(kind is not None and names_in(kind) & ARRAYS for kind in kinds)


def quantities(function: Function) -> list[str]:
    """Arguments that are quantities by their names and do not name their unit."""
    return [
        a.arg
        for a in arguments(function)
        if a.annotation is not None
        and names_in(a.annotation) & NUMBERS
        and a.arg in QUANTITIES
        and not NAMED_UNIT.search(a.arg)
    ]


def unnamed_arguments(function: Function, text: str) -> list[str]:
    """Arguments that an Args section leaves out; none without a section."""
    _, section, rest = text.partition("\nArgs:\n")
    if not section:
        return []
    named = rest.partition("\n\n")[0]
    given = (a.arg for a in arguments(function) if a.arg not in ("self", "cls"))
    return [name for name in given if not re.search(rf"\b{name}\b(?:, \w+)*:", named)]


def raises(function: Function, makers: set[str]) -> bool:
    """Whether it raises the users' error in its own body, and does not catch it there."""
    raised = (node.exc for node in ast.walk(function) if isinstance(node, ast.Raise))
    called = (exc.func if isinstance(exc, ast.Call) else exc for exc in raised)
    return any(isinstance(name, ast.Name) and name.id in makers for name in called)


def arguments(function: Function) -> list[ast.arg]:
    """All arguments."""
    given = function.args
    return [*given.posonlyargs, *given.args, *given.kwonlyargs]


def names_in(kind: ast.expr) -> set[str]:
    """The names in an annotation."""
    return set(re.findall(r"\w+", ast.unparse(kind)))


if __name__ == "__main__":
    sys.exit(main())
