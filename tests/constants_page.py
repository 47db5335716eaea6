"""The page of the numbers that decide a diagnosis, docs/constants.md: made from the code.

    python -m tests.constants_page                         compare the page with the code
    python -m tests.constants_page --write                 write it anew
    python -m tests.constants_page --vary candidates.COARSE [--count 12]

The last halves and doubles a number in a copy of the product, and prints how many of so many blind
recordings get another verdict or other names (minutes for each recording).
"""

import argparse
import ast
import shutil
import sys
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from tests.benchmarks.compare_commits import KEPT, ROOT, answer, blind_cases

PAGE = ROOT / "docs" / "constants.md"
CODE = ROOT / "tiltcal" / "diagnosis"
FACTORS = (0.5, 2.0)
HEAD = """\
# Numbers that decide

After this page you know every number by which `diagnose` and `investigate` decide: its value, what
it decides, and where it comes from.

`python -m tests.constants_page --vary candidates.COARSE` halves and doubles one of them in a copy
of the product and prints how many blind recordings get another verdict or other names. The
[statistical model](diagnosis_model.md) says how the priors belong together, and from which
recordings the shares were learnt.
"""


@dataclass(frozen=True)
class Number:
    """A constant of a module.

    Args:
        file: where; names: of it; value: as it is written; about: what is said of it.
        line: of its value, from 1.
    """

    file: Path
    names: tuple[str, ...]
    value: str
    about: str
    line: int

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
                yield Number(file, names, value, _about(node, after, lines), node.lineno)


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
    parts, package = [HEAD], ""
    for number in numbers():
        own = str(number.file.relative_to(CODE).parent)
        if own != package:
            package = own
            title = own.replace("_", " ").capitalize() if own != "." else "Order of work"
            parts.append(f"\n## {title}\n\n| number | value | decides |\n|---|---|---|\n")
        names = ", ".join(f"`{number.file.stem}.{n}`" for n in number.names)
        value, about = (text.replace("|", "\\|") for text in (number.value, number.about))
        parts.append(f"| {names} | `{value}` | {about} |\n")
    return "".join(parts)


def vary(name: str, count: int) -> None:
    """Print what changes where a number is halved and doubled.

    Raises:
        SystemExit: no number has this name.
    """
    number = next((n for n in numbers() if n.name == name), None)
    if number is None:
        raise SystemExit(f"{name}: no such number; see docs/constants.md")
    cases = blind_cases(KEPT / "inputs")[:count]
    told: dict[float, list[Any]] = {}
    for factor in (1.0, *FACTORS):
        with tempfile.TemporaryDirectory() as folder:
            site, answers = Path(folder) / "site", Path(folder) / "answers"
            shutil.copytree(ROOT / "tiltcal", site / "tiltcal")
            shutil.copytree(ROOT / "sim", site, dirs_exist_ok=True)
            file = site / number.file.relative_to(ROOT)
            lines = file.read_text(encoding="utf-8").splitlines()
            lines += [f"{number.names[0]} = {factor} * ({number.value})"] * (factor != 1)
            file.write_text("\n".join(lines) + "\n", encoding="utf-8")
            told[factor] = [_said(answer(case, site, answers)) for case in cases]
    for factor in FACTORS:
        others = sum(a != b for a, b in zip(told[1.0], told[factor], strict=True))
        print(f"{name} x {factor:g}: {others} of {len(cases)} recordings are told otherwise")


def _said(found: dict[str, Any]) -> Any:
    """Verdict and names of an answer."""
    diagnosis = found.get("diagnosis", {})
    return diagnosis.get("verdict"), [f["class"] for f in diagnosis.get("findings", [])]


def main() -> int:
    """Write the page, vary a number, or say whether the page is as the code says."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--write", action="store_true")
    parser.add_argument("--vary", default=None)
    parser.add_argument("--count", type=int, default=12)
    given = parser.parse_args()
    if given.vary:
        vary(given.vary, given.count)
        return 0
    if given.write:
        PAGE.write_text(page(), encoding="utf-8")
        return 0
    same = PAGE.exists() and PAGE.read_text(encoding="utf-8") == page()
    print("the page is as the code says" if same else "run python -m tests.constants_page --write")
    return 0 if same else 1


if __name__ == "__main__":
    sys.exit(main())
