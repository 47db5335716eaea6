"""Findings in words.

What is said of the calibration where the adjustable terms take up what they should not.

What to record next, in words.
"""

from collections.abc import Mapping, Sequence

import numpy as np

from tiltcal.core.units import G0
from tiltcal.design.identifiability import tie_breaker
from tiltcal.diagnosis.conclusions.finding import Finding, Fitness
from tiltcal.diagnosis.conclusions.noise_figures import NoiseReport
from tiltcal.diagnosis.data.observations import Observations
from tiltcal.diagnosis.model.fitted_model import FittedModel
from tiltcal.diagnosis.model.refitting import PRIOR
from tiltcal.effects import CATALOGUE
from tiltcal.effects.base import Effect
from tiltcal.effects.curve_coordinates import coordinate_named
from tiltcal.effects.curve_products import ORDERS
from tiltcal.effects.learned import Learned, LearnedDelay, LearnedReadout, LearnedTilt
from tiltcal.setup.setup import Rig, Setup
from tiltcal.setup.tables import angle_channel, axis_of

FAR = 5.0  # standard deviations of their prior: one term in two million is as large
AT_ONE_POINT = (
    "The table does not move, and the adjustable terms take up whatever the readings of its stops"
    " are off: only changes in time were tested. Record more attitudes, and the moves between them."
)


def untested_of(observations: Observations, rank: int) -> list[str]:
    """What was not tested, where all is at rest, at so few stops that the fitted parameters take up
    every mean.

    Args:
        observations: what was read; rank: independent parameters fitted to it.
    """
    stops = [channel.stop for channel in observations.channels]
    still = observations.scenario.rig.axes and all(bool((stop >= 0).all()) for stop in stops)
    few = sum(len(np.unique(stop)) for stop in stops) <= rank
    return [AT_ONE_POINT] if still and few else []


def implausible(fitted: FittedModel) -> list[str]:
    """The adjustable terms that are far larger than any instrument's, as notes."""
    found = []
    for term in fitted.nuisance:
        effect, words = term.effect, []
        for name, value in zip(term.names, term.values, strict=True):
            times = abs(value) / term.hypothesis.size(name)
            if times > FAR * PRIOR:
                words.append(f"{name} is {times:.3g} times a plausible size")
        if words:
            where = f" of {effect.sensor}" if effect.sensor else ""
            found.append(
                f"calibration: {effect.id}{where}: {', '.join(words)}; check the units, the gravity"
                " and the axes that the scenario states"
            )
    return found


def next_step(names: tuple[str, ...], effect: Effect) -> str:
    """What to record to split a class, or to confirm a single name."""
    others = [n for n in names if n != effect.id and n in CATALOGUE]
    if effect.id in CATALOGUE and others:
        return "; ".join(dict.fromkeys(tie_breaker(effect.id, other) for other in others[:3]))
    if isinstance(effect, Learned):
        return "record the same coordinate again in another order, to see that the curve repeats"
    return f"record {effect.excited_by} again, to confirm"


def step_for_one(recording: str) -> str:
    """What to do about a cause without a name that not all recordings have. recording: in words."""
    which = recording.removeprefix("in ")
    return f"diagnose {which} apart: only causes that all recordings share have a name"


FOLLOWS = {
    "temperature": "temperature",
    "time": "time",
    "direction": "move",
    "motion": "rate",
    "vibration": "frequency",
}


def coordinate_of_effect(effect: Effect, setup: Setup) -> str:
    """The coordinate that an effect follows, as ``diagnosis.json`` names it."""
    if isinstance(effect, Learned):
        if (
            effect.coordinate == "input"
            and effect.sensor is not None
            and setup.named(effect.sensor).quantity == "rate"
        ):
            return "rate"
        return coordinate_named(effect.coordinate).follows or effect.coordinate
    if effect.follows:
        innermost = setup.rig.axis_names[-1:]
        return effect.follows.format(innermost="".join(innermost))
    if effect.axis_wise and effect.needs == "pose":
        return angle_channel(_axis(effect, setup.rig))
    if effect.needs in FOLLOWS:
        return FOLLOWS[effect.needs]
    if effect.stage == "data":
        return "sample"
    on_body = effect.stage in ("sensor", "electronics", "mount") or not setup.rig.axes
    return "tilt" if on_body else angle_channel(_axis(effect, setup.rig))


def _axis(effect: Effect, rig: Rig) -> str:
    """The table axis of an effect: its own, that of its largest size, or the outermost."""
    sizes = {
        axis: max((abs(v) for n, v in effect.values.items() if n.startswith(f"{axis}_")), default=0)
        for axis in rig.axis_names
    }
    return effect.axis or max(sizes, key=lambda axis: sizes[axis])


LATE = (
    " No curve over temperature alone explains it: warming and cooling differ, as with a thermal"
    " lag or hysteresis."
)


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
    axis = (axis_of(effect.coordinate) if isinstance(effect, Learned) else None) or effect.axis
    return (order, 0) if axis in (None, rig.axis_names[0]) else (0, order)


def learned_name(effect: Learned) -> str:
    """A curve in words."""
    what = _followed(effect)
    if effect.times:
        what += f", in proportion to {_factor(effect.times)}"
    what += _repeating(effect)
    if effect.play:
        what = f"which way {what} last went, {_width(effect)} of it"
    if effect.relaxing and effect.coordinate == "time":
        what = f"an exponential over time, with a time constant of {effect.lag:.0f} s"
    elif effect.lag and effect.coordinate != "temperature":
        what += f" with a memory of about {effect.lag:.0f} s"
        what += ", less what it follows at once" if effect.relaxing else ""
    if isinstance(effect, LearnedReadout):
        return f"an error of the {effect.axis} axis' readout that follows {what}"
    if isinstance(effect, LearnedDelay):
        return f"a delay of the stamps of {effect.sensor or 'all sensors'} that follows {what}"
    if isinstance(effect, LearnedTilt):
        return f"a tilt of the frame '{effect.slot}' about {effect.turn} that follows {what}"
    kind = "a scale factor" if effect.per_input else "an addition to the reading"
    return f"{kind} of {effect.sensor} {effect.axis} that follows {what}"


def _followed(effect: Learned) -> str:
    """The coordinate of a curve in words."""
    what = coordinate_named(effect.coordinate).words
    if effect.power == 2 and not effect.odd:
        what = f"the square of {what}"
    return f"{what} times the {axis_of(effect.beside)} angle" if effect.beside else what


PERIODS = {"input": "in SI units", "temperature": "degC"}


def _repeating(effect: Learned) -> str:
    """After what a curve repeats, or when it begins; nothing of one that does neither."""
    if effect.instants:
        told = [t for t, c in zip(effect.instants, effect.coefficients, strict=True) if c]
        when = " and ".join(", ".join(f"{t:.1f}" for t in told).rsplit(", ", 1))
        return f": transients at {when} s that fall with {effect.fall:.2g} s"
    if not effect.period:
        return ""
    if effect.coordinate in ("time", "since_move", "moves"):
        unit = "" if effect.coordinate == "moves" else " s"
        return f", with a period of {effect.period:.3g}{unit}"
    if effect.knots and axis_of(effect.coordinate):
        return f" and repeats every {np.degrees(effect.period):.4g} deg"
    if effect.coordinate in PERIODS:
        return f", with a period of {effect.period:.3g} {PERIODS[effect.coordinate]}"
    return f", {2 * np.pi / effect.period:.4g} times a turn"


def _factor(times: str) -> str:
    """What a curve is multiplied by, in words."""
    one = coordinate_named(times)
    return one.factor or one.words


def _width(effect: Learned) -> str:
    """Width of a play in words."""
    if axis_of(effect.coordinate):
        return f"{np.degrees(effect.play):.3g} deg"
    return f"{effect.play / G0:.2g} g"


def shown(parameters: Mapping[str, tuple[float, float]]) -> str:
    """Values with their uncertainties, each with as many digits as it deserves."""
    words = []
    for name, (value, sigma) in list(parameters.items())[:4]:
        digits = max(0, 1 - int(np.floor(np.log10(sigma)))) if sigma > 0 else 3
        words.append(f"{name} = {value:.{min(digits, 9)}f} +- {sigma:.{min(digits, 9)}f}")
    return ", ".join(words)


def sums_only(names: Sequence[str]) -> str:
    """That other sizes of a law may hold a part of its signal; nothing without any."""
    if not names:
        return ""
    verb = "is" if len(names) == 1 else "are"
    return (
        f" {', '.join(names)} may hold a part of this signal and {verb} taken as zero: the poses"
        " tell only sums of them."
    )


def summary(
    findings: tuple[Finding, ...],
    verdict: str,
    reason: str,
    before: Fitness | None = None,
    after: Fitness | None = None,
    noise: NoiseReport | None = None,
) -> str:
    """The statement of a diagnosis, in a few sentences.

    Args:
        findings, verdict: of it.
        reason: why nothing was tested, where that is so, or else what is more probable than not.
        before, after: figures of the fit.
        noise: that is left.
    """
    told = " ".join(f.statement for f in findings)
    if verdict == "cannot_tell" or before is None or after is None or noise is None:
        rest = [told, reason, noise.may_be if noise else ""]
        return " ".join(words for words in rest if words)
    what = f"{noise.words}. {noise.may_be}".rstrip()
    left = f"{after.chi2_per_dof:.4g} of the sensors' white noise; {what}"
    if verdict == "match":
        return (
            "The recording agrees with the scenario: nothing is significant beyond its noise"
            f" (taken from {noise.source}). Chi-square per degree of freedom is {left}"
        )
    first, last = f"{before.chi2_per_dof:.4g}", f"{after.chi2_per_dof:.4g}"
    course = "falls" if (after.chi2_per_dof or 0) < (before.chi2_per_dof or 0) else "goes"
    course = "stays at" if first == last else f"{course} from {first} to"
    return f"{told} Chi-square per degree of freedom {course} {left} {reason}".strip()


def untold(rig: Rig, samples: int, columns: int) -> str:
    """Why a recording tests nothing, and what to record.

    Args:
        rig: what the sensors stand on.
        samples: readings that have a model.
        columns: independent parameters fitted to them.
    """
    by_hand = "several seconds at rest in more attitudes than there are adjustable terms"
    on_table = "poses with the table read while the sensors are sampled, more than there are terms"
    record = by_hand if not rig.axes else on_table
    if not samples:
        missing = "rests" if not rig.axes else "table angles with readings of a sensor"
        why = f"The recording holds no {missing}, so nothing in it tests the model"
    else:
        why = (
            f"This recording leaves no degrees of freedom to test the model ({columns} parameters"
            " are fitted to it); any error would fit it as well"
        )
    return f"{why}. Record {record}."


def doubted(doubts: Sequence[tuple[str, float]]) -> str:
    """Why a recording that shows no certain finding is no match, and what to record. doubts: what
    may be there, and its probability.
    """
    told = " and ".join(f"{words} (probability {chance:.2f})" for words, chance in doubts)
    return (
        f"Something may be there that this recording cannot tell from slow or random noise: {told}."
        " Record again for longer, and once at rest for as long (--static), so that the noise is"
        " known."
    )


def law_name(effect: Effect) -> str:
    """An effect in words: its title and id, a curve by what it follows."""
    return learned_name(effect) if isinstance(effect, Learned) else f"{effect.title} ({effect.id})"


def not_reproduced(statement: str, failure: str) -> str:
    """The statement of a diagnosis whose amended scenario failed its re-simulation."""
    return (
        f"{statement} The amended model does not reproduce the fit in the simulator: {failure}."
        " The answer is not confirmed."
    )
