"""``tiltcal effects``."""

from typing import Annotated

from cyclopts import Parameter

from tiltcal.cli.options import Json
from tiltcal.cli.output import paragraph, print_json, print_line, print_table
from tiltcal.core.errors import TiltcalError, nearest
from tiltcal.design.identifiability import most_similar_effects
from tiltcal.effects import CATALOGUE, Effect
from tiltcal.effects.parameter import GRADES


def effects(
    term: Annotated[str | None, Parameter("ID", help="Id of an effect, or a search term.")] = None,
    /,
    *,
    as_json: Json = False,
) -> int:
    """List the physical effects, or explain one.

    One effect is shown with its equation, signature and parameters.

      tiltcal effects
      tiltcal effects acc_K2
    """
    if term and term in CATALOGUE:
        explain(CATALOGUE[term], as_json)
        return 0
    found = {
        i: c
        for i, c in CATALOGUE.items()
        if not term or term.lower() in f"{i} {c.title} {c.physics} {c.look}".lower()
    }
    if term and not found:
        raise TiltcalError(
            f"effect '{term}'",
            found="no effect with this keyword",
            need="an id or a search term",
            do=nearest(term, list(CATALOGUE)),
        )
    if as_json:
        print_json([_as_json(c) for c in found.values()])
    else:
        print_table(
            ["id", "stage", "description", "parameters"],
            [[i, c.stage, c.title, _parameters(c)] for i, c in found.items()],
            spare=["parameters", "stage"],
        )
    return 0


def _parameters(cls: type[Effect]) -> str:
    axes = {"{axis}": "<axis>", "{pair}": "<ij>", "{matrix}": "<ij>"}
    arguments = []
    for p in cls.parameters:
        name = p.name
        for token, shown in axes.items():
            name = name.replace(token, shown)
        arguments.append(f"{name}_{p.unit}")
    return ", ".join(arguments[:4]) + (f" ... ({len(arguments)})" if len(arguments) > 4 else "")


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
    """Print all that is known of one effect."""
    if as_json:
        print_json(_as_json(cls))
        return
    paragraph(f"{cls.id} ({cls.stage}): {cls.title}")
    print_line("")
    paragraph(cls.physics, indent="")
    print_line("")
    for name, text in (
        ("equation", cls.equation),
        ("excited by", cls.excited_by),
        ("look", cls.look),
        ("source", cls.source),
    ):
        paragraph(f"{name + ':':12s}{text}", indent=" " * 12)
    similar_effects = most_similar_effects(cls.id)
    if similar_effects:
        similar = ", ".join(f"{i} (cosine {c:.3f})" for i, c in similar_effects)
        paragraph(f"{'similar:':12s}{similar}", indent=" " * 12)
    rows = [[f"{p.name}{p.suffix}", *(f"{x:g}" for x in p.plausible)] for p in cls.parameters]
    print_table(
        ["parameter", "precision laboratory", "mid MEMS", "consumer"],
        rows,
        "largest plausible size",
    )
