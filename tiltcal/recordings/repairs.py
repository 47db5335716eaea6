"""Repairs of an imported table, each only on request and each with a report."""

from collections.abc import Callable, Sequence

import numpy as np

from tiltcal.core.arrays import Array, Mask
from tiltcal.core.errors import TiltcalError
from tiltcal.core.units import COLUMN_UNITS, split_unit
from tiltcal.recordings.import_checks import clipped, frozen, is_angle, wrap_mask
from tiltcal.recordings.samples import Labels

Columns = dict[str, Array]
State = tuple[Array, Columns, Labels | None]
Done = tuple[State, str]


def repair(
    time: Array,
    columns: Columns,
    labels: Labels | None,
    wanted: Sequence[str],
    period: float | None = None,
) -> tuple[Array, Columns, Labels | None, list[str]]:
    """A table after the repairs that are wanted, in the order of ``REPAIRS``, and what they did.

    Args:
        labels: of the rows, where there are any.
        time: s, (n,).
        columns: name with unit -> values, (n,) each.
        wanted: names of repairs.
        period: s, after which the counter of the time starts again; None: from its falls.

    Raises:
        TiltcalError: a repair cannot be made on these data.
    """
    state: State = (time, columns, labels)
    reports = []
    for name, make in REPAIRS.items():
        if name in wanted:
            state, report = make(state, period)
            if report:
                reports.append(f"{name}: {report}")
    return (*state, reports)


def _unwrap_time(state: State, period: float | None) -> Done:
    time, columns, labels = state
    wraps = wrap_mask(time)
    if not wraps.any():
        return state, ""
    turns = np.concatenate([[0], np.cumsum(wraps)])
    period = _period(time, wraps) if period is None else period
    return (time + period * turns, columns, labels), (
        f"{wraps.sum()} wraps of {period:.9g} s undone"
    )


def _period(time: Array, wraps: Mask) -> float:
    """What the time falls by, s, with the usual step."""
    step = np.diff(time)
    usual = float(np.median(step[step > 0]))
    periods = usual - step[wraps]
    if np.ptp(periods) > usual:
        raise TiltcalError(
            "repair unwrap_time",
            found=f"falls by {periods.min():.9g} to {periods.max():.9g} s",
            need="one period of the counter",
            do="split the file where time goes back",
        )
    return float(np.median(periods))


def _sort_time(state: State, _: float | None) -> Done:
    time = state[0]
    order = np.argsort(time, kind="stable")
    moved = int(np.sum(order != np.arange(len(order))))
    return _taken(state, order), f"{moved} rows moved" if moved else ""


def _drop_repeated(state: State, _: float | None) -> Done:
    time = state[0]
    kept = np.concatenate([[True], np.diff(time) != 0])
    lost = int(np.sum(~kept))
    return _taken(state, np.flatnonzero(kept)), (
        f"{lost} rows left out, the first of each stamp kept" if lost else ""
    )


def _unwrap_angles(state: State, _: float | None) -> Done:
    time, columns, labels = state
    changed = {}
    for name, values in columns.items():
        if not is_angle(name):
            continue
        turn = 2 * np.pi / COLUMN_UNITS[str(split_unit(name)[1])].factor
        known = ~np.isnan(values)
        unwrapped = values.copy()
        unwrapped[known] = np.unwrap(values[known], period=turn)
        if not np.array_equal(unwrapped[known], values[known]):
            changed[name] = unwrapped
    report = ", ".join(changed) + " made continuous" if changed else ""
    return (time, columns | changed, labels), report


def _emptied(find: Callable[[Array], "np.typing.NDArray[np.bool_]"]) -> Callable[..., Done]:
    def make(state: State, _: float | None) -> Done:
        time, columns, labels = state
        changed, reports = {}, []
        for name, values in columns.items():
            if is_angle(name) or np.isnan(values).all():
                continue
            mask = find(values)
            if mask.any():
                changed[name] = np.where(mask, np.nan, values)
                reports.append(f"{int(mask.sum())} values of {name} emptied")
        return (time, columns | changed, labels), ", ".join(reports)

    return make


def _taken(state: State, rows: "np.typing.NDArray[np.intp]") -> State:
    time, columns, labels = state
    return (
        time[rows],
        {name: values[rows] for name, values in columns.items()},
        None if labels is None else labels[rows],
    )


REPAIRS: dict[str, Callable[[State, float | None], Done]] = {
    "unwrap_time": _unwrap_time,
    "sort_time": _sort_time,
    "drop_repeated_time": _drop_repeated,
    "unwrap_angles": _unwrap_angles,
    "empty_frozen": _emptied(frozen),
    "empty_clipped": _emptied(clipped),
}
