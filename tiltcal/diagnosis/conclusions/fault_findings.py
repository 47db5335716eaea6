"""Faults of the data as findings."""

from tiltcal.diagnosis.conclusions.finding import Finding, Where
from tiltcal.diagnosis.conclusions.parts import part_of
from tiltcal.diagnosis.data_quality.fault import Fault


def finding_of(fault: Fault) -> Finding:
    """A fault as it stands in the answer."""
    parameters = {
        f"{name}{p.suffix}": (value / p.factor, fault.sigma.get(name, 0.0) / p.factor)
        for p in fault.effect.parameters
        for name, value in fault.effect.values.items()
        if name == p.name or ("{" in p.name and name.startswith(p.name.split("{")[0]))
    }
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
        delta_bic=0.0,
        heldout_gain=0.0,
        rivals=(),
        statement=fault.words,
        next_measurement="look at the file and at what wrote it",
    )
