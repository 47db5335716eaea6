"""The option ``--angles AXIS=LOW:HIGH``."""

from collections.abc import Collection, Sequence

from tiltcal.core.errors import TiltcalError


def axis_limits(
    texts: Sequence[str], axes: Collection[str] | None = None
) -> dict[str, tuple[float, float]]:
    """Lowest and highest angle of each named axis, deg.

    Args:
        texts: values of the option.
        axes: the axes of the table, where they are known.

    Raises:
        TiltcalError: a text is not AXIS=LOW:HIGH, or the table has no such axis.
    """
    return dict(_limit(text, axes) for text in texts)


def _limit(text: str, axes: Collection[str] | None) -> tuple[str, tuple[float, float]]:
    axis, _, span = text.partition("=")
    low, _, high = span.partition(":")
    known = bool(axis) if axes is None else axis in axes
    try:
        limit = (float(low), float(high))
    except ValueError:
        known, limit = False, (0.0, 0.0)
    if not known or not limit[0] < limit[1]:
        raise TiltcalError(
            "--angles",
            found=f"'{text}'",
            need="AXIS=LOW:HIGH in deg, such as outer=-45:45"
            + (f"; the axes are {', '.join(axes)}" if axes else ""),
            do="correct it",
        )
    return axis, limit
