"""The API: the stable names of ``import tiltcal as tc`` in full, and each room's public names."""

import ast
import importlib
import pkgutil
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import tiltcal

HOME = Path(tiltcal.__file__).parent
OPTIONS = """\
    options:
      members: null
      filters: ["!^_"]
      inherited_members: false
"""


@cache
def pages() -> tuple[tuple[str, str], ...]:
    """(file, text) of a page for the stable names, and one for each room."""
    rooms = [room.name for room in pkgutil.iter_modules(tiltcal.__path__) if room.ispkg]
    stable = ("api/tiltcal.md", "\n".join(_stable()))
    return (stable, *((f"api/{room}.md", "\n".join(_room(room))) for room in rooms))


def _stable() -> Iterator[str]:
    yield "# import tiltcal as tc\n"
    yield "After this page you know every stable name, with its arguments, units and errors.\n"
    for name in tiltcal.__all__:
        thing = getattr(tiltcal, name)
        if hasattr(thing, "__qualname__"):
            yield f"::: {thing.__module__}.{thing.__qualname__}"
            yield OPTIONS


def _room(room: str) -> Iterator[str]:
    package = f"tiltcal.{room}"
    yield f"# {package}\n\n{importlib.import_module(package).__doc__}\n"
    for path in sorted((HOME / room).rglob("*.py")):
        yield from _module(path)


def _module(path: Path) -> Iterator[str]:
    tree = ast.parse(path.read_text(encoding="utf-8"))
    kinds = ast.FunctionDef | ast.ClassDef
    public = [n for n in tree.body if isinstance(n, kinds) and not n.name.startswith("_")]
    if not public:
        return
    parts = path.relative_to(HOME.parent).with_suffix("").parts
    name = ".".join(parts).removesuffix(".__init__")
    yield f"## {name}\n\n{_first(tree)}\n\n| name | what it is |\n|---|---|"
    for node in public:
        yield f"| `{_head(node)}` | {_first(node).replace('|', '&#124;')} |"
    yield ""


def _head(node: ast.FunctionDef | ast.ClassDef) -> str:
    if isinstance(node, ast.ClassDef):
        return node.name
    return f"{node.name}({', '.join(a.arg for a in (*node.args.posonlyargs, *node.args.args))})"


def _first(node: ast.Module | ast.FunctionDef | ast.ClassDef) -> str:
    """The first paragraph of a docstring, in one line."""
    return " ".join((ast.get_docstring(node) or "").partition("\n\n")[0].split())
