"""What a campaign varies: a grid of levels, or a distribution.

A factor may be any field of a scenario by its path, such as ``site.latitude_deg``,
``sensor.accel.rate_hz``, ``effect.acc_K2.k2_x_ug_g2`` or ``sequence``.
"""

from copy import deepcopy
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import Field, model_validator

from tiltcal.core.arrays import Array
from tiltcal.core.errors import TiltcalError, nearest
from tiltcal.setup.part import StrictTable

Document = dict[str, Any]
"""A scenario as a TOML document."""


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
        position: Any = changed
        for k, token in enumerate(way):
            position = _part(position, token, path, effects=way[:k] == ["effect"])
        if isinstance(position, list):
            raise _nowhere(path, last, "a list of parts", "name one: PART.NUMBER.KEY")
        if not isinstance(position, dict):
            raise _nowhere(path, last, "a value that has no parts", "shorten the path")
        position[last] = deepcopy(value)
    return changed


def _part(position: Any, token: str, path: str, effects: bool) -> Any:
    if isinstance(position, dict):
        if token not in position and token != "effect":
            raise _nowhere(path, token, "no such part", nearest(token, list(position)))
        return position.setdefault(token, [])
    if not isinstance(position, list):
        raise _nowhere(path, token, "a value that has no parts", "shorten the path")
    named = [part for k, part in enumerate(position, start=1) if token in _names(part, k)]
    if not named and effects:
        named = [_effect(token)]
        position.append(named[0])
    if len(named) != 1:
        text = f"{len(named) or 'no'} parts of this name"
        choices = [name for k, part in enumerate(position, start=1) for name in _names(part, k)]
        raise _nowhere(path, token, text, "choose one of " + ", ".join(choices))
    return named[0]


def _names(part: Any, number: int) -> list[str]:
    names = [f"{number}"]
    if isinstance(part, dict):
        names += [str(part[key]) for key in ("name", "id") if key in part]
        where = part.get("sensor") or part.get("axis")
        if "id" in part and where:
            names.append(f"{part['id']}[{where}]")
    return names


def _effect(token: str) -> Document:
    name, _, where = token.removesuffix("]").partition("[")
    return {"id": name} | ({"sensor": where} if where else {})


def _nowhere(path: str, token: str, found: str, do: str) -> TiltcalError:
    return TiltcalError(
        f"field {path}", found=f"{found} at '{token}'", need="a field of the scenario", do=do
    )


class Level(StrictTable):
    """One level that sets several fields."""

    label: str
    """What results call the level."""
    set: dict[str, Any]
    """Path of each field, and its value."""


class Factor(StrictTable):
    """One factor, by one of these:

    ``values``: levels of one field. ``start, stop, count``: evenly spaced ones. ``level``: levels
    that set several fields. ``distribution``: values drawn at random.
    """

    name: str = ""
    """What results call the factor; by default its field."""
    field: str | None = None
    """Path of a field of the scenario, such as `site.latitude_deg`."""
    values: Annotated[tuple[Any, ...], Field(min_length=1)] | None = None
    """Levels of the field, of any kind that it takes."""
    start: float | None = None
    """First of evenly spaced levels."""
    stop: float | None = None
    """Last of them."""
    count: Annotated[int, Field(ge=1)] | None = None
    """How many of them."""
    log: bool = False
    """Space them evenly in their logarithm."""
    level: Annotated[tuple[Level, ...], Field(min_length=1)] | None = None
    """Levels that set several fields."""
    distribution: Literal["uniform", "loguniform", "integer", "normal"] | None = None
    """Distribution of the field; `integer` has `low` and `high` among its values."""
    low: float | None = None
    """Lower end of `uniform`, `loguniform` and `integer`."""
    high: float | None = None
    """Upper end of the same."""
    mean: float | None = None
    """Mean of `normal`."""
    sigma: Annotated[float, Field(gt=0)] | None = None
    """Standard deviation of `normal`."""

    @model_validator(mode="after")
    def _distinct(self) -> "Factor":
        labels = [level.label for level in self.level or ()]
        for words, given in (("value", self.values or ()), ("label", labels)):
            twice = [v for k, v in enumerate(given) if v in given[:k]]
            if twice:
                raise ValueError(f"the {words} {twice[0]!r} stands twice")
        return self

    @model_validator(mode="after")
    def _one_kind(self) -> "Factor":
        kinds = [self.values, self.start, self.level, self.distribution]
        if sum(kind is not None for kind in kinds) != 1:
            raise ValueError("give one of values, start, level and distribution")
        if (self.field is None) == (self.level is None):
            raise ValueError("give field, or with level the fields that each one sets")
        if self.start is not None and (self.stop is None or self.count is None):
            raise ValueError("start needs stop and count")
        if self.log and not (self.start and self.stop and self.start * self.stop > 0):
            raise ValueError("log needs start and stop of one sign, and not 0")
        if self.distribution is not None:
            self._check_distribution()
        if not self.title:
            raise ValueError("give name")
        return self

    def _check_distribution(self) -> None:
        if self.distribution == "normal":
            if self.mean is None or self.sigma is None:
                raise ValueError("normal needs mean and sigma")
        elif self.low is None or self.high is None or not self.low < self.high:
            raise ValueError(f"{self.distribution} needs low below high")
        elif self.distribution == "loguniform" and self.low <= 0:
            raise ValueError("loguniform needs low above 0")
        elif self.distribution == "integer" and not (self.low % 1 == self.high % 1 == 0):
            raise ValueError("integer needs whole numbers low and high")

    @property
    def title(self) -> str:
        """Its name, or its field without ``effect``."""
        return self.name or (self.field or "").removeprefix("effect.")

    @property
    def random(self) -> bool:
        """Whether it has a distribution."""
        return self.distribution is not None

    @property
    def level_count(self) -> int:
        """How many levels a grid has, without making them."""
        if self.level is not None:
            return len(self.level)
        return len(self.values or ()) if self.start is None else self.count or 0

    def levels(self) -> list[tuple[Any, dict[str, Any]]]:
        """What results call each level of a grid, and the fields that it sets."""
        if self.level is not None:
            return [(level.label, level.set) for level in self.level]
        assert self.field is not None
        values: list[Any] = list(self.values or ())
        if self.start is not None:
            assert self.stop is not None
            assert self.count is not None
            space = np.geomspace if self.log else np.linspace
            values = [float(x) for x in space(self.start, self.stop, self.count)]
        return [(_label(value), {self.field: value}) for value in values]

    def quantiles(self, p: Array) -> Array:
        """Values at probabilities, (n,)."""
        from scipy import stats

        if self.mean is not None and self.sigma is not None:
            return np.asarray(stats.norm(self.mean, self.sigma).ppf(p))
        assert self.low is not None
        assert self.high is not None
        if self.distribution == "integer":
            return np.asarray(stats.randint(self.low, self.high + 1).ppf(p))
        if self.distribution == "loguniform":
            return np.asarray(stats.loguniform(self.low, self.high).ppf(p))
        return np.asarray(stats.uniform(self.low, self.high - self.low).ppf(p))

    def value_of(self, quantile: float) -> int | float:
        """A quantile as the scenario takes it."""
        return int(quantile) if self.distribution == "integer" else float(quantile)


def _label(value: Any) -> Any:
    """A number or a text as it is, anything else as text."""
    return value if isinstance(value, int | float | str) else str(value)
