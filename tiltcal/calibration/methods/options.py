"""Options of a method, as a file or a command line states them: checked before the method sees
them.
"""

import inspect
from collections.abc import Callable, Mapping, Sequence
from typing import Any, get_type_hints

from pydantic import ConfigDict, TypeAdapter, ValidationError

from tiltcal.core.errors import TiltcalError, nearest, shown

CONFIG = ConfigDict(allow_inf_nan=False, arbitrary_types_allowed=True)


def check_options(
    function: Callable[..., Any], subject: str, options: Mapping[str, Any], handed: int
) -> None:
    """Refuse an option that a function does not have, or a value of another type than it asks for.

    Args:
        function: a method, or the factory of an estimator.
        subject: what it is, for messages: ``method norm``.
        options: as the user states them.
        handed: leading arguments that are not the user's to name.

    Raises:
        TiltcalError: naming the option.
    """
    accepted = inspect.signature(function).parameters
    takes_any = any(p.kind is p.VAR_KEYWORD for p in accepted.values())
    given = list(accepted)[:handed]
    unknown = [key for key in options if key in given or (key not in accepted and not takes_any)]
    if unknown:
        valid = [k for k, p in accepted.items() if p.kind is p.KEYWORD_ONLY]
        raise TiltcalError(
            subject,
            found=f"option '{unknown[0]}'",
            need="an option of it",
            do=nearest(unknown[0], valid or ["none"]),
        )
    hints = _hints(function)
    for key, value in options.items():
        if key != "segments" and key in hints:
            _check(value, hints[key], f"{subject}, option {key}")


def _hints(function: Callable[..., Any]) -> dict[str, Any]:
    """The types that a function states; none where they cannot be found."""
    try:
        return get_type_hints(function)
    except (NameError, TypeError):
        return {}


def _check(value: Any, hint: Any, subject: str) -> None:
    if isinstance(value, str) and hint == Sequence[str]:
        return  # the method says which words there are
    need = str(getattr(hint, "__name__", hint) if isinstance(hint, type) else hint)
    if isinstance(value, list | tuple | dict) and not value:
        raise TiltcalError(subject, found=shown(value), need="at least one", do="leave it out")
    try:
        TypeAdapter(hint, config=CONFIG).validate_python(value)
    except ValidationError as error:
        raise TiltcalError(
            subject,
            found=shown(value),
            need=need.removeprefix("collections.abc.").replace("NoneType", "None"),
            do="correct it",
        ) from error
    except (TypeError, AttributeError):  # a type that pydantic does not know
        return
