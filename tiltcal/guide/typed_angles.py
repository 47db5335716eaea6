"""Angles of a dividing head as they are typed."""

from tiltcal.core.errors import TiltcalError


def parse_angles(line: str, axes: tuple[str, ...]) -> dict[str, float] | None:
    """``90 0`` or ``outer=90 inner=0`` as angles of axes, deg; None of an empty line.

    Raises:
        TiltcalError: it is neither.
    """
    words = line.replace(",", " ").split()
    named = [word.partition("=") for word in words]
    try:
        if all(equals for _, equals, _ in named):
            return {axis: float(value) for axis, _, value in named} or None
        return dict(zip(axes, map(float, words), strict=True))
    except ValueError as error:
        raise TiltcalError(
            "angles of the head",
            found=f"'{line}'",
            need=f"numbers for {', '.join(axes)}, such as {' '.join('0' for _ in axes)}",
            do="type them again",
        ) from error
