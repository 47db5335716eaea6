"""One acceptance limit, and the chance that it leaves to a correct method."""

from collections.abc import Callable
from dataclasses import dataclass


@dataclass(frozen=True)
class Limit:
    """One acceptance limit: what was reached, what was allowed, in words.

    Args:
        interval: 95 % interval of what was reached, where it is an estimate.
        where: the seed or parameter that it is about, where it is about one.
    """

    name: str
    reached: float
    allowed: str
    passed: bool
    interval: tuple[float, float] | None = None
    where: str = ""


Judge = Callable[[float], Limit]
"""Makes a limit from the probability with which a correct method may break it."""
