"""Findings in words."""

from collections.abc import Mapping

import numpy as np

from tiltcal.design.identifiability import tie_breaker
from tiltcal.diagnosis.conclusions.finding import Finding
from tiltcal.effects import CATALOGUE
from tiltcal.effects.base import Effect
from tiltcal.effects.learned import ORDERS, Learned, LearnedReadout, LearnedTilt
from tiltcal.setup.setup import Rig, Setup
from tiltcal.setup.tables import angle_channel, axis_of

FOLLOWS = {
    "temperature": "temperature",
    "time": "time",
    "direction": "move",
    "motion": "rate",
    "vibration": "frequency",
}
LEARNED_WORD = {
    "input": "tilt",
    "transverse": "rate",
    "warming": "temperature",
    "since_move": "move",
    "moves": "move",
}


def coordinate_of_effect(effect: Effect, setup: Setup) -> str:
    """The coordinate that an effect follows, as the contract names it."""
    if isinstance(effect, Learned):
        if effect.coordinate.startswith("force"):
            return "tilt"
        if effect.coordinate.startswith("rate"):
            return "rate"
        if (
            effect.coordinate == "input"
            and effect.sensor is not None
            and setup.named(effect.sensor).quantity == "rate"
        ):
            return "rate"
        return LEARNED_WORD.get(effect.coordinate, effect.coordinate)
    if effect.follows:
        innermost = setup.rig.axis_names[-1:]
        return effect.follows.format(innermost="".join(innermost))
    if effect.axis_wise and effect.needs == "pose":
        return angle_channel(effect.axis or setup.rig.axis_names[0])
    if effect.needs in FOLLOWS:
        return FOLLOWS[effect.needs]
    if effect.stage == "data":
        return "sample"
    on_body = effect.stage in ("sensor", "electronics", "mount") or not setup.rig.axes
    return "tilt" if on_body else angle_channel(setup.rig.axis_names[0])


def stage_of(effect: Effect) -> str:
    """Stage of the chain at which an effect acts."""
    return effect.place if isinstance(effect, Learned) else effect.stage


def harmonic_of(effect: Effect, rig: Rig) -> tuple[int, int] | None:
    """Orders over the outermost angle and over another one, where an effect has one."""
    order = effect.harmonic or None
    if isinstance(effect, Learned) and effect.beside:
        m, n = divmod(int(np.argmax(np.abs(effect.coefficients))) // 4, ORDERS)
        return m + 1, n + 1
    if (
        order is None
        and isinstance(effect, Learned)
        and not effect.knots
        and axis_of(effect.coordinate)
    ):
        order = 1 + int(np.argmax(np.abs(effect.coefficients))) // 2
    if order is None:
        return None
    axis = effect.axis or (axis_of(effect.coordinate) if isinstance(effect, Learned) else None)
    return (order, 0) if axis in (None, rig.axis_names[0]) else (0, order)


def learned_name(effect: Learned) -> str:
    """A curve in words."""
    words = {
        "input": "its own input",
        "transverse": "the rate across its axis",
        "warming": "the rate of warming",
        "since_move": "the time since the last move",
        "moves": "the number of moves",
    }
    what = words.get(effect.coordinate, effect.coordinate.replace("_", " along body "))
    if axis := axis_of(effect.coordinate):
        what = f"the {axis} angle"
    if effect.beside:
        what += f" times the {axis_of(effect.beside)} angle"
    if effect.period and effect.coordinate in ("since_move", "moves"):
        what += (
            ", with a period of"
            f" {effect.period:.3g}{' s' if effect.coordinate == 'since_move' else ''}"
        )
    if effect.period and effect.knots:
        what += f" and repeats every {np.degrees(effect.period):.4g} deg"
    if effect.lag and effect.coordinate != "temperature":
        what += f" with a memory of about {effect.lag:.0f} s"
    if isinstance(effect, LearnedReadout):
        return f"an error of the {effect.axis} axis' readout that follows {what}"
    if isinstance(effect, LearnedTilt):
        return f"a tilt of the frame '{effect.slot}' about {effect.turn} that follows {what}"
    kind = "a scale factor" if effect.per_input else "an addition to the reading"
    return f"{kind} of {effect.sensor} {effect.axis} that follows {what}"


def shown(parameters: Mapping[str, tuple[float, float]]) -> str:
    """Values with their uncertainties, each with as many digits as it deserves."""
    words = []
    for name, (value, sigma) in list(parameters.items())[:4]:
        digits = max(0, 1 - int(np.floor(np.log10(sigma)))) if sigma > 0 else 3
        words.append(f"{name} = {value:.{min(digits, 9)}f} +- {sigma:.{min(digits, 9)}f}")
    return ", ".join(words)


def next_step(names: tuple[str, ...], effect: Effect) -> str:
    """What to record to split a class, or to confirm a single name."""
    others = [n for n in names if n != effect.id and n in CATALOGUE]
    if effect.id in CATALOGUE and others:
        return "; ".join(dict.fromkeys(tie_breaker(effect.id, other) for other in others[:3]))
    if isinstance(effect, Learned):
        return "record the same coordinate again in another order, to see that the curve repeats"
    return f"record {effect.excited_by} again, to confirm"


def summary(
    findings: tuple[Finding, ...], verdict: str, before: float, after: float, kind: str
) -> str:
    """The statement of a diagnosis, in two or three sentences."""
    if verdict == "cannot_tell":
        return (
            "This recording leaves no degrees of freedom to test the model; any error would fit"
            " it as well."
        )
    if verdict == "match":
        agrees = (
            "The recording agrees with the scenario: nothing is significant beyond its noise"
            f" ({kind})"
        )
        return f"{agrees}, chi-square per degree of freedom {after:.3f}."
    told = " ".join(f.statement for f in findings)
    fall = f"Chi-square per degree of freedom falls from {before:.3f} to {after:.3f}."
    return f"{told} {fall}"
