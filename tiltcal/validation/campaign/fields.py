"""Any field of a scenario by its path, such as ``site.latitude_deg``, ``sensor.accel.rate_hz``,
``effect.acc_K2.k2_x_ug_g2`` or ``sequence``.
"""

from copy import deepcopy
from typing import Any

from tiltcal.core.errors import TiltcalError, nearest

Document = dict[str, Any]
"""A scenario as its TOML says it."""


def with_fields(document: Document, values: dict[str, Any]) -> Document:
    """A copy of a scenario with some fields set.

    A part of a list is chosen by its number from 1, its name or its id; of several effects with one
    id by ``id[sensor]``. An effect that is not there is added.

    Raises:
        TiltcalError: a path leads nowhere.
    """
    changed = deepcopy(document)
    for path, value in values.items():
        *way, last = path.split(".")
        place: Any = changed
        for k, word in enumerate(way):
            place = _part(place, word, path, effects=way[:k] == ["effect"])
        if isinstance(place, list):
            raise _nowhere(path, last, "a list of parts", "name one: PART.NUMBER.KEY")
        if not isinstance(place, dict):
            raise _nowhere(path, last, "a value that has no parts", "shorten the path")
        place[last] = deepcopy(value)
    return changed


def _part(place: Any, word: str, path: str, effects: bool) -> Any:
    if isinstance(place, dict):
        if word not in place and word != "effect":
            raise _nowhere(path, word, "no such part", nearest(word, list(place)))
        return place.setdefault(word, [])
    if not isinstance(place, list):
        raise _nowhere(path, word, "a value that has no parts", "shorten the path")
    named = [part for k, part in enumerate(place, start=1) if word in _names(part, k)]
    if not named and effects:
        named = [_effect(word)]
        place.append(named[0])
    if len(named) != 1:
        words = f"{len(named) or 'no'} parts of this name"
        choices = [name for k, part in enumerate(place, start=1) for name in _names(part, k)]
        raise _nowhere(path, word, words, "choose one of " + ", ".join(choices))
    return named[0]


def _names(part: Any, number: int) -> list[str]:
    names = [f"{number}"]
    if isinstance(part, dict):
        names += [str(part[key]) for key in ("name", "id") if key in part]
        where = part.get("sensor") or part.get("axis")
        if "id" in part and where:
            names.append(f"{part['id']}[{where}]")
    return names


def _effect(word: str) -> Document:
    name, _, where = word.removesuffix("]").partition("[")
    return {"id": name} | ({"sensor": where} if where else {})


def _nowhere(path: str, word: str, found: str, do: str) -> TiltcalError:
    return TiltcalError(
        f"field {path}", found=f"{found} at '{word}'", need="a field of the scenario", do=do
    )
