"""The page of the numbers that decide a diagnosis, docs/constants.md: made from the code, and from
what tests/constants_effects.py measured.

    python -m tests.constants_page                         compare the page with the code
    python -m tests.constants_page --write                 write it anew
"""

import argparse
import ast
import json
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

ROOT = Path(__file__).parents[1]
PAGE = ROOT / "docs" / "constants.md"
CODE = ROOT / "tiltcal" / "diagnosis"
EFFECTS = Path(__file__).with_name("constants_effects.json")
FACTORS = (0.5, 2.0)
HEADER = """\
| number | value | decides | half, twice |
|---|---|---|---|
"""
HEAD = """\
# Numbers that decide

After this page you know every number by which `diagnose` and `investigate` decide: its value, what
it decides, where it comes from, and what changes when it is halved or doubled.

The last column says how many of four blind recordings (a null, one cause, faults of data, unlisted
physics; the smallest of each) get another verdict or other classes with half and
with twice the number; `unused`: none of them comes to it; `fails`: the product does, as with a
share above 1. `python -m tests.constants_effects` measures it. The
[statistical model](diagnosis_model.md) says how the priors belong together, and from which
recordings the shares were learnt.
"""


@dataclass(frozen=True)
class Number:
    """A constant of a module.

    Args:
        file: where; names: of it; value: as it is written; about: what is said of it.
        last: line of its value, from 1, the last one if there are several.
    """

    file: Path
    names: tuple[str, ...]
    value: str
    about: str
    last: int

    @property
    def name(self) -> str:
        """With its module."""
        return f"{self.file.stem}.{self.names[0]}"


def numbers() -> Iterator[Number]:
    """Every constant of the diagnosis that holds a number, in order of files."""
    for file in sorted(CODE.rglob("*.py")):
        source = file.read_text(encoding="utf-8")
        body, lines = ast.parse(source).body, source.splitlines()
        for node, after in zip(body, [*body[1:], None], strict=True):
            names = tuple(_names(node))
            if names and _holds_number(node):
                value = " ".join(ast.unparse(node.value).split())  # type: ignore[attr-defined]
                yield Number(file, names, value, _about(node, after, lines), node.end_lineno)


def _names(node: ast.stmt) -> list[str]:
    if not isinstance(node, ast.Assign):
        return []
    target = node.targets[0]
    parts = target.elts if isinstance(target, ast.Tuple) else [target]
    names = [p.id for p in parts if isinstance(p, ast.Name)]
    return names if all(n.isupper() for n in names) else []


def _holds_number(node: Any) -> bool:
    constants = (n.value for n in ast.walk(node.value) if isinstance(n, ast.Constant))
    return any(isinstance(v, int | float) and not isinstance(v, bool) for v in constants)


def _about(node: ast.stmt, after: ast.stmt | None, lines: list[str]) -> str:
    """The comment above and beside it, and the string below."""
    said, k = [], node.lineno - 2
    while k >= 0 and lines[k].startswith("#"):
        said.insert(0, lines[k].lstrip("# "))
        k -= 1
    last = lines[(node.end_lineno or node.lineno) - 1]
    if "#" in last:
        said.append(last.split("#", 1)[1].strip())
    if isinstance(after, ast.Expr) and isinstance(after.value, ast.Constant):
        said.append(str(after.value.value))
    return " ".join(" ".join(said).split())


def page() -> str:
    """The text of the page."""
    package, effects = "", known_effects()
    told = [name for name, e in effects.items() if {e["halved"], e["doubled"]} - {0, "unused"}]
    which = ", ".join(f"`{name}`" for name in told)
    parts = [
        HEAD,
        f"\nOf {len(effects)} that were measured, {len(told)} change an answer: {which}.\n",
    ]
    for number in numbers():
        own = str(number.file.relative_to(CODE).parent)
        if own != package:
            package = own
            title = own.replace("_", " ").capitalize() if own != "." else "Order of work"
            parts.append(f"\n## {title}\n\n{HEADER}")
        names = ", ".join(f"`{number.file.stem}.{n}`" for n in number.names)
        value, about = (text.replace("|", "\\|") for text in (number.value, number.about))
        effect = _effect(effects.get(number.name))
        parts.append(f"| {names} | `{value}` | {about} | {effect} |\n")
    return "".join(parts)


def _effect(found: dict[str, Any] | None) -> str:
    """In words: with half, with twice the number."""
    if found is None:
        return "not measured"
    half, twice = found["halved"], found["doubled"]
    return str(half) if half == twice == "unused" else f"{half}, {twice}"


def known_effects() -> dict[str, dict[str, Any]]:
    """What was measured of each number whose value is still the same, by its name."""
    kept = json.loads(EFFECTS.read_text(encoding="utf-8")) if EFFECTS.exists() else {}
    return {n.name: kept[n.name] for n in numbers() if kept.get(n.name, {}).get("value") == n.value}


def main() -> int:
    """Write the page, or say whether it is as the code says."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--write", action="store_true")
    given = parser.parse_args()
    if given.write:
        PAGE.write_text(page(), encoding="utf-8")
        return 0
    same = PAGE.exists() and PAGE.read_text(encoding="utf-8") == page()
    print("the page is as the code says" if same else "run python -m tests.constants_page --write")
    return 0 if same else 1


if __name__ == "__main__":
    sys.exit(main())
