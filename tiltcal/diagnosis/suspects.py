"""Who may be to blame: every effect of the catalogue at a few shapes, and curves that no name fits."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import combinations, product
from typing import Any

import numpy as np

from tiltcal.diagnosis.observations import Observations
from tiltcal.effects import CATALOGUE
from tiltcal.effects.base import DelayEffect, Effect, WritingEffect
from tiltcal.effects.learned import ORDERS, Learned, LearnedReading, LearnedReadout, LearnedTilt
from tiltcal.frames import Array
from tiltcal.grades import GRADES
from tiltcal.motion import Index
from tiltcal.scenario import Scenario
from tiltcal.sensitivity import NO_COLUMN, OF_THE_DRIVE
from tiltcal.setup import Sensor

CALIBRATION = {
    "accelerometer": ("acc_bias", "acc_scale", "acc_cross_axis"), "inclinometer": ("acc_bias", "acc_scale", "acc_cross_axis"),
    "gyro": ("gyr_bias", "gyr_scale", "gyr_misalignment"), "fog": ("fog_bias", "fog_scale", ""),
}  # fmt: skip
_TERM = ("bias", "scale", "cross_axis")
SAME_LAW = {
    "rate_error": "cable_torque", "servo_droop": "table_sag", "table_unbalance": "table_encoder_eccentricity",
    "servo_ripple": "table_encoder_sde", "mount_misalignment": "acc_cross_axis", "mount_resonance": "settling_transient",
    "adc_gain_error": "acc_scale", "adc_offset_drift": "acc_temp_bias", "supply_ratiometric": "reference_drift",
}  # fmt: skip
"""Effects whose readings are those of another under any circumstances: the other stands for both."""


@dataclass(frozen=True)
class Suspect:
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
        """Whether its name comes with a form: a name without one is given last, and only where no form fits."""
        return self.listed and self.alias not in FORMLESS

    @property
    def place(self) -> tuple[str, str | None, str | None]:
        """Id, sensor, axis: the same for all shapes of one explanation."""
        return self.id, self.effect.sensor, self.effect.axis

    def at(self, values: Mapping[str, float]) -> Effect:
        """The effect at these sizes, its shape kept."""
        return _with(self.effect, {**{k: v for k, v in self.effect.values.items() if k not in self.names}, **values})

    def size(self, name: str) -> float:
        """Plausible size of a parameter, SI."""
        return abs(self.effect.values[name])

    def alone(self, name: str) -> Effect:
        """The effect with one size only, at its plausible value."""
        return self.at({name: self.effect.values[name]})


def _with(effect: Effect, values: Mapping[str, float]) -> Effect:
    return replace(effect, values=dict(values))


def adjustable(scenario: Scenario) -> list[Suspect]:
    """The terms that ordinary calibration may re-tune, as effects with role ``calibration``; unknown heading among them."""
    found = []
    for sensor in scenario.sensor:
        for term in sensor.adjustable:
            id = CALIBRATION[sensor.kind][_TERM.index(term)] if term in _TERM else term
            if id:
                found += [_suspect(id, scenario, sensor, axis, role="calibration") for axis in _axes(id, scenario)]
    return found


def _axes(id: str, scenario: Scenario) -> Sequence[str | None]:
    return scenario.rig.axis_names if CATALOGUE[id].axis_wise else (None,)


def _suspect(
    id: str, scenario: Scenario, sensor: Sensor | None, axis: str | None, shapes: Mapping[str, float] | None = None,
    variants: int = 1, role: str = "found",
) -> Suspect:  # fmt: skip
    cls = CATALOGUE[id]
    bound = sensor if cls.kinds else None
    axes = bound.axes if bound else tuple(dict.fromkeys(a for s in scenario.sensor for a in s.axes))
    names = {n: p for p in cls.parameters if not p.is_shape for n in p.expand(axes)}
    if id == "data_drop":
        plausible = {"samples": 1.0}
    if id == "table_encoder_zero":
        names = {n: p for n, p in names.items() if n.split("_")[0] in scenario.rig.axis_names}
    plausible = {n: p.plausible[GRADES.index("mid_mems")] * p.factor for n, p in names.items()}
    effect = cls({**plausible, **(shapes or {})}, bound.name if bound else None, axis, role)
    return Suspect(effect, tuple(names), variants)


@dataclass(frozen=True)
class Lines:
    """What beats in a residual.

    Args:
        tones: Hz, in the readings; shakes: Hz, in the world; echoes: Hz, anew after each move; ripples: a turn of an axis.
    """

    tones: tuple[float, ...] = ()
    shakes: tuple[float, ...] = ()
    echoes: tuple[float, ...] = ()
    ripples: tuple[int, ...] = ()

    def beside(self, known: "Lines", width: float) -> "Lines":
        """Those tones, shakes and ripples that are not among the known ones; width: Hz, of a line."""

        def new(mine: Sequence[float], theirs: Sequence[float]) -> tuple[float, ...]:
            return tuple(f for f in mine if all(abs(f - g) > 2 * width for g in theirs))

        ripples = tuple(n for n in self.ripples if n not in known.ripples)
        return Lines(new(self.tones, known.tones), new(self.shakes, known.shakes), (), ripples)


OF_LINES = ("mains_pickup", "base_vibration", "table_encoder_sde")
"""Effects whose shape is a line's frequency."""


@dataclass(frozen=True)
class Span:
    """What a recording spans, for shapes and curves.

    Args:
        duration: s; rate_hz: of the fastest sensor.
        lines: that stand out of the residual.
        ranges: least and largest value of each coordinate, SI; that of a sensor's own input under ``<sensor>_input``.
    """

    duration: float
    rate_hz: float
    lines: Lines = Lines()
    ranges: Mapping[str, tuple[float, float]] = field(default_factory=dict)


def shapes_of(id: str, span: Span) -> list[dict[str, float]]:
    """The shapes an effect is tried at; steps at unknown times are scanned elsewhere."""
    grids: dict[str, Sequence[float]] = {
        "settling_transient": [], "mount_resonance": [],
        "acc_warmup": [span.duration * x for x in (0.03, 0.1, 0.2, 0.5, 1.5)],
        "table_wobble_async": (0.38, 0.4, 0.42, 0.44, 0.46, 0.48),
        "table_encoder_sde": (20.0, 36.0, 72.0, 90.0, 180.0, 360.0, 720.0, 1024.0, *(float(n) for n in span.lines.ripples)),
        "mains_pickup": span.lines.tones, "base_vibration": span.lines.shakes,
    }  # fmt: skip
    grids["gyr_warmup"] = grids["acc_warmup"]
    key = {"acc_warmup": "tau", "gyr_warmup": "tau", "table_wobble_async": "ratio",
           "table_encoder_sde": "lines", "mains_pickup": "frequency", "base_vibration": "frequency"}  # fmt: skip
    if id == "adc_inl":
        return [{}, {"odd": 1.0}]
    if id == "floor_tilt_drift":
        return [{"span": span.duration}]
    if id == "acc_thermal_hysteresis":
        low, high = span.ranges.get("temperature", (0.0, 0.0))
        return [{"width": share * (high - low)} for share in (0.1, 0.2, 0.35, 0.5, 0.8)] if high > low else [{}]
    if id == "acc_hysteresis":
        return [{"width": w, "rounded": r} for w, r in product((0.02, 0.1, 0.2, 0.4, 0.8), (0.0, 1.0))]
    if id in ("settling_transient", "mount_resonance"):
        top = 0.45 * span.rate_hz
        return [{"frequency": f, "tau": t} for f, t in product((1.0, 2.0, 3.0, 5.0, 8.0, 12.0), (0.15, 0.5, 1.5)) if f < top]
    return [{key[id]: value} for value in grids[id]] if id in grids else [{}]


FORMLESS = ("acc_angle_bias", "adc_inl")  # laws of nobody's form
LAGS = (0.0, 8.0, 16.0, 30.0, 60.0)  # s, of a temperature
MEMORIES = (3.0, 8.0, 20.0)  # s, of a force or a rate
STEPS = ("mount_slip", "acc_bias_step", "gyr_bias_step", "data_drop")


def listed_suspects(scenario: Scenario, span: Span, taken: Sequence[Suspect] = ()) -> Iterator[Suspect]:
    """Every effect of the catalogue that a residual may hold, but steps at unknown times and faults of the data."""
    nuisance = {s.place for s in taken}
    for id, cls in CATALOGUE.items():
        if not _eligible(id, scenario):
            continue
        sensors: Sequence[Sensor | None] = scenario.sensors(*cls.kinds) if cls.kinds else (None,)
        if any(p.unit.split("_")[0] == "ug" for p in cls.parameters):  # sizes of acceleration
            sensors = [s for s in sensors if s is None or s.is_accelerometer]
        if issubclass(cls, DelayEffect) and len(sensors) > 1 and cls.stage == "timing":  # the recorder's own: all sensors alike
            sensors = (*sensors, None) if scenario.rig.axes else sensors
        for sensor, axis in product(sensors, _axes(id, scenario)):
            shapes = shapes_of(id, span)
            for shape in shapes:
                suspect = _suspect(id, scenario, sensor, axis, shape, len(shapes))
                if suspect.place not in nuisance:
                    yield suspect


def _eligible(id: str, scenario: Scenario) -> bool:
    cls = CATALOGUE[id]
    if cls.random or issubclass(cls, WritingEffect) or cls.stage == "data" or id in NO_COLUMN or id in SAME_LAW or id in STEPS:
        return False
    if (cls.stage == "table" or cls.on_table or (cls.stage == "mount" and not cls.kinds)) and not scenario.rig.axes:
        return False
    if id == "acc_angle_bias":  # no form is its own: a curve over the placing angle stands for it
        return False
    if id == "clock_skew" and not scenario.rig.axes:  # one clock, and no table's beside it
        return False
    return not (id in OF_THE_DRIVE and scenario.rig.readout != "command")


def step_suspects(scenario: Scenario, times: Sequence[float]) -> Iterator[Suspect]:
    """Effects that begin at an instant, at these times (s from the first stamp)."""
    for id in STEPS:
        cls = CATALOGUE[id]
        if id in ("mount_slip", "data_drop") and not scenario.rig.axes:
            continue
        for sensor in scenario.sensors(*cls.kinds) if cls.kinds else (None,):
            for time in times:
                yield _suspect(id, scenario, sensor, None, {"time": float(time)}, max(len(times), 1))


CREEPS = (4.0, 10.0, 25.0, 60.0)  # s


def steps_at(scenario: Scenario, time: float, tried: int) -> Iterator[Suspect]:
    """Every effect that may have begun at an instant, at once or creeping on; tried: how many instants were looked at."""
    for step in step_suspects(scenario, (time,)):
        yield replace(step, variants=tried)
        if step.id != "data_drop":
            for creep in CREEPS:
                yield Suspect(_with(step.effect, {**step.effect.values, "creep": creep}), step.names, tried * len(CREEPS))


def curves(observations: Observations, span: Span) -> Iterator[Suspect]:
    """Curves over every coordinate at every place of the chain: the open world."""
    scenario = observations.scenario
    for sensor in scenario.sensor:
        for axis in sensor.axes:
            if any(c.sensor == sensor.name for c in observations.channels):
                yield from _reading_curves(scenario, sensor, axis, span)
    for axis in scenario.rig.axis_names:
        for other in scenario.rig.axis_names:
            for basis in (_waves(4), _knots(f"table_{other}", span, 10)):
                if not basis:
                    continue
                yield _curve(LearnedReadout, f"table_{other}", basis, axis=axis, place="table")
                for turn in _across(dict(scenario.rig.axes)[axis]):
                    yield _curve(LearnedTilt, f"table_{other}", basis, slot=f"{axis}_bearing", turn=turn, place="table")
    if scenario.rig.axes:
        for slot, turns in (("base", "xy"), ("mount", "xyz")):
            for turn, coordinate in product(turns, ("time", "temperature")):
                if knots := _knots(coordinate, span, 5):
                    place = "environment" if slot == "base" else "mount"
                    yield _curve(LearnedTilt, coordinate, knots, slot=slot, turn=turn, place=place)
        for turn, axis in product("xyz", scenario.rig.axis_names):
            for basis in (_waves(4), _knots(f"table_{axis}", span, 10)):
                if basis:
                    yield _curve(LearnedTilt, f"table_{axis}", basis, slot="mount", turn=turn, place="mount")
        for turn, lag in product("xyz", LAGS):
            if knots := _knots("temperature", span, 3):
                tilt = _curve(LearnedTilt, "temperature", knots, lag=lag, slot="mount", turn=turn, place="mount")
                yield _late(tilt, "mount_thermal_tilt")


def _reading_curves(scenario: Scenario, sensor: Sensor, axis: str, span: Span) -> Iterator[Suspect]:
    where: dict[str, Any] = {"sensor": sensor.name, "axis": axis}
    yield from _angle_curves(scenario, sensor, axis, span)
    for count in (9, 17, 33) if sensor.is_accelerometer else ():
        if knots := _knots(f"{sensor.name}_input", span, count):
            yield replace(_curve(LearnedReading, "input", knots, **where), alias="adc_inl")
    inputs = [f"{q}_{a}" for q in ("force", "rate") for a in "xyz"]
    own = f"{'force' if sensor.is_accelerometer else 'rate'}_{axis}"
    across = ["transverse"] if sensor.kind == "fog" else []
    for coordinate in ("input", "time", "temperature", "warming", *inputs, *across):
        if coordinate == own or (sensor.is_accelerometer and coordinate.startswith("rate")):
            continue
        if knots := _knots(coordinate if coordinate != "input" else f"{sensor.name}_input", span, 7):
            yield _curve(LearnedReading, coordinate, knots, **where)
    for coordinate in ("time", "temperature"):
        if knots := _knots(coordinate, span, 5):
            yield _curve(LearnedReading, coordinate, knots, per_input=True, **where)
    yield from _late_laws(sensor, axis, span)
    if scenario.rig.axes or not sensor.is_accelerometer:  # by hand only the length of its reading is known
        yield from _histories(sensor, axis, inputs, span)


def _angle_curves(scenario: Scenario, sensor: Sensor, axis: str, span: Span) -> Iterator[Suspect]:
    """Of the table's angles, one by one and in products of two."""
    where: dict[str, Any] = {"sensor": sensor.name, "axis": axis}
    names = scenario.rig.axis_names
    for name in names:
        for basis in (_waves(4), _waves(10), _knots(f"table_{name}", span, 10)):
            if basis:
                yield _curve(LearnedReading, f"table_{name}", basis, **where)
    for one, other in combinations(names, 2):
        yield _curve(LearnedReading, f"table_{one}", 4 * ORDERS**2, beside=f"table_{other}", **where)
    if sensor.is_accelerometer and scenario.rig.table == "placing":  # its form is nobody's law, its place is
        yield replace(_curve(LearnedReading, "table_outer", _waves(6), **where), alias="acc_angle_bias")


def _late_laws(sensor: Sensor, axis: str, span: Span) -> Iterator[Suspect]:
    """Laws of temperature where the thermometer and the sensor are not of one temperature."""
    where: dict[str, Any] = {"sensor": sensor.name, "axis": axis}
    name = "acc_temp_bias" if sensor.is_accelerometer else "gyr_temp"
    for lag in LAGS:
        if knots := _knots("temperature", span, 3):
            yield _late(_curve(LearnedReading, "temperature", knots, lag=lag, **where), name)
            if sensor.is_accelerometer:
                scale = _curve(LearnedReading, "temperature", knots, lag=lag, per_input=True, **where)
                yield _late(scale, "acc_temp_scale")


def _histories(sensor: Sensor, axis: str, inputs: Sequence[str], span: Span) -> Iterator[Suspect]:
    """What went before: the number of moves, the time since the last one, forces and rates that leak away."""
    where: dict[str, Any] = {"sensor": sensor.name, "axis": axis}
    if knots := _spread("since_move", span):
        yield _curve(LearnedReading, "since_move", knots, **where)
        for frequency in span.lines.echoes:
            yield _curve(LearnedReading, "since_move", 2, period=1 / frequency, **where)
        yield _curve(LearnedReading, "moves", _knots("moves", span, 7), **where)
        for period in (2, 3, 4, 5):
            yield _curve(LearnedReading, "moves", 2 * (period // 2) - (period % 2 == 0), period=float(period), **where)
    for coordinate, lag in product(inputs, MEMORIES):
        if knots := _knots(coordinate, span, 3):
            curve = _curve(LearnedReading, coordinate, knots, lag=lag, **where)
            yield replace(_odd(curve), variants=len(MEMORIES))


def _odd(curve: Suspect) -> Suspect:
    """A curve through nothing at the middle of its range."""
    names = (curve.names[0], curve.names[-1])
    return Suspect(_with(curve.effect, {n: curve.effect.values[n] for n in names}), names)


def _spread(coordinate: str, span: Span) -> tuple[float, ...]:
    """Knots ever further apart: what follows a move is quick at first."""
    high = span.ranges.get(coordinate, (0.0, 0.0))[1]
    knots = (0.0, *np.geomspace(0.4, high, 7)) if high > 2.0 else ()
    return tuple(float(k) for k in knots)


def _late(curve: Suspect, alias: str) -> Suspect:
    """A law of temperature that is felt late and may bend: nothing at the middle of the range, as the law has nothing at T0."""
    return replace(_odd(curve), variants=len(LAGS), alias=alias)


def _knots(coordinate: str, span: Span, count: int) -> tuple[float, ...]:
    low, high = span.ranges.get(coordinate, (0.0, 0.0))
    return tuple(np.linspace(low, high, count)) if high > low else ()


def _waves(harmonics: int) -> int:
    return 2 * harmonics


def _across(axis: str) -> tuple[str, str]:
    i = "xyz".index(axis)
    return "xyz"[(i + 1) % 3], "xyz"[(i + 2) % 3]


def _curve(cls: type[Learned], coordinate: str, basis: int | tuple[float, ...], **where: Any) -> Suspect:
    knots = () if isinstance(basis, int) else basis
    names = tuple(f"c{k}" for k in range(basis if isinstance(basis, int) else len(basis)))
    effect = cls(dict.fromkeys(names, 1e-6), where.pop("sensor", None), where.pop("axis", None), "found",
                 coordinate=coordinate, knots=knots, **where)  # fmt: skip
    return Suspect(effect, names)


def span_of(observations: Observations, lines: Lines) -> Span:
    """What some recordings span."""
    ranges: dict[str, tuple[float, float]] = {}
    duration = max(float(r.time[-1] - r.time[0]) for r in observations.recordings)
    ranges["time"] = (0.0, duration)
    temperature = [t - t.mean() for r in observations.recordings if (t := r.temperature()) is not None]
    if temperature:
        both = np.concatenate(temperature)
        ranges["temperature"] = (float(both.min()), float(both.max()))
        slopes = np.concatenate([np.gradient(t, r.time) for t, r in zip(temperature, observations.recordings, strict=False)])
        ranges["warming"] = (float(slopes.min()), float(slopes.max()))
    for axis in observations.scenario.rig.axis_names:
        turned = np.concatenate([a[~np.isnan(a)] for r in observations.recordings if (a := r.table(axis)) is not None])
        ranges[f"table_{axis}"] = (float(turned.min()), float(turned.max()))
    for channel in observations.channels:
        low, high = float(channel.values.min()), float(channel.values.max())
        known = ranges.get(f"{channel.sensor}_input", (low, high))
        ranges[f"{channel.sensor}_input"] = (min(low, known[0]), max(high, known[1]))
    g = observations.scenario.site.gravity
    stops = [observations.stops_at(k) for k in range(len(observations.recordings))]
    if any((stop >= 0).any() and (stop < 0).any() for stop in stops):
        ranges["since_move"] = (0.0, max(_longest_rest(r.time, s) for r, s in zip(observations.recordings, stops, strict=True)))
        ranges["moves"] = (0.0, float(max(stop.max() for stop in stops)) + 1)
    ranges |= {f"force_{a}": (-g, g) for a in "xyz"}
    if (top := fastest(observations)) > 0:
        ranges |= {f"rate_{a}": (-top, top) for a in "xyz"} | {"transverse": (0.0, top)}
    rate = max(s.rate_hz for s in observations.scenario.sensor)
    return Span(duration, rate, lines, ranges)


def _longest_rest(time: Array, stop: Index) -> float:
    """Duration of the longest stop, s."""
    return max((float(np.ptp(time[stop == k])) for k in range(int(stop.max(initial=-1)) + 1)), default=0.0)


def fastest(observations: Observations) -> float:
    """The largest rate, rad/s: as gyros read it, or as the table turned."""
    rates = [c.values for c in observations.channels if observations.scenario.named(c.sensor).quantity == "rate"]
    if rates:
        return max(float(np.abs(r).max()) for r in rates)
    found = [0.0]
    for recording in observations.recordings:
        for axis in observations.scenario.rig.axis_names:
            angle = recording.table(axis)
            if angle is not None:
                known = ~np.isnan(angle)
                time, angle = recording.time[known], angle[known]
                found.append(float(np.percentile(np.abs(np.diff(angle)) / np.diff(time), 99)))
    return max(found)
