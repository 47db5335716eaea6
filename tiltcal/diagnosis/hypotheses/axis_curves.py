"""Curves of a table's axes: readout errors, bearing tilts, and what follows two angles."""

from collections.abc import Iterator
from itertools import combinations, product
from typing import Any

from tiltcal.diagnosis.hypotheses.curve_forms import curve_over, even_knots, harmonics
from tiltcal.diagnosis.hypotheses.hypothesis import Hypothesis
from tiltcal.effects.curve_coordinates import BEGUN, WAY
from tiltcal.effects.curve_products import ORDERS
from tiltcal.effects.learned import LearnedReadout, LearnedTilt
from tiltcal.effects.spans import CoordinateRanges
from tiltcal.setup.setup import Rig
from tiltcal.setup.tables import angle_channel, bearing


def curves_of_axes(rig: Rig, span: CoordinateRanges) -> Iterator[Hypothesis]:
    """What no name fits of a table's axes."""
    yield from _of_axes(rig, span)
    yield from _of_two_angles(rig)
    yield from _varying_errors_of_axes(rig, span)


def _of_axes(rig: Rig, span: CoordinateRanges) -> Iterator[Hypothesis]:
    """Errors of a readout and tilts of a bearing over the table's angles."""
    for axis in rig.axis_names:
        for other in rig.axis_names:
            for basis in bases_over(rig, other, span):
                if axis in rig.kind.turning:
                    where: dict[str, Any] = {"axis": axis, "place": "table"}
                    yield curve_over(LearnedReadout, f"table_{other}", basis, **where)
                for turn in _across(dict(rig.axes)[axis]):
                    yield curve_over(
                        LearnedTilt,
                        f"table_{other}",
                        basis,
                        slot=bearing(axis),
                        turn=turn,
                        place="table",
                    )


def _varying_errors_of_axes(rig: Rig, span: CoordinateRanges) -> Iterator[Hypothesis]:
    """Errors of a readout over time, temperature and its rate; and over its own angle, as tilts of
    its bearing, those that grow with time, temperature, speed or an angle, or differ by which way
    it last went (Hastie and Tibshirani, J. R. Stat. Soc. B 55, 1993: coefficients that vary).
    """
    turning = rig.kind.turning
    for axis, coordinate in product(turning, ("time", "temperature", "warming")):
        if knots := even_knots(coordinate, span, 5):
            yield curve_over(LearnedReadout, coordinate, knots, axis=axis, place="table")
    factors = ["temperature", "time", "speed", *(angle_channel(axis) for axis in rig.axis_names)]
    known = [(axis, f, 2) for axis, f in product(turning, factors) if even_knots(f, span, 2)]
    known += [(axis, f"{WAY}{axis}", 4) for axis in turning if span_of(axis, span) > BEGUN]
    for axis, factor, orders in known:
        over: dict[str, Any] = {"place": "table", "times": factor}
        coordinate, count = angle_channel(axis), harmonics(orders)
        yield curve_over(LearnedReadout, coordinate, count, axis=axis, **over)
        for turn in _across(dict(rig.axes)[axis]):
            yield curve_over(LearnedTilt, coordinate, count, slot=bearing(axis), turn=turn, **over)


def _of_two_angles(rig: Rig) -> Iterator[Hypothesis]:
    """Errors of a readout and tilts of the base and the mount over products of two angles: with the
    curves over one angle any smooth law of the pose.
    """
    places = [("base", turn, "environment") for turn in "xy"]
    places += [("mount", turn, "mount") for turn in "xyz"]
    turning = rig.kind.turning
    for one, other in combinations(turning, 2):
        over: dict[str, Any] = {"beside": angle_channel(other)}
        coordinate, count = angle_channel(one), 4 * ORDERS**2
        for axis in turning:
            yield curve_over(LearnedReadout, coordinate, count, axis=axis, place="table", **over)
        for slot, turn, place in places:
            yield curve_over(
                LearnedTilt, coordinate, count, slot=slot, turn=turn, place=place, **over
            )


def bases_over(rig: Rig, axis: str, span: CoordinateRanges) -> Iterator[int | tuple[float, ...]]:
    """Bases of a curve over an axis: harmonics of an angle, knots over what is spanned."""
    if axis in rig.kind.turning:
        yield harmonics(4)
    if knots := even_knots(angle_channel(axis), span, 10):
        yield knots


def span_of(axis: str, span: CoordinateRanges) -> float:
    """How far an axis turns, rad."""
    low, high = span.ranges.get(angle_channel(axis), (0.0, 0.0))
    return high - low


def _across(axis: str) -> tuple[str, str]:
    i = "xyz".index(axis)
    return "xyz"[(i + 1) % 3], "xyz"[(i + 2) % 3]
