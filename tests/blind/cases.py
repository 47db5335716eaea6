"""A case: a laboratory, what it conceals, the files an honest user has, and the truth that nobody
gets before the answer.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from blind.catalogue import bound, listed, settled, unlisted_by
from blind.faults import Rows, faults
from blind.laboratory import KINDS, Lab, another, draw
from blind.noise import draw as draw_noise
from blind.oracle import TELL, Found, Oracle, prediction
from blind.second_author_nulls import ordinary
from blind.spec import Shape, Spec
from blind.truth import Hidden, told_of, told_of_fault
from blind.world import Past, Physics, readings

TYPES = ("null", "single", "odd", "data", "pair", "unlisted", "impossible", "triple")
AUTHORED = ("null", "unlisted")  # types of which every author has cases
SEVERAL = {"pair": 2, "triple": 3}
SIX = ("six_faces", "six_any")
TRIES = 60
LEAST = 60.0  # non-centrality below which nothing is concealed: chance decides there


@dataclass(frozen=True)
class Case:
    """All of one trial. ``truth`` is plain data."""

    lab: Lab
    rows: Rows
    other: Lab | None
    rows_other: Rows | None
    clean_other: Rows | None
    truth: dict[str, Any]


def possible(kind: str, type_: str) -> bool:
    """Six poses carry nulls and the impossible only; elsewhere nothing that is drawn is
    impossible. Hardly three effects can be told apart on the vertical table.
    """
    if (kind, type_) == ("vertical_turn", "triple"):
        return False
    return (type_ in ("null", "impossible")) if kind in SIX else type_ != "impossible"


def make(kind: str, type_: str, stratum: int, seed: Sequence[int], author: str = "first") -> Case:
    """Draw one case. ``author``: who invented what is unlisted, or the ways to be ordinary.

    Raises:
        RuntimeError: no draw gave an effect that fits.
    """
    rng = np.random.default_rng(seed)
    for _ in range(TRIES):
        lab = draw(rng, kind, stratum)
        if type_ == "null" and author == "second":
            lab = ordinary(rng, lab)
        hidden = None if lab is None else _conceal(rng, lab, type_, author)
        if hidden is not None:
            return _finish(rng, lab, type_, author, hidden)
    raise RuntimeError(f"{kind} {type_} {list(seed)}: no effect fits")


def _conceal(rng: np.random.Generator, lab: Lab, type_: str, author: str) -> list[Hidden] | None:
    if type_ in ("null", "data"):
        return []
    oracle = Oracle(lab, rng)
    specs = (
        unlisted_by(author, lab)
        if type_ == "unlisted"
        else [s for s in listed(lab) if s.drawn and (type_ != "odd" or s.odd)]
    )
    if type_ == "impossible":
        specs = [
            s
            for s in listed(lab)
            if s.id.startswith("acc_K")
            or s.id in ("acc_Koq", "acc_scale_asym", "acc_bias_asym", "adc_inl")
        ]
    if not specs:
        return None
    first = _draw(rng, oracle, _pick(rng, specs), type_)
    if first is None or type_ not in SEVERAL:
        return first and [first]
    return _beside(rng, oracle, specs, [first], SEVERAL[type_])


def _beside(
    rng: np.random.Generator, oracle: Oracle, specs: Sequence[Spec], drawn: list[Hidden], n: int
) -> list[Hidden] | None:
    """Others of another id beside what is drawn, until there are n that can be told apart."""
    while len(drawn) < n:
        used = {h.spec.id for h in drawn}
        one = _draw(rng, oracle, _pick(rng, [s for s in specs if s.id not in used]), "single")
        together = one and _together(oracle, [*drawn, one])
        if not together:
            return None
        drawn = together
    return drawn


def _pick(rng: np.random.Generator, specs: Sequence[Spec]) -> Spec:
    """Every id as likely as another."""
    name = rng.choice(sorted({s.id for s in specs}))
    own = [s for s in specs if s.id == name]
    return own[int(rng.integers(len(own)))]


def _draw(rng: np.random.Generator, oracle: Oracle, spec: Spec, type_: str) -> Hidden | None:
    """One effect at a size drawn by its non-centrality; None where it cannot be seen, or is not
    itself.
    """
    odd = spec.odd is not None and (type_ == "odd")
    shapes = spec.shapes(rng, oracle.lab)
    shape = (
        spec.odd(rng, oracle.lab) if odd and spec.odd else shapes[int(rng.integers(len(shapes)))]
    )
    way = (
        rng.normal(size=len(spec.names))
        if spec.together
        else rng.choice([-1.0, 1.0]) * np.eye(len(spec.names))[rng.integers(len(spec.names))]
    )
    if spec.id == "gyr_gsens":
        way = np.repeat(np.eye(3)[rng.integers(3)], 3) * rng.normal(size=9)
    way /= np.abs(way).max()
    way = np.abs(way) if len(way) == 1 and spec.names[0] in POSITIVE else way
    full = spec.plausible * spec.unit * way
    if type_ == "impossible":
        return _hidden(
            oracle, spec, shape, full * rng.uniform(0.2, 1.0), textbook=True, unseen=True
        )
    r = oracle.residual(oracle.signal([spec.physics(0.1 * full, shape)])[:, :, None])
    lam = float((r**2).sum())
    size = 0.1 * np.sqrt(10 ** rng.uniform(*spec.strength) / max(lam, 1e-12))
    return _hidden(oracle, spec, shape, full * min(size, 1.3), textbook=not odd)


POSITIVE = ("mix_unitless", "latency_ms", "tau_ms", "width_arcsec", "sigma_arcsec", "skew_ms")


def _hidden(
    oracle: Oracle, spec: Spec, shape: Shape, p: np.ndarray, textbook: bool, unseen: bool = False
) -> Hidden | None:
    r = oracle.residual(oracle.signal([spec.physics(p, shape)])[:, :, None])
    lam = float((r**2).sum())
    if unseen:
        return Hidden(spec, shape, p, Found(lam, 0.0, {}, {}), textbook) if lam < 5 else None
    if lam < LEAST:
        return None
    found = oracle.judge(spec, shape, spec.physics(p, shape))
    nearest = min(found.left.values(), default=np.inf)
    if not spec.listed and nearest < max(50.0, 0.2 * lam):
        return None  # some listed effect says it nearly as well
    if not textbook and nearest + TELL < found.own:
        return None  # its odd form is another effect's
    return Hidden(spec, shape, p, found, textbook)


def _together(oracle: Oracle, every: Sequence[Hidden]) -> list[Hidden] | None:
    """All, each judged beside the others; None where some hide another."""
    out = []
    for one in every:
        others = [h for h in every if h is not one]
        columns = [oracle.residual(oracle.columns(h.spec, h.shape)) for h in others]
        found = oracle.judge(
            one.spec, one.shape, one.physics, beside=[c for U in columns for c in U.T]
        )
        if found.lam < 100 or {h.spec.id for h in others} & set(found.inseparable):
            return None
        out.append(Hidden(one.spec, one.shape, one.p, found, one.textbook))
    return out


# --------------------------------------------------------------------------------------------------
# ----------- the files


def _finish(
    rng: np.random.Generator, lab: Lab, type_: str, author: str, hidden: list[Hidden]
) -> Case:
    hooks = [h.physics for h in hidden]
    ideal = _clean(rng, lab, hooks)
    rows, effects = _noisy(rng, lab, ideal), [told_of(h) for h in hidden]
    if type_ == "data":
        rows, effects = _broken(rng, lab)
    truth: dict[str, Any] = {
        "kind": lab.kind,
        "type": type_,
        "author": author,
        "nuisance": lab.noise.nuisance.id if lab.noise.nuisance else None,
        "walk": lab.noise.walk_stratum,
        "flicker": lab.noise.flicker > 0,
        "effects": effects,
        "sigma": {n: lab.sensors[s].sigma for n, (s, _) in zip(channel_names(lab), lab.channels)},
    }
    if (
        lab.table == "handheld"
        or lab.unlocked
        or type_ in ("data", "impossible")
        or any(h.spec.later == "none" for h in hidden)
    ):
        return Case(lab, _logged(lab, rows), None, None, None, truth)
    other = another(rng, lab)
    after = [bound(h.spec, other).physics(h.p, settled(h.spec, h.shape)) for h in hidden]
    clean = _clean(rng, other, after)
    truth["heldout"] = prediction(
        Oracle(lab, rng), other, [(h.spec, h.shape, h.p) for h in hidden], rows.y - ideal.y
    )
    return Case(lab, _logged(lab, rows), other, _noisy(rng, other, clean), clean, truth)


def _logged(lab: Lab, rows: Rows) -> Rows:
    """The rows that are in the file."""
    own = lab.noise.nuisance
    if own is None or own.logged is None:
        return rows
    kept = own.logged(rows.t)
    return Rows(rows.t[kept], rows.table[kept], rows.y[kept], rows.T[kept])


def channel_names(lab: Lab) -> list[str]:
    """accel_x, ... in file order."""
    return [f"{lab.sensors[s].name}_{lab.sensors[s].axes[i]}" for s, i in lab.channels]


def _clean(rng: np.random.Generator, lab: Lab, hooks: Sequence[Physics]) -> Rows:
    n = int(lab.track.end_s * lab.rate_hz)
    t = (np.arange(n) + lab.noise.jitter * rng.uniform(-1, 1, n)) / lab.rate_hz
    t = np.round(t - t[0], 4)
    own = lab.noise.nuisance
    t = own.stamps(rng, t) if own and own.stamps else t
    return Rows(
        t, lab.track.angles(t), readings(lab, hooks, t, Past(lab)), np.round(lab.room.at(t), 2)
    )


def _noisy(rng: np.random.Generator, lab: Lab, clean: Rows) -> Rows:
    table = clean.table + rng.normal(0, lab.noise.readout_rad, clean.table.shape)
    return Rows(clean.t, table, clean.y + draw_noise(rng, lab, clean.t), clean.T)


def _broken(rng: np.random.Generator, lab: Lab) -> tuple[Rows, list[dict[str, Any]]]:
    clean = _clean(rng, lab, ())
    choice = faults(lab, clean)
    fault = choice[int(rng.integers(len(choice)))]
    said = fault.make(rng, lab, clean) if fault.before_noise else {}
    rows = _noisy(rng, lab, clean)
    said = said or fault.make(rng, lab, rows)
    return rows, [told_of_fault(fault, said)]


__all__ = ["AUTHORED", "KINDS", "TYPES", "Case", "Hidden", "channel_names", "make", "possible"]
