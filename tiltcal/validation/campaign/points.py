"""The points of a campaign: each combination of levels, and at each of them the design from which
first-order and total sensitivity indices follow (Saltelli et al., Comput. Phys. Commun. 181, 2010).
"""

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import product
from math import prod
from typing import Any

import numpy as np

from tiltcal.core.arrays import Array
from tiltcal.core.budget import require_within
from tiltcal.core.errors import TiltcalError
from tiltcal.laboratory.scenario import parse_scenario
from tiltcal.validation.campaign.campaign_file import Campaign
from tiltcal.validation.campaign.factors import Document, with_fields

MIDDLE = 0.5
RUN_BYTES = 200  # of memory for what is known of a run: its key
RUN_S = 0.02  # of a short run


@dataclass(frozen=True)
class Point:
    """One set of values of all factors.

    Args:
        number: from 0.
        cell: number of the combination of levels.
        values: by factor, as results show them.
        document: the scenario there.
        matrix: of the design: ``A``, ``B`` or ``AB1``, ``AB2`` ... (A with that factor from B);
            empty without distributions.
        sample: number within its matrix.
        noise: number of its noise; points of one number share the seeds of their runs.
    """

    number: int
    cell: int
    values: dict[str, Any]
    document: Document
    matrix: str = ""
    sample: int = 0
    noise: int = 0


def points_of(campaign: Campaign) -> Iterator[Point]:
    """All points in order.

    Points of a grid share their seeds (common random numbers): their differences have less noise
    than either. So do A and AB, which differ by one factor; B has seeds of its own, as
    the noise is one more factor that A and B do not share.
    """
    names = [f.title for f in campaign.distributions]
    number = 0
    for cell, (labels, fields) in enumerate(cells_of(campaign)):
        if not names:
            yield Point(number, cell, labels, with_fields(campaign.document, fields))
            number += 1
            continue
        for matrix, x in _design(campaign):
            for j, row in enumerate(x):
                drawn = (f.value_of(x) for f, x in zip(campaign.distributions, row, strict=True))
                values = dict(zip(names, drawn, strict=True))
                changes = {str(f.field): v for f, v in zip(campaign.distributions, values.values())}
                document = with_fields(campaign.document, fields | changes)
                noise = 2 * j + (matrix == "B")
                yield Point(number, cell, labels | values, document, matrix, j, noise)
                number += 1


def cells_of(campaign: Campaign) -> Iterator[tuple[dict[str, Any], dict[str, Any]]]:
    """Each combination of levels: what results call it, and the fields that it sets."""
    grids = campaign.grids
    for levels in product(*(f.levels() for f in grids)):
        labels = {f.title: label for f, (label, _) in zip(grids, levels, strict=True)}
        yield labels, {path: v for _, fields in levels for path, v in fields.items()}


def count_of(campaign: Campaign) -> int:
    """How many points there are."""
    d = len(campaign.distributions)
    cells = prod(f.level_count for f in campaign.grids)
    return cells * (campaign.table.samples * (d + 2) if d else 1)


def require_countable(campaign: Campaign) -> None:
    """Refuse more runs than the budget allows, before any of them is named.

    Raises:
        TiltcalError: stating how many, and what they would take.
    """
    runs = count_of(campaign) * campaign.table.runs
    require_within(
        f"campaign {campaign.table.name}, {runs} runs",
        size=RUN_BYTES * runs,
        seconds=RUN_S * runs,
        less="ask for fewer levels, samples or runs",
    )


def check_levels(campaign: Campaign) -> None:
    """Refuse a level or a distribution that makes no scenario, before the first run.

    Raises:
        TiltcalError: of the first one.
    """
    trials: list[tuple[str, dict[str, Any]]] = []
    for f in campaign.grids:
        trials += [(f"{f.title} = {label}", fields) for label, fields in f.levels()]
    for f in campaign.distributions:
        middle = f.value_of(f.quantiles(np.array([MIDDLE]))[0])
        trials.append((f"{f.title} = {middle:g}", {str(f.field): middle}))
    for text, fields in trials:
        try:
            parse_scenario(with_fields(campaign.document, fields), f"with {text}")
        except TiltcalError as error:
            raise TiltcalError(
                f"campaign, factor {text}",
                found=str(error),
                need="a valid scenario at every level",
                do="correct the factor",
            ) from error


def require_allowed(campaign: Campaign, allow_commands: bool) -> None:
    """Refuse methods that are external programs, unless these are allowed.

    Raises:
        TiltcalError: a scenario of the campaign has one.
    """
    if allow_commands:
        return
    for _, fields in cells_of(campaign):
        for method in with_fields(campaign.document, fields).get("method", ()):
            if method.get("command"):
                raise TiltcalError(
                    f"campaign {campaign.table.name}",
                    found=f"the command {method['command'][0]}",
                    need="permission to run programs",
                    do="read it, then add --allow-commands",
                )


def _design(campaign: Campaign) -> Iterator[tuple[str, Array]]:
    """The matrices by name, (n, d) each, from one scrambled Sobol' sequence."""
    from scipy.stats import qmc

    factors = campaign.distributions
    d, n = len(factors), campaign.table.samples
    unit = qmc.Sobol(2 * d, rng=np.random.default_rng(campaign.seed)).random(n)
    both = np.column_stack([f.quantiles(unit[:, k]) for k, f in enumerate(factors * 2)])
    A, B = both[:, :d], both[:, d:]
    yield "A", A
    yield "B", B
    for k in range(d):
        AB = A.copy()
        AB[:, k] = B[:, k]
        yield f"AB{k + 1}", AB
