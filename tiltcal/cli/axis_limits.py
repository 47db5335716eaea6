"""The option ``--angles AXIS=LOW:HIGH``."""

from collections.abc import Collection, Sequence

from tiltcal.core.errors import TiltcalError

LARGEST = 3600.0  # deg; mm of an axis that slides


def axis_limits(
    texts: Sequence[str], axes: Collection[str] | None = None
) -> dict[str, tuple[float, float]]:
    """Lowest and highest readout of each named axis, deg, or mm where it slides.

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
    try:
        limit = (float(low), float(high))
    except ValueError:
        limit = (1.0, 0.0)
    if not axis or not -LARGEST <= limit[0] <= limit[1] <= LARGEST:
        raise TiltcalError(
            f"--angles {text}",
            found="no AXIS=LOW:HIGH",
            need="an axis and two angles in deg, such as outer=-45:45",
            do="correct it",
        )
    if axes is not None and axis not in axes:
        raise TiltcalError(
            f"--angles {text}",
            found=f"no axis {axis} in this table",
            need=f"an axis among {', '.join(axes)}",
            do="correct it",
        )
    return axis, limit
