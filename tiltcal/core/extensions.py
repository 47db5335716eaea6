"""What installed packages bring: the entry points of a group, found when they are first needed."""

from collections.abc import Callable, Iterable, Sequence
from types import ModuleType
from typing import Any, TypeVar

from tiltcal.core.errors import TiltcalError

Kind = TypeVar("Kind")


def load(group: str) -> list[tuple[str, Any]]:
    """Target of each entry point of a group, with its description for messages.

    Raises:
        TiltcalError: one does not import.
    """
    from importlib.metadata import entry_points

    found = []
    for entry in sorted(entry_points(group=group), key=lambda e: e.name):
        subject = f"entry point {entry.name} = {entry.value} of {group}"
        try:
            found.append((subject, entry.load()))
        except (ImportError, AttributeError) as error:
            raise TiltcalError(
                subject,
                found=str(error),
                need="a module that imports, and a name in it",
                do="correct or uninstall that package",
            ) from error
    return found


def members(
    group: str, valid: Callable[[Any], bool], what: str, within: Callable[[ModuleType], list[Kind]]
) -> Iterable[tuple[str, Kind]]:
    """Everything that the entry points of a group bring, each with the description of its entry
    point.

    Args:
        group: of the entry points. Each names one thing, a sequence of them, or a module.
        valid: whether something is what the group is for.
        what: name of the group, for messages.
        within: what a module brings.

    Raises:
        TiltcalError: one names something else, or nothing.
    """
    for subject, target in load(group):
        if isinstance(target, ModuleType):
            brought: Sequence[Any] = within(target)
        else:
            brought = target if isinstance(target, list | tuple) else [target]
        wrong = [item for item in brought if not valid(item)]
        if wrong or not brought:
            raise TiltcalError(
                subject,
                found=repr(wrong[0]) if wrong else "nothing",
                need=f"{what}, a sequence of them, or a module that defines them",
                do="correct the entry point",
            )
        for item in brought:
            yield subject, item
