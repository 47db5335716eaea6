"""``tiltcal methods`` and ``effects``."""

import argparse
import inspect
from importlib.metadata import entry_points

from tiltcal.calibration.methods.registry import GROUP, METHODS
from tiltcal.cli.output import print_json, print_table
from tiltcal.core.errors import TiltcalError, nearest
from tiltcal.design.identifiability import nearest_rivals
from tiltcal.effects import CATALOGUE, Effect

GRADES = ("precision", "mid_mems", "consumer")


def methods(args: argparse.Namespace) -> int:
    """List the methods."""
    rows = [
        (name, (inspect.getdoc(method) or "").splitlines()[0], _options(method))
        for name, method in METHODS.items()
    ]
    rows += [(e.name, f"installed: {e.value}", "") for e in entry_points(group=GROUP)]
    if args.json:
        print_json([{"method": n, "does": d, "options": o} for n, d, o in rows])
        return 0
    print_table(["method", "does", "options"], rows)
    print(
        "Your own: --method package.module:function, called with (Recording, Setup), returns a"
        " Calibration."
    )
    return 0


def _options(method: object) -> str:
    parameters = inspect.signature(method).parameters.values()  # type: ignore[arg-type]
    return ", ".join(
        p.name for p in parameters if p.kind is p.KEYWORD_ONLY and p.name != "segments"
    )


def effects(args: argparse.Namespace) -> int:
    """List the effects or explain one."""
    if args.word in CATALOGUE:
        explain(CATALOGUE[args.word], args.json)
        return 0
    found = {
        i: c
        for i, c in CATALOGUE.items()
        if not args.word or args.word.lower() in f"{i} {c.title} {c.physics} {c.look}".lower()
    }
    if not found:
        raise TiltcalError(
            f"effect '{args.word}'",
            found="none of that word",
            need="an id or a word",
            do=nearest(args.word, list(CATALOGUE)),
        )
    if args.json:
        print_json([_as_json(c) for c in found.values()])
    else:
        print_table(
            ["id", "stage", "what it is", "parameters"],
            [[i, c.stage, c.title, _parameters(c)] for i, c in found.items()],
        )
    return 0


def _parameters(cls: type[Effect]) -> str:
    axes = {"{axis}": "<axis>", "{pair}": "<ij>", "{matrix}": "<ij>"}
    words = []
    for p in cls.parameters:
        name = p.name
        for token, shown in axes.items():
            name = name.replace(token, shown)
        words.append(f"{name}_{p.unit}")
    return ", ".join(words[:4]) + (f" ... ({len(words)})" if len(words) > 4 else "")


def _as_json(cls: type[Effect]) -> dict[str, object]:
    return {
        "id": cls.id,
        "stage": cls.stage,
        "title": cls.title,
        "physics": cls.physics,
        "equation": cls.equation,
        "source": cls.source,
        "excited_by": cls.excited_by,
        "look": cls.look,
        "linear": cls.linear,
        "random": cls.random,
        "parameters": [
            {
                "name": f"{p.name}{p.suffix}",
                "plausible": dict(zip(GRADES, p.plausible, strict=True)),
            }
            for p in cls.parameters
        ],
    }


def explain(cls: type[Effect], as_json: bool) -> None:
    """One effect, whole."""
    if as_json:
        print_json(_as_json(cls))
        return
    print(f"{cls.id} ({cls.stage}): {cls.title}\n\n{cls.physics}\n")
    for name, text in (
        ("equation", cls.equation),
        ("excited by", cls.excited_by),
        ("look", cls.look),
        ("source", cls.source),
    ):
        print(f"{name + ':':12s}{text}")
    rivals = nearest_rivals(cls.id)
    if rivals:
        print(f"{'rivals:':12s}" + ", ".join(f"{i} (cosine {c:.3f})" for i, c in rivals))
    rows = [[f"{p.name}{p.suffix}", *(f"{x:g}" for x in p.plausible)] for p in cls.parameters]
    print_table(
        ["parameter", "precision laboratory", "mid MEMS", "consumer"],
        rows,
        "largest plausible size",
    )
