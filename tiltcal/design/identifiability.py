"""What a recording can and cannot separate: absorbed shares, detectable sizes, classes,
tie-breakers.

lambda: energy of an effect's signature over noise at its plausible size, after the adjustable terms
are re-fitted; separated lambda: the energy left after one alternative is re-tuned too. Two effects
that leave less than SEPARABLE of each other are in one class (docs/physics.md, "What is confused
with what").
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from tiltcal.core.arrays import Array
from tiltcal.core.assets import folder
from tiltcal.core.errors import TiltcalError
from tiltcal.design.recording_blocks import DESCRIPTIONS, describe_block
from tiltcal.effects import CATALOGUE
from tiltcal.effects.sensor.noise import Noise
from tiltcal.forward.jacobian import Column, gram, rows_of, sensitivity
from tiltcal.laboratory.scenario import Scenario, load_scenario

# (z(0.9995) + z(0.8))^2: non-centrality that is found in 80 % of recordings at 0.1 % false alarm
POWER = 17.07
SEPARABLE = 12.0  # separated non-centrality below which two explanations cannot be separated
BLIND = 1e-3  # share of a signature below which nothing is left of it

STAGE_BREAKERS = {
    frozenset({"table", "sensor"}): describe_block("remount"),
    frozenset({"table", "mount"}): describe_block("remount"),
    frozenset(
        {"environment", "sensor"}
    ): "turn the table by 90 deg: what is fixed in the world stays, what is in the sensor turns",
    frozenset(
        {"mount", "sensor"}
    ): "load another axis: a rotation of the mount leaves the norm unchanged",
    frozenset({"table"}): describe_block("reverse"),
    frozenset({"sensor"}): describe_block("tumble"),
}


@dataclass(frozen=True)
class ParameterVisibility:
    """What a recording sees of one parameter.

    Args:
        column: which.
        absorbed: share of its signature's energy that the adjustable terms take, 0..1.
        lambda_: non-centrality at plausible size, after them.
        detectable: size found with 80 % power at 0.1 % false alarm, in the column's unit; inf when
            nothing is left.
        unique: share of its amplitude that no other effect together can take.
        alternatives: labels that cannot be separated from it, with their cosine.
    """

    column: Column
    absorbed: float
    lambda_: float
    detectable: float
    unique: float
    alternatives: tuple[tuple[str, float], ...]


@dataclass(frozen=True)
class Confusion:
    """The answer for one scenario.

    Args:
        sights: one a parameter.
        rank: of all signatures that are visible.
        visible: how many are.
        samples: rows it stands for.
    """

    sights: tuple[ParameterVisibility, ...]
    rank: int
    visible: int
    samples: float


def confuse(scenario: Scenario, grade: str = "mid_mems") -> Confusion:
    """What the scenario's sequence can separate at a grade."""
    course = scenario.schedule
    rate = max(s.rate_hz for s in scenario.sensor)
    rows = rows_of(course, rate)
    columns = sensitivity(scenario, course, rows, grade=grade, known=scenario.effects)
    return confusion(columns, adjustable_mask(columns, scenario), float(rows.weight.sum()))


def adjustable_mask(
    columns: Sequence[Column], scenario: Scenario
) -> "np.ndarray[tuple[int], np.dtype[np.bool_]]":
    """Which columns are adjustable terms of their sensor."""
    allowed = {s.name: set(s.adjustable) for s in scenario.sensor}
    return np.array(
        [
            c.sensor is not None
            and not allowed[c.sensor].isdisjoint((c.effect, CATALOGUE[c.effect].calibration_term))
            for c in columns
        ],
        dtype=bool,
    )


def confusion(
    columns: Sequence[Column],
    adjustable: "np.ndarray[tuple[int], np.dtype[np.bool_]]",
    samples: float,
) -> Confusion:
    """Classes, shares and sizes from the Gram matrix of columns, the adjustable ones re-fitted."""
    G = gram(columns)
    norms = np.sqrt(np.diag(G))
    scale = np.where(norms > 0, norms, 1.0)
    C = G / np.outer(scale, scale)
    P = _projected(C, np.flatnonzero(adjustable & (norms > 0)))
    left = np.clip(np.diag(P), 0.0, 1.0)
    seen = (norms > 1e-3) & (left > BLIND**2) & ~adjustable
    uniqueness = _unique(P, seen)
    sights = []
    for i, c in enumerate(columns):
        if adjustable[i]:
            continue
        energy = float(norms[i] ** 2 * left[i])
        visible = bool(seen[i])
        detectable = c.size * float(np.sqrt(POWER / energy)) if visible else float("inf")
        alternatives = _alternatives(columns, P, norms, seen, i) if visible else ()
        absorbed = float(1 - left[i]) if norms[i] > 1e-3 else 0.0
        sights.append(
            ParameterVisibility(
                c,
                absorbed,
                energy if visible else 0.0,
                detectable,
                float(uniqueness[i]),
                alternatives,
            )
        )
    visible_C = C[np.ix_(norms > 1e-3, norms > 1e-3)]
    rank = (
        int(np.sum(np.linalg.eigvalsh(visible_C) > 1e-9 * len(visible_C))) if visible_C.size else 0
    )
    return Confusion(tuple(sights), rank, int(np.sum(norms > 1e-3)), samples)


def _projected(C: Array, nuisance: "np.ndarray[tuple[int], np.dtype[np.intp]]") -> Array:
    """Inner products after the nuisance columns are projected out."""
    if len(nuisance) == 0:
        return C
    values, vectors = np.linalg.eigh(C[np.ix_(nuisance, nuisance)])
    good = values > 1e-10 * values[-1]
    W = C[:, nuisance] @ (vectors[:, good] / np.sqrt(values[good]))
    return C - W @ W.T


def _unique(P: Array, seen: "np.ndarray[tuple[int], np.dtype[np.bool_]]") -> Array:
    """Share of each amplitude that is left when all other visible columns are fitted too."""
    found = np.zeros(len(P))
    index = np.flatnonzero(seen)
    if len(index) == 0:
        return found
    d = np.sqrt(np.diag(P)[index])
    inverse = np.linalg.pinv(P[np.ix_(index, index)] / np.outer(d, d), rcond=1e-9, hermitian=True)
    # 1 on the diagonal where a column is not in the null space
    projector = inverse @ (P[np.ix_(index, index)] / np.outer(d, d))
    share = 1 / np.sqrt(np.maximum(np.diag(inverse), 1.0))
    found[index] = np.where(np.abs(np.diag(projector) - 1) < 1e-4, share, 0.0)
    return found


def _alternatives(
    columns: Sequence[Column],
    P: Array,
    norms: Array,
    seen: "np.ndarray[tuple[int], np.dtype[np.bool_]]",
    i: int,
) -> tuple[tuple[str, float], ...]:
    """Labels that leave less than SEPARABLE of this signature when re-tuned, within twice their
    plausible size.
    """
    cosine = P[i] / np.sqrt(np.maximum(P[i, i] * np.diag(P), 1e-300))
    separated = norms[i] ** 2 * P[i, i] * (1 - np.minimum(cosine**2, 1.0))
    needed = (
        np.abs(cosine)
        * norms[i]
        * np.sqrt(P[i, i])
        / np.maximum(norms * np.sqrt(np.maximum(np.diag(P), 0.0)), 1e-30)
    )
    hit = seen & (separated < SEPARABLE) & (np.abs(cosine) > 0.9) & (needed < 2.0)
    hit[i] = False
    order = np.argsort(-np.abs(cosine))
    return tuple((columns[j].label, float(cosine[j])) for j in order if hit[j])


def classes(found: Confusion) -> list[tuple[str, ...]]:
    """Groups of effect ids whose members are mutual alternatives, largest first; effects alone in
    theirs are left out.
    """
    links: dict[str, set[str]] = {}
    for sight in found.sights:
        for label, _ in sight.alternatives:
            links.setdefault(sight.column.effect, set()).add(label.split("[")[0].split(".")[0])
    groups = {tuple(sorted({id, *others})) for id, others in links.items() if others - {id}}
    return sorted(groups, key=lambda g: (-len(g), g))


def tie_breaker(first: str, second: str) -> str:
    """What to record to separate two effects."""
    one, other = CATALOGUE[first], CATALOGUE[second]
    known = one.distinguished_by.get(second) or other.distinguished_by.get(first)
    if known is not None:
        return describe_block(known) if known in DESCRIPTIONS else known
    return STAGE_BREAKERS.get(frozenset({one.stage, other.stage}), describe_block("repeat"))


def most_similar_effects(id: str, count: int = 6) -> list[tuple[str, float]]:
    """The effects whose signatures are nearest to one's on the catalogue's own sequences, with
    |cosine|, largest first.

    Each parameter against each, after bias, scale and cross-axis terms are re-fitted.
    """
    scenario = reference_scenario(id)
    columns = sensitivity(
        scenario,
        scenario.schedule,
        rows_of(scenario.schedule, max(s.rate_hz for s in scenario.sensor)),
        known=[e for e in scenario.effects if not isinstance(e, Noise)],
    )
    G = gram(columns)
    norms = np.sqrt(np.maximum(np.diag(G), 1e-30))
    P = _projected(G / np.outer(norms, norms), np.flatnonzero(adjustable_mask(columns, scenario)))
    left = np.sqrt(np.maximum(np.diag(P), 1e-30))
    found: dict[str, float] = {}
    mine = [i for i, c in enumerate(columns) if c.effect == id and left[i] > 0.01]
    for i in mine:
        for j, c in enumerate(columns):
            if c.effect != id and left[j] > 0.01:
                found[c.effect] = max(
                    found.get(c.effect, 0.0), min(abs(float(P[i, j] / (left[i] * left[j]))), 1.0)
                )
    return sorted(found.items(), key=lambda item: -item[1])[:count]


def reference_scenario(id: str) -> Scenario:
    """The scenario of the catalogue that exercises an effect; of an installed package's effect,
    one that exercises an effect of its stage on such a sensor.

    Raises:
        TiltcalError: none does.
    """
    from tiltcal.effects import CATALOGUE

    paths = sorted(folder("scenarios").glob("catalogue_*.toml"))
    scenarios = [load_scenario(path) for path in paths]
    position = {i: (c.stage, c.kinds) for i, c in CATALOGUE.items()}
    alike = {i for i in position if id in position and position[i] == position[id]}
    for ids in ({id}, alike):
        for scenario in scenarios:
            if any(t.id in ids for t in scenario.effect):
                return scenario
    raise TiltcalError(
        f"effect {id}",
        found="no scenario that exercises it",
        need="one",
        do="add it to a catalogue scenario",
    )
