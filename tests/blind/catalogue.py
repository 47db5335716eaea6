"""Everything that a laboratory can conceal."""

from blind.electronics import electronics
from blind.laboratory import Lab
from blind.mechanics import mechanics
from blind.sensing import sensing
from blind.spec import Shape, Spec
from blind.unlisted import unlisted


def listed(lab: Lab) -> list[Spec]:
    """What the catalogue of effects has."""
    return mechanics(lab) + sensing(lab) + electronics(lab)


def settled(spec: Spec, shape: Shape) -> Shape:
    """The shape as another recording sees it: an event lies behind it."""
    return {**shape, "settled": True} if spec.later == "after" else shape


__all__ = ["listed", "settled", "unlisted"]
