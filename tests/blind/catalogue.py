"""Everything that a laboratory can conceal."""

from blind.electronics import electronics
from blind.laboratory import Lab
from blind.mechanics import mechanics
from blind.second_author import second_author
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
    every = listed(lab) + unlisted(lab) + second_author(lab)
    return next(s for s in every if (s.id, s.axes, s.sensors) == key)


def unlisted_by(author: str, lab: Lab) -> list[Spec]:
    """What the catalogue does not have, by who invented it."""
    return {"first": unlisted, "second": second_author}[author](lab)


AUTHORS = ("first", "second")
__all__ = ["AUTHORS", "bound", "listed", "settled", "unlisted", "unlisted_by"]
