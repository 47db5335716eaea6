"""Faults of the data as findings."""

from collections.abc import Sequence

from tiltcal.diagnosis.conclusions.finding import Finding, Where
from tiltcal.diagnosis.conclusions.parts import part_of
from tiltcal.diagnosis.data_quality.fault import Fault
from tiltcal.diagnosis.data_quality.inspection import LeftOut, by_recording
from tiltcal.effects.parameter import by_name
from tiltcal.setup.sensor import Sensor


def rows_out_of_order(left_out: Sequence[LeftOut], sensors: Sequence[Sensor]) -> list[Finding]:
    """Rows whose time is out of order, as findings: no effect of the catalogue states it, so that
    they have no part in the amended scenario.
    """
    return [
        Finding(
            effect=None,
            names=(),
            stage="data",
            sensors=tuple(s.name for s in sensors),
            axes=tuple(dict.fromkeys(axis for s in sensors for axis in s.axes)),
            where=Where("sample"),
            statement=f"{rows.words}.",
            next_measurement="look at the file and at what wrote it",
            probability=1.0,
        )
        for rows in by_recording(left_out)
        if rows.out_of_order
    ]


def repeated_stamps(left_out: Sequence[LeftOut]) -> list[str]:
    """Stamps that only repeat, as notes: they may be rounded."""
    return [rows.words for rows in by_recording(left_out) if not rows.out_of_order]


def _or_another(fault: Fault) -> str:
    """What was seen, and what else it may be."""
    others = [name for name in fault.names if name != fault.effect.id]
    if not others:
        return fault.words
    return f"{fault.words.rstrip('.')} (or {', '.join(others)}: this recording cannot tell)."


def finding_of(fault: Fault) -> Finding:
    """A fault as it stands in the answer."""
    known, parameters = by_name(fault.effect.parameters), {}
    for name, value in fault.effect.values.items():
        p = known[name]
        parameters[f"{name}{p.suffix}"] = value / p.factor, fault.sigma.get(name, 0.0) / p.factor
    return Finding(
        effect=fault.effect.id,
        names=fault.names or (fault.effect.id,),
        stage=fault.effect.stage,
        sensors=fault.sensors,
        axes=fault.axes,
        where=Where("sample", None, fault.interval),
        parameters=parameters,
        parts=(part_of(fault),),
        p_value=fault.p_value,
        statement=_or_another(fault),
        next_measurement="look at the file and at what wrote it",
    )
