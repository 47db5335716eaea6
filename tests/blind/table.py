"""Many judged answers as rates with Wilson intervals, beside what is required."""

import math
import statistics
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

from blind.catalogue import AUTHORS

Plain = dict[str, Any]
FAINT = 40.0  # from here to SEEN a detection is welcome and not owed
SEEN = 100.0  # non-centrality from which a detection without a static record is owed


@dataclass(frozen=True)
class Line:
    """A rate, or a median (n = how many). ``limit``: (sense, value); value in the same unit as the
    rate.
    """

    name: str
    hits: float
    n: int
    limit: tuple[str, float] | None = None
    is_rate: bool = True

    @property
    def interval(self) -> tuple[float, float]:
        """95 %."""
        return wilson(int(self.hits), self.n)

    @property
    def failed(self) -> bool:
        """The whole interval lies on the wrong side."""
        if self.limit is None or self.n == 0:
            return False
        sense, value = self.limit
        low, high = self.interval if self.is_rate else (self.hits, self.hits)
        return low > value if sense == "<=" else high < value


def wilson(k: int, n: int, z: float = 1.959964) -> tuple[float, float]:
    """Wilson's 95 % interval of k out of n."""
    if n == 0:
        return 0.0, 1.0
    p, c = k / n, z * z / n
    middle, half = (p + c / 2) / (1 + c), z * math.sqrt(p * (1 - p) / n + c / (4 * n)) / (1 + c)
    # at its ends free of rounding
    return (middle - half if k else 0.0), (middle + half if k < n else 1.0)


def _rate(name: str, values: Iterable[Any], limit: tuple[str, float] | None = None) -> Line:
    known = [bool(v) for v in values if v is not None]
    return Line(name, sum(known), len(known), limit)


def _median(name: str, values: Sequence[float], limit: tuple[str, float] | None = None) -> Line:
    return Line(
        name, statistics.median(values) if values else math.nan, len(values), limit, is_rate=False
    )


def lines(results: Sequence[Plain]) -> list[Line]:
    """The score table."""
    return (
        _alarms(results)
        + _seen(results)
        + _names(results)
        + _open_world(results)
        + [line for author in AUTHORS for line in _by_author(results, author)]
        + _figures(results)
    )


def _alarms(results: Sequence[Plain]) -> list[Line]:
    nulls = [r for r in results if r["type"] == "null"]
    out = [_rate("false alarms", [r["claims"] for r in nulls], ("<=", 0.02))]
    for walk in (1, 4):
        for flicker in (False, True):
            own = [r["claims"] for r in nulls if (r["walk"], r["flicker"]) == (walk, flicker)]
            out.append(
                _rate(
                    f"  random walk x{walk}, flicker {'on' if flicker else 'off'}",
                    own,
                    ("<=", 0.02),
                )
            )
    return out


def _seen(results: Sequence[Plain]) -> list[Line]:
    strong = [
        r
        for r in results
        if r["lambda"]
        and all(x is not None for x in r["lambda"])
        and max(r["lambda"]) >= SEEN
        and r["type"] != "impossible"
    ]
    faulty = [r["claims"] for r in results if r["type"] == "data"]
    return [
        _rate("detected, lambda >= 100", [r["claims"] for r in strong], (">=", 0.95)),
        _rate("detected, faults of the data", faulty, (">=", 0.95)),
    ]


def _effects(results: Sequence[Plain], *types: str) -> list[Plain]:
    chosen = [e for r in results if r["type"] in types for e in r["effects"]]
    return [e for e in chosen if e["lambda"] is None or e["lambda"] >= SEEN]


def _names(results: Sequence[Plain]) -> list[Line]:
    singles = _effects(results, "single", "odd", "data")
    out = []
    for name, types, least in (
        ("textbook", ("single",), 0.9),
        ("not textbook", ("odd",), 0.8),
        ("faults of the data", ("data",), 0.9),
    ):
        own = _effects(results, *types)
        out.append(
            _rate(
                f"truth named first or in an honest class, {name}",
                [e["good"] for e in own],
                (">=", least),
            )
        )
        out.append(_rate("  named first", [e["named"] for e in own]))
        out.append(_rate("  in its class, honest or not", [e["in_class"] for e in own]))
    return [
        *out,
        _rate(
            "a wrong name stated with certainty, singles",
            [e["wrong_certain"] for e in singles],
            ("<=", 0.03),
        ),
        _rate("certain of what nobody can tell, singles", [e["false_certainty"] for e in singles]),
        _rate("class padded, singles", [bool(e["padded"]) for e in singles]),
        _rate("stage right, singles", [e["stage_right"] for e in singles], (">=", 0.9)),
        *_several(results, "pair", "pairs: both", (">=", 0.8)),
        *_several(results, "triple", "triples: all three"),
    ]


def _several(
    results: Sequence[Plain], type_: str, words: str, limit: tuple[str, float] | None = None
) -> list[Line]:
    """Cases with several effects, each visible beside the others."""
    own = [r for r in results if r["type"] == type_ and min(r["lambda"]) >= SEEN]
    return [
        _rate(f"{words} found", [all(e["in_class"] for e in r["effects"]) for r in own], limit),
        _rate(
            f"{words} named or in honest classes",
            [all(e["good"] for e in r["effects"]) for r in own],
        ),
    ]


def _open_world(results: Sequence[Plain]) -> list[Line]:
    new = [r for r in results if r["type"] == "unlisted"]
    effects = _effects(results, "unlisted")
    return [
        _rate("unlisted: detected in any form", [r["claims"] for r in new], (">=", 0.85)),
        _rate("unlisted: said so", [e["said"] for e in effects], (">=", 0.75)),
        _rate(
            "unlisted: a wrong name stated with certainty",
            [e["wrong_certain"] for e in effects],
            ("<=", 0.05),
        ),
        _rate(
            "unlisted: right channel and coordinate",
            [e["channel"] and e["coordinate"] for e in effects],
            (">=", 0.8),
        ),
        _rate("  right channel", [e["channel"] for e in effects]),
        _rate("  right coordinate", [e["coordinate"] for e in effects]),
        _rate(
            "impossible: named all the same",
            [r["claims"] for r in results if r["type"] == "impossible"],
            ("<=", 0.02),
        ),
    ]


def _by_author(results: Sequence[Plain], author: str) -> list[Line]:
    """What one author invented: ordinary recordings and unlisted physics. None where no such case
    was run.
    """
    own = [r for r in results if r.get("author", "first") == author]
    nulls = [r["claims"] for r in own if r["type"] == "null"]
    new = [r for r in own if r["type"] == "unlisted"]
    if not nulls and not new:
        return []
    every = [e for r in new for e in r["effects"]]
    strong = [e for e in every if e["lambda"] >= SEEN]
    held = [r["heldout"] for r in new if (r.get("heldout") or {}).get("product") is not None]
    return [
        _rate(f"{author} author: false alarms", nulls),
        _rate("  unlisted said so, lambda >= 100", [e["said"] for e in strong]),
        _rate("  unlisted given a certain wrong name", [e["certain_name"] for e in every]),
        _rate(
            "  coordinate plausible, of those said so",
            [e["coordinate"] for e in every if e["said"]],
        ),
        _rate("  detected at lambda >= 100", _claimed(new, SEEN, math.inf)),
        _rate("  detected at lambda 40 to 100", _claimed(new, FAINT, SEEN)),
        _median(
            "  unlisted: rms over the oracle's (median)",
            [h["product"] / h["oracle"] for h in held],
        ),
        _median(
            "  unlisted: rms over the nominal model's (median)",
            [h["product"] / h["nominal"] for h in held],
        ),
    ]


def _claimed(results: Sequence[Plain], low: float, high: float) -> list[bool]:
    """Whether anything was claimed, for each case between two non-centralities."""
    return [r["claims"] for r in results if low <= max(r["lambda"]) < high]


def _figures(results: Sequence[Plain]) -> list[Line]:
    pulls = [p for e in _effects(results, "single", "pair", "triple") for p in e["pulls"]]
    held = [r for r in results if r.get("heldout") and r["heldout"]["product"] is not None]
    plain = [r["heldout"] for r in held if r["type"] == "null"]
    telling = [r["heldout"] for r in held if r["heldout"]["nominal"] > 2 * r["heldout"]["oracle"]]
    right = [
        r["heldout"] for r in held if r["effects"] and all(e.get("good") for e in r["effects"])
    ]
    every = [r for r in results if "heldout" in r]
    return [
        _rate("parameters within 3 sigma, textbook", [p <= 3 for p in pulls], (">=", 0.95)),
        _rate("held-out recording predicted", [r["heldout"]["product"] is not None for r in every]),
        _median(
            "  rms over the oracle's, class right (median)",
            [h["product"] / h["oracle"] for h in right],
            ("<=", 1.3),
        ),
        _median(
            "  rms over the nominal model's (median)",
            [h["product"] / h["nominal"] for h in telling],
            ("<=", 0.3),
        ),
        _rate(
            "  worse than the nominal model by 2 %",
            [h["product"] > 1.02 * h["nominal"] for h in telling],
            ("<=", 0.03),
        ),
        _median(
            "  nothing concealed: rms over the best fit's (median)",
            [h["product"] / h["oracle"] for h in plain],
        ),
        _rate("verdict as expected", [r["verdict_right"] for r in results]),
        _rate("no answer at all", [r["crashed"] for r in results], ("<=", 0.0)),
        _median("seconds a diagnosis (median)", [r["seconds"] for r in results]),
        _median(
            "seconds a diagnosis (longest)",
            [max((r["seconds"] for r in results), default=math.nan)],
        ),
    ]


def show(table: Sequence[Line]) -> str:
    """The table in text."""
    out = [f"{'':58s} {'':>11s}  {'rate':>7s}  {'95 % interval':>15s}  required"]
    for line in table:
        owed = f"{line.limit[0]} {line.limit[1]:g}" if line.limit else ""
        if line.is_rate:
            low, high = line.interval
            rate = f"{100 * line.hits / line.n:5.1f} %" if line.n else "-"
            body = (
                f"{int(line.hits):5d}/{line.n:<5d}  {rate:>7s} "
                f" {f'{100 * low:.1f} .. {100 * high:.1f} %':>15s}"
            )
            owed = f"{line.limit[0]} {100 * line.limit[1]:g} %" if line.limit else ""
        else:
            body = f"{'n = ' + str(line.n):>11s}  {line.hits:7.3g}  {'':>15s}"
        out.append(f"{line.name:58s} {body}  {owed}{'   NOT REACHED' if line.failed else ''}")
    return "\n".join(out)
