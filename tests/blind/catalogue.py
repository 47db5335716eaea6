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


def bound(spec: Spec, lab: Lab) -> Spec:
    """The same effect in another recording's laboratory: its hooks follow that motion and that
    temperature.
    """
    key = (spec.id, spec.axes, spec.sensors)
    return next(s for s in listed(lab) + unlisted(lab) if (s.id, s.axes, s.sensors) == key)


__all__ = ["bound", "listed", "settled", "unlisted"]
