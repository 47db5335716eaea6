"""Who may be to blame: every effect of the catalogue at a few shapes."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import product

import numpy as np

from tiltcal.diagnosis.hypotheses.coordinate_ranges import CoordinateRanges
from tiltcal.effects import CATALOGUE
from tiltcal.effects.base import GRADES, DelayEffect, Effect, WritingEffect
from tiltcal.effects.learned import Learned
from tiltcal.forward.jacobian import NO_COLUMN, OF_THE_DRIVE
from tiltcal.laboratory.scenario import Scenario
from tiltcal.setup.setup import Sensor

CALIBRATION = {
    "accelerometer": ("acc_bias", "acc_scale", "acc_cross_axis"),
    "inclinometer": ("acc_bias", "acc_scale", "acc_cross_axis"),
    "gyro": ("gyr_bias", "gyr_scale", "gyr_misalignment"),
    "fog": ("fog_bias", "fog_scale", ""),
}
_TERM = ("bias", "scale", "cross_axis")
SAME_LAW = {
    "rate_error": "cable_torque",
    "servo_droop": "table_sag",
    "table_unbalance": "table_encoder_eccentricity",
    "servo_ripple": "table_encoder_sde",
    "mount_misalignment": "acc_cross_axis",
    "mount_resonance": "settling_transient",
    "adc_gain_error": "acc_scale",
    "adc_offset_drift": "acc_temp_bias",
    "supply_ratiometric": "reference_drift",
}
"""Effects whose readings are those of another under any circumstances: the other stands for both.
"""


@dataclass(frozen=True)
class Hypothesis:
    """An effect with its shape given and its sizes free.

    Args:
        effect: the effect at plausible sizes.
        names: bare names of the sizes.
        variants: how many shapes of it are tried: they pay for it.
        alias: catalogue id of a curve that is a known law without a known form.
    """

    effect: Effect
    names: tuple[str, ...]
    variants: int = 1
    alias: str | None = None

    @property
    def id(self) -> str:
        """Catalogue id; ``learned`` for a curve without a name."""
        return self.alias or self.effect.id

    @property
    def listed(self) -> bool:
        """Whether it has a name in the catalogue."""
        return self.alias is not None or not isinstance(self.effect, Learned)

    @property
    def textbook(self) -> bool:
        """Whether its name comes with a form: a name without one is given last, and only where no
        form fits.
        """
        return self.listed and self.alias not in FORMLESS

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
    return replace(effect, values=dict(values))


def adjustable(scenario: Scenario) -> list[Hypothesis]:
    """The terms that ordinary calibration may re-tune, as effects with role ``calibration``;
    unknown heading among them.
    """
    found = []
    for sensor in scenario.sensor:
        for term in sensor.adjustable:
            id = CALIBRATION[sensor.kind][_TERM.index(term)] if term in _TERM else term
            if id:
                found += [
                    _suspect(id, scenario, sensor, axis, role="calibration")
                    for axis in _axes(id, scenario)
                ]
    return found


def _axes(id: str, scenario: Scenario) -> Sequence[str | None]:
    return scenario.rig.axis_names if CATALOGUE[id].axis_wise else (None,)


def _suspect(
    id: str,
    scenario: Scenario,
    sensor: Sensor | None,
    axis: str | None,
    shapes: Mapping[str, float] | None = None,
    variants: int = 1,
    role: str = "found",
) -> Hypothesis:
    cls = CATALOGUE[id]
    bound = sensor if cls.kinds else None
    axes = bound.axes if bound else tuple(dict.fromkeys(a for s in scenario.sensor for a in s.axes))
    names = {n: p for p in cls.parameters if not p.is_shape for n in p.expand(axes)}
    if id == "table_encoder_zero":
        names = {n: p for n, p in names.items() if n.split("_")[0] in scenario.rig.axis_names}
    plausible = {n: p.plausible[GRADES.index("mid_mems")] * p.factor for n, p in names.items()}
    if id == "data_drop":
        plausible = {
            "samples": 1.0
        }  # a whole number: no smaller step changes anything, and a larger one is not linear
    effect = cls({**plausible, **(shapes or {})}, bound.name if bound else None, axis, role)
    return Hypothesis(effect, tuple(names), variants)


LAGS = (0.0, 8.0, 16.0, 30.0, 60.0)  # s, of a temperature
CROSSINGS = (0.0, 0.01, 0.03, 0.1, 0.3)  # rad, of travel from one side of a play to the other
OF_LINES = ("mains_pickup", "base_vibration", "table_encoder_sde")
"""Effects whose shape is a line's frequency."""


def shapes_of(id: str, span: CoordinateRanges) -> list[dict[str, float]]:
    """The shapes an effect is tried at; steps at unknown times are scanned elsewhere."""
    grids: dict[str, Sequence[float]] = {
        "acc_warmup": [span.duration * x for x in (0.03, 0.1, 0.2, 0.5, 1.5)],
        "table_wobble_async": (0.38, 0.4, 0.42, 0.44, 0.46, 0.48),
        "table_encoder_sde": (
            20.0,
            36.0,
            72.0,
            90.0,
            180.0,
            360.0,
            720.0,
            1024.0,
            *(float(n) for n in span.lines.ripples),
        ),
        "base_vibration": span.lines.shakes,
    }
    grids["gyr_warmup"] = grids["acc_warmup"]
    key = {
        "acc_warmup": "tau",
        "gyr_warmup": "tau",
        "table_wobble_async": "ratio",
        "table_encoder_sde": "lines",
        "base_vibration": "frequency",
    }
    if id == "mains_pickup":
        return [
            {"frequency": f, "phase": p}
            for f, p in product(span.lines.tones, (0.0, np.pi / 3, 2 * np.pi / 3))
        ]
    if id == "reference_drift":
        return [{"lag": lag} for lag in LAGS]
    if id == "adc_inl":
        return [{}, {"odd": 1.0}]
    if id in ("acc_scale_asym", "acc_bias_asym"):
        return [{"width": w} for w in (0.0, 0.03, 0.06, 0.12)]
    if id in ("table_backlash", "servo_friction_deadband"):
        return [{"crossing": w} for w in CROSSINGS]
    if id == "floor_tilt_drift":
        return [{"span": span.duration}]
    if id == "acc_thermal_hysteresis":
        low, high = span.ranges.get("temperature", (0.0, 0.0))
        return (
            [{"width": share * (high - low)} for share in (0.1, 0.2, 0.35, 0.5, 0.8)]
            if high > low
            else [{}]
        )
    if id == "acc_hysteresis":
        return [
            {"width": w, "rounded": r} for w, r in product((0.02, 0.1, 0.2, 0.4, 0.8), (0.0, 1.0))
        ]
    if id == "settling_transient":
        top = 0.45 * span.rate_hz
        return [
            {"frequency": f, "tau": t}
            for f, t in product((1.0, 2.0, 3.0, 5.0, 8.0, 12.0), (0.15, 0.5, 1.5))
            if f < top
        ]
    return [{key[id]: value} for value in grids[id]] if id in grids else [{}]


FORMLESS = ("acc_angle_bias", "adc_inl", "floor_tilt_drift")  # laws of nobody's form, or of any
SHIFTS = ("mount_slip", "acc_bias_step", "gyr_bias_step")
"""Effects that shift a reading from an instant on."""
STEPS = (*SHIFTS, "data_drop")


def listed_suspects(
    scenario: Scenario, span: CoordinateRanges, taken: Sequence[Hypothesis] = ()
) -> Iterator[Hypothesis]:
    """Every effect of the catalogue that a residual may hold, but steps at unknown times and faults
    of the data.
    """
    nuisance = {s.place for s in taken}
    for id, cls in CATALOGUE.items():
        if not _eligible(id, scenario):
            continue
        sensors: Sequence[Sensor | None] = scenario.sensors(*cls.kinds) if cls.kinds else (None,)
        if any(p.unit.split("_")[0] == "ug" for p in cls.parameters):  # sizes of acceleration
            sensors = [s for s in sensors if s is None or s.is_accelerometer]
        if (
            issubclass(cls, DelayEffect) and len(sensors) > 1 and cls.stage == "timing"
        ):  # the recorder's own: all sensors alike
            sensors = (*sensors, None) if scenario.rig.axes else sensors
        for sensor, axis in product(sensors, _axes(id, scenario)):
            shapes = shapes_of(id, span)
            for shape in shapes:
                hypothesis = _suspect(id, scenario, sensor, axis, shape, len(shapes))
                if hypothesis.place not in nuisance:
                    yield hypothesis


def _eligible(id: str, scenario: Scenario) -> bool:
    cls = CATALOGUE[id]
    if (
        cls.random
        or issubclass(cls, WritingEffect)
        or cls.stage == "data"
        or id in NO_COLUMN
        or id in SAME_LAW
        or id in STEPS
    ):
        return False
    if (
        cls.stage == "table" or cls.on_table or (cls.stage == "mount" and not cls.kinds)
    ) and not scenario.rig.axes:
        return False
    if id == "acc_angle_bias":  # no form is its own: a curve over the placing angle stands for it
        return False
    if id == "clock_skew" and not scenario.rig.axes:  # one clock, and no table's beside it
        return False
    return not (id in OF_THE_DRIVE and scenario.rig.readout != "command")


def step_suspects(scenario: Scenario, times: Sequence[float]) -> Iterator[Hypothesis]:
    """Effects that begin at an instant, at these times (s from the first stamp)."""
    for id in STEPS:
        cls = CATALOGUE[id]
        if id in ("mount_slip", "data_drop") and not scenario.rig.axes:
            continue
        for sensor in scenario.sensors(*cls.kinds) if cls.kinds else (None,):
            for time in times:
                yield _suspect(
                    id, scenario, sensor, None, {"time": float(time)}, max(len(times), 1)
                )


CREEPS = (0.5, 1.5, 4.0, 10.0, 25.0, 60.0)  # s


def steps_at(scenario: Scenario, time: float, tried: int) -> Iterator[Hypothesis]:
    """Every effect that may have begun at an instant, at once or creeping on; tried: how many
    instants were looked at.
    """
    for step in step_suspects(scenario, (time,)):
        yield replace(step, variants=tried)
        if step.id != "data_drop":
            for creep in CREEPS:
                yield Hypothesis(
                    with_values(step.effect, {**step.effect.values, "creep": creep}),
                    step.names,
                    tried * len(CREEPS),
                )
