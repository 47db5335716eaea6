"""The options of ``tiltcal design``, by topic; ``--angles AXIS=LOW:HIGH`` serves ``investigate``
too.
"""

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from tiltcal.cli.options import SEVERAL, WHOLE, AxisLimits, Grade, StartAngles, between
from tiltcal.core.errors import TiltcalError
from tiltcal.design.recording_blocks import SLIDE_RATE
from tiltcal.laboratory.scenario import Scenario, narrowed


@dataclass(frozen=True)
class Aim:
    """What the sequence is to measure."""

    terms: Annotated[
        tuple[str, ...],
        SEVERAL,
        Parameter(help="Terms of interest: bias, scale, cross_axis, K2 ..., an effect id, or all."),
    ] = ()
    nuisance: Annotated[
        tuple[str, ...],
        SEVERAL,
        Parameter(help="Terms that are fitted but not of interest; or none."),
    ] = ("drift",)
    textbook: Annotated[
        str | None,
        Parameter(
            help="Textbook polynomial instead of the product's own terms: linear, K2, K2K3,"
            " quadratic or cubic."
        ),
    ] = None
    criterion: Annotated[
        str, Parameter(help="tilt (or I), D, A, or both: the mean of D and tilt.")
    ] = "both"
    grade: Annotated[Grade, Parameter(help="Instrument grade: sets the prior sizes.")] = "mid_mems"
    prior: Annotated[
        float | None,
        Parameter(
            validator=between(1e-9, 1e3),
            help="One relative size for all priors instead: g, or g per power of g.",
        ),
    ] = None
    range_deg: Annotated[
        float,
        Parameter(
            validator=between(0.01, 180),
            help="Working range about level for the tilt error; 180 is everywhere.",
        ),
    ] = 180.0
    sensor: Annotated[
        str | None, Parameter(help="Name of the sensor, if the scenario has several.")
    ] = None
    goal: Annotated[
        tuple[str, ...],
        SEVERAL,
        Parameter(
            help="NAME=VALUE: the largest standard uncertainty of a parameter (accel.bias=30ug for"
            " all axes), the tilt error (tilt=5arcsec), or its expanded uncertainty, k = 2"
            " (U=0.01deg). The least table time within the budget that reaches all of them is used."
        ),
    ] = ()


@dataclass(frozen=True)
class TableTime:
    """What the table and the readings allow."""

    budget_s: Annotated[float, Parameter(validator=between(1e-3, 1e6), help="Table time.")] = 300.0
    rate_deg_s: Annotated[
        float,
        Parameter(validator=between(1e-6, 1e6), help="Rate of moves, all axes at once."),
    ] = 20.0
    settle_s: Annotated[float, Parameter(help="Settling time after each move.")] = 5.0
    dwell_s: Annotated[
        tuple[float, float], Parameter(help="Shortest and longest time of a reading.")
    ] = (5.0, 60.0)
    angles: AxisLimits = ()
    start: StartAngles = ()
    home: Annotated[
        bool, Parameter(help="End where the sequence starts; the way back is in the budget.")
    ] = False
    step_deg: Annotated[
        float,
        Parameter(
            validator=between(1e-3, 360, or_zero=True),
            help="Angles are multiples of this step; 0 allows any angle.",
        ),
    ] = 0.0
    floor_ug: Annotated[
        float,
        Parameter(
            validator=between(0, 1e9),
            help="Error of a pose mean that averaging does not reduce.",
        ),
    ] = 20.0


@dataclass(frozen=True)
class Separation:
    """What ``--split`` starts from."""

    diagnosed: Annotated[
        Path | None,
        Parameter("--scenario", help="With --split: the scenario that was diagnosed."),
    ] = None
    rate_mm_s: Annotated[
        float,
        Parameter(
            validator=between(1e-6, 1e6),
            help="With --split: rate of moves of axes that slide.",
        ),
    ] = SLIDE_RATE
    recordings: Annotated[
        tuple[Path, ...],
        SEVERAL,
        Parameter(help="With --split: the recordings; those that the diagnosis names by default."),
    ] = ()


AllEffectsObservable = Annotated[
    int | None,
    WHOLE,
    Parameter(
        alias="--blind-to-nothing",  # its name up to 0.1
        help="Find this many poses for which the least visible effect is as visible as possible."
        " Effects: all that this table and sensor can have, or those of --terms.",
    ),
]
Split = Annotated[
    Path | None,
    Parameter(help="Propose the block that separates the alternatives of this diagnosis.json."),
]


LARGEST = 3600.0  # deg; mm of an axis that slides


def within_options(scenario: Scenario, angles: Sequence[str], start: Sequence[str]) -> Scenario:
    """The scenario whose rig keeps to --angles and starts at --from.

    Args:
        scenario: with the rig.
        angles: values of --angles.
        start: values of --from.

    Raises:
        TiltcalError: a text does not read, the rig has no such axis, or a joint rules it out.
    """
    axes = scenario.rig.axis_names
    return narrowed(scenario, axis_limits(angles, axes), dict(_start(t, axes) for t in start))


def _start(text: str, axes: Collection[str]) -> tuple[str, float]:
    axis, _, position = text.partition("=")
    try:
        return axis, _limit(f"{axis}={position}:{position}", axes)[1][0]
    except TiltcalError as error:
        raise TiltcalError(
            f"--from {text}",
            found=error.found,
            need="an axis of this table and where it stands, deg or mm, such as outer=30",
            do="correct it",
        ) from error


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
