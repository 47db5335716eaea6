"""Who may be to blame: every effect of the catalogue at a few shapes."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import product

from tiltcal.diagnosis.hypotheses.instants import Instant
from tiltcal.effects import CATALOGUE
from tiltcal.effects.base import DelayEffect, Effect
from tiltcal.effects.calibration_terms import calibration_effect
from tiltcal.effects.learned import Learned
from tiltcal.effects.parameter import GRADES
from tiltcal.effects.spans import CoordinateRanges
from tiltcal.laboratory.scenario import Scenario
from tiltcal.setup.sensor import Sensor


@dataclass(frozen=True)
class Hypothesis:
    """An effect with its shape given and its sizes free.

    Args:
        effect: the effect at plausible sizes.
        names: bare names of the sizes.
        alias: catalogue id of a curve that is a known law without a known form.
        log_odds: of its shape against an unlisted law of that shape, nats; of a transient, of its
            place among all that were looked at.
    """

    effect: Effect
    names: tuple[str, ...]
    alias: str | None = None
    log_odds: float = 0.0

    @property
    def id(self) -> str:
        """Catalogue id; ``learned`` for a curve without a name."""
        return self.alias or self.effect.id

    @property
    def law(self) -> type[Effect]:
        """The class of its name."""
        return CATALOGUE[self.alias] if self.alias is not None else type(self.effect)

    @cached_property
    def listed(self) -> bool:
        """Whether it has a name in the catalogue."""
        return self.alias is not None or not isinstance(self.effect, Learned)

    @property
    def textbook(self) -> bool:
        """Whether its name comes with a form: a name without one is given last, and only where no
        form fits.
        """
        return self.listed and (self.alias is None or self.law.form == "law")

    @property
    def has_plausible_size(self) -> bool:
        """Whether the catalogue says how large it may be: of a curve it does not."""
        return not isinstance(self.effect, Learned)

    @property
    def has_instant(self) -> bool:
        """Whether it begins at an instant."""
        return self.law.acts_from_an_instant

    @property
    def instant(self) -> Instant | None:
        """When it begins; None where that is no instant."""
        return Instant.of(self.effect) if self.has_instant else None

    @property
    def line_hz(self) -> float:
        """Frequency of a line in time, of harmonics their first one; 0 for anything else."""
        effect = self.effect
        if isinstance(effect, Learned):
            repeats = effect.period and effect.coordinate == "time" and not effect.knots
            return 1 / effect.period if repeats else 0.0
        return effect.values["frequency"] if self.law.spectral_line == "time" else 0.0

    @property
    def is_step(self) -> bool:
        """Whether it shifts a reading from an instant on."""
        return self.has_instant and self.law.stage != "data"

    @property
    def place(self) -> tuple[str, str | None, str | None]:
        """Id, sensor, axis: the same for all shapes of one explanation."""
        return self.id, self.effect.sensor, self.effect.axis

    def at(self, values: Mapping[str, float]) -> Effect:
        """The effect at these sizes, its shape kept."""
        return with_values(
            self.effect,
            {**{k: v for k, v in self.effect.values.items() if k not in self.names}, **values},
        )

    def size(self, name: str) -> float:
        """Plausible size of a parameter, SI."""
        return abs(self.effect.values[name])

    def alone(self, name: str) -> Effect:
        """The effect with one size only, at its plausible value."""
        return self.at({name: self.effect.values[name]})


def with_values(effect: Effect, values: Mapping[str, float]) -> Effect:
    """The same effect at other values, SI."""
    return replace(effect, values=dict(values))


def adjustable(scenario: Scenario) -> list[Hypothesis]:
    """The terms that ordinary calibration may re-tune, as effects with role ``calibration``: those
    of the sensors, and the scenario's own effects that are to be fitted.
    """
    found: list[Hypothesis] = []
    for sensor in scenario.sensor:
        for term in sensor.adjustable:
            if (cls := calibration_effect(term, sensor.kind)) is not None:
                found += [
                    _hypothesis(cls, scenario, sensor, axis, role="calibration")
                    for axis in cls.axes_on(scenario.rig)
                ]
    for effect in scenario.effects:
        if effect.fit and not effect.random:  # the noise is estimated anyway
            bound = scenario.named(effect.sensor) if effect.sensor else None
            one = _hypothesis(
                type(effect), scenario, bound, effect.axis, effect.values, "calibration"
            )
            if all(one.place != other.place for other in found):
                found.append(replace(one, effect=replace(one.effect, fit=True)))
    return found


def _hypothesis(
    cls: type[Effect],
    scenario: Scenario,
    sensor: Sensor | None,
    axis: str | None,
    shapes: Mapping[str, float] | None = None,
    role: str = "found",
) -> Hypothesis:
    bound = sensor if cls.kinds else None
    axes = bound.axes if bound else tuple(dict.fromkeys(a for s in scenario.sensor for a in s.axes))
    plausible = {
        # of a whole number no smaller step changes anything, and a larger one is not linear
        n: 1.0 if p.whole else p.plausible[GRADES.index("mid_mems")] * p.factor
        for n, p in cls.sizes_on(axes, scenario.rig).items()
    }
    effect = cls({**(shapes or {}), **plausible}, bound.name if bound else None, axis, role)
    return Hypothesis(effect, tuple(plausible))


def listed_hypotheses(
    scenario: Scenario, span: CoordinateRanges, taken: Sequence[Hypothesis] = ()
) -> Iterator[Hypothesis]:
    """Every effect of the catalogue that a residual may hold, but steps at unknown times and faults
    of the data.
    """
    nuisance = {s.place for s in taken}
    for cls in CATALOGUE.values():
        if not _eligible(cls, scenario):
            continue
        sensors: Sequence[Sensor | None] = (None,)
        if cls.kinds:
            sensors = [s for s in scenario.sensor if cls.senses(s.kind)]
        # the recorder's own: all sensors alike
        if issubclass(cls, DelayEffect) and len(sensors) > 1 and cls.stage == "timing":
            sensors = (*sensors, None) if scenario.rig.axes else sensors
        for sensor, axis in product(sensors, cls.axes_on(scenario.rig)):
            for shape in cls.shapes(span):
                hypothesis = _hypothesis(cls, scenario, sensor, axis, shape)
                if hypothesis.place not in nuisance:
                    yield replace(hypothesis, log_odds=cls.shape_odds(shape, span))


def _eligible(cls: type[Effect], scenario: Scenario) -> bool:
    """Whether an effect is a hypothesis of its own: steps are scanned elsewhere, and a curve stands
    for a name without a known form.
    """
    return (
        cls.has_column()
        and cls.shows_on(scenario.rig)
        and _told_on(cls, scenario)
        and not (cls.same_form_as and not _apart_on(cls, scenario))
        and not cls.acts_from_an_instant
        and cls.form != "unknown"
    )


def _apart_on(cls: type[Effect], scenario: Scenario) -> bool:
    """Whether an effect is looked for beside another of the same form."""
    by_encoder = cls.of_drive and bool(scenario.sensors("encoder"))
    return by_encoder or (cls.apart_on_joints and scenario.rig.kind.chain is not None)


def _told_on(cls: type[Effect], scenario: Scenario) -> bool:
    """Whether a rig can tell it: by hand no mounting shows, and there is no other clock."""
    of_table = cls.shows_against_table or (cls.stage == "mount" and not cls.kinds)
    return bool(scenario.rig.axes) or not of_table


def step_hypotheses(scenario: Scenario, times: Sequence[Instant]) -> Iterator[Hypothesis]:
    """Effects that begin at an instant, at these."""
    for cls in CATALOGUE.values():
        if not (cls.acts_from_an_instant and _told_on(cls, scenario)):
            continue
        for sensor in scenario.sensors(*cls.kinds) if cls.kinds else (None,):
            for time in times:
                step = _hypothesis(cls, scenario, sensor, None)
                yield replace(step, effect=time.date(step.effect))


CREEP_TIMES_S = (0.5, 1.5, 4.0, 10.0, 25.0, 60.0)  # s


def steps_at(scenario: Scenario, time: Instant) -> Iterator[Hypothesis]:
    """Every effect that may have begun at an instant, at once or creeping on."""
    for step in step_hypotheses(scenario, (time,)):
        yield step
        if step.is_step:
            for creep in CREEP_TIMES_S:
                late = with_values(step.effect, {**step.effect.values, "creep": creep})
                yield Hypothesis(late, step.names)
