"""A traced computation as C in integers, with the range, the places and the error of each number.

A number is an ``int32_t`` with as many binary places as its largest value leaves room for; products
and sums are formed in 64 bits and rounded once.
"""

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from math import asin, hypot, isfinite, pi, sqrt, tanh
from typing import Any, cast

import numpy as np

from tiltcal.calibration.firmware.fixed_functions import (
    PHASE_ERROR,
    RATE_PLACES,
    SINE_ERROR,
    TANH_ERROR,
    TURN,
)
from tiltcal.calibration.firmware.fixed_point import integers, places_for
from tiltcal.calibration.firmware.traced import Node, Program
from tiltcal.core.arrays import Array
from tiltcal.core.errors import TiltcalError
from tiltcal.instrument.model import ROUNDS

BITS = 31  # of a number besides its sign
SATURATED = 22.0  # tanh of it is 1 to 2^-62


@dataclass(frozen=True)
class FixedNumber:
    """A number in integers.

    Args:
        name: in C.
        low, high: range of its values.
        places: binary places.
        error: largest, for exact inputs.
        slope: largest change per unit of each input that is solved for, (k,).
    """

    name: str
    low: float
    high: float
    places: int
    error: float
    slope: Array

    @property
    def size(self) -> float:
        """The largest absolute value."""
        return max(abs(self.low), abs(self.high))


@dataclass
class FixedCode:
    """Writes the statements of a computation.

    Args:
        program: the computation.
        inputs: writes an input by its name.
        prefix: what every C name begins with.
        steep: smallest component across a placing angle, and along the axis that an instrument
            lacks, for which errors are stated, m/s2.
        wander: how far a step may be from each input that is solved for, (k,).
    """

    program: Program
    inputs: "Callable[[FixedCode, str], FixedNumber]"
    prefix: str
    steep: float
    wander: Array
    statements: list[str] = field(default_factory=list)
    used: set[str] = field(default_factory=set)

    @property
    def k(self) -> int:
        """How many inputs are solved for."""
        return len(self.wander)

    def results(self, nodes: list[int]) -> list[FixedNumber]:
        """The numbers of some nodes, with all that they need."""
        known: dict[int, FixedNumber] = {}
        for index in self.program.needed(nodes, opaque="share"):
            node = self.program.nodes[index]
            if node.operation == "share":
                known[index] = self._share(self.program.nodes[node.arguments[1]].value)
                continue
            known[index] = self._number(node, [known[a] for a in node.arguments])
        return [known[n] for n in nodes]

    def _number(self, node: Node, given: list[FixedNumber]) -> FixedNumber:
        if node.operation == "input":
            return self.inputs(self, node.name)
        if node.operation == "constant":
            return self.constant(node.value)
        if node.operation == "upright":
            return self._upright(given, node.value)
        if node.operation == "multiply" and node.arguments[0] == node.arguments[1]:
            return replace(self._multiply(*given), low=_least(given[0]) ** 2)
        rule = getattr(self, f"_{node.operation}", None)
        if rule is None:
            raise no_integers(f"a term with {node.operation}")
        return cast(FixedNumber, rule(*given))

    def constant(self, value: float) -> FixedNumber:
        """A constant, to 31 bits."""
        places = places_for(abs(value), BITS)
        (whole,) = integers(np.array(value), places)
        error = abs(value - whole * 2.0**-places)
        return FixedNumber(f"({whole})", value, value, places, error, np.zeros(self.k))

    def scaled(self, a: FixedNumber, factor: float) -> FixedNumber:
        """A number times a constant."""
        return self._multiply(a, self.constant(factor))

    def _multiply(self, a: FixedNumber, b: FixedNumber) -> FixedNumber:
        low, high = _extremes(x * y for x in _ends(a) for y in _ends(b))
        error = a.size * b.error + b.size * a.error + a.error * b.error
        slope = a.size * b.slope + b.size * a.slope
        expression = f"(int64_t){a.name} * {b.name}"
        return self._written(low, high, expression, a.places + b.places, error, slope)

    def _add(self, a: FixedNumber, b: FixedNumber, sign: int = 1) -> FixedNumber:
        low, high = _extremes(x + sign * y for x in _ends(a) for y in _ends(b))
        places = places_for(max(abs(low), abs(high)), BITS)
        # in 64 bits, with as many places as leave room for both
        common = min(max(a.places, b.places), min(a.places, b.places) + 30, places + 30)
        error = a.error + b.error
        parts = [self._aligned(number, common) for number in (a, b)]
        error += sum(_lost(number, common) for number in (a, b))
        expression = f"{parts[0]} {'+' if sign > 0 else '-'} {parts[1]}"
        return self._written(low, high, expression, common, error, a.slope + b.slope)

    def _subtract(self, a: FixedNumber, b: FixedNumber) -> FixedNumber:
        return self._add(a, b, -1)

    def _divide(self, a: FixedNumber, b: FixedNumber) -> FixedNumber:
        if b.low != b.high:
            raise no_integers("a quotient of two readings")
        return self.scaled(a, 1 / b.low)

    def _negative(self, a: FixedNumber) -> FixedNumber:
        return replace(a, name=f"(-{a.name})", low=-a.high, high=-a.low)

    def _absolute(self, a: FixedNumber) -> FixedNumber:
        text = f"{a.name} < 0 ? -{a.name} : {a.name}"
        return self._stated(_least(a), a.size, text, a.places, a.error, a.slope)

    def _hypot(self, a: FixedNumber, b: FixedNumber) -> FixedNumber:
        common = min(a.places, b.places)
        squares, error = self._squares([a, b], common)
        rest = " + ".join(f"(uint64_t)({s})" for s in squares)
        low, high = hypot(_least(a), _least(b)), hypot(a.size, b.size)
        return self._root(low, high, rest, common, error, a.slope + b.slope)

    def _root(
        self, low: float, high: float, rest: str, places: int, error: float, slope: Array
    ) -> FixedNumber:
        """The root of a square with twice these places, rounded down."""
        self.used.add("root")
        expression = f"(int64_t){self.prefix}_root({rest})"
        return self._written(low, high, expression, places, error + 2.0**-places, slope)

    def _squares(self, given: list[FixedNumber], common: int) -> tuple[list[str], float]:
        """Squares in 64 bits with twice the common places, and the error of their root."""
        names = [self._named("int64_t", self._aligned(n, common)) for n in given]
        error = sum(n.error + _lost(n, common) for n in given)
        return [f"{name} * {name}" for name in names], error

    def _upright(self, given: list[FixedNumber], g: float) -> FixedNumber:
        """Slopes are those of chords from a solution whose third component is ``steep`` or more:
        ``|sqrt(a) - sqrt(b)| = |a - b| / (sqrt(a) + sqrt(b))``, and each component adds to |a - b|
        its change times the sum of its sizes at both ends.
        """
        common = places_for(g, BITS)
        squares, error = self._squares(given, common)
        (whole,) = integers(np.array(g * g), 2 * common)
        rest = self._named("int64_t", " - ".join([f"INT64_C({whole})", *squares]))
        moved = np.array([n.slope @ self.wander for n in given])
        across = 2 * sqrt(g * g - self.steep**2) + moved
        least = sqrt(max(self.steep**2 - float(across @ moved), 0.0))
        chord = float(across.max()) / (self.steep + least)
        slope = chord * np.sum([n.slope for n in given], axis=0)
        text = f"{rest} > 0 ? (uint64_t){rest} : 0"
        error = chord * error + 2.0 ** (-2 * common) / self.steep
        return self._root(0.0, g, text, common, error, slope)

    def _share(self, c: float) -> FixedNumber:
        """One: c is far below the square of ``steep``, which what it is added to is at least."""
        return replace(self.constant(1.0), error=c / self.steep**2)

    def _arctan2(self, a: FixedNumber, b: FixedNumber) -> FixedNumber:
        """Slopes are those of chords from a direction of length ``steep`` or more: what moves it
        by less than that turns it by the arcsine of the quotient at most, else by pi.
        """
        turned = float((a.slope + b.slope) @ self.wander) / self.steep
        per = (pi if turned >= 1 else asin(turned) / turned if turned else 1.0) / self.steep
        common = min(a.places, b.places)
        sine, cosine = (self._aligned(n, common) for n in (a, b))
        moved = sum(n.error + _lost(n, common) for n in (a, b))
        self.used.add("phase")
        phase = f"{self.prefix}_phase((int32_t)({sine}), (int32_t)({cosine}))"
        (factor,) = integers(np.array(pi / 4), 31)  # a phase of 2^32 a turn as rad with 29 places
        error = per * moved + PHASE_ERROR + 2.0**-31 * pi
        return self._written(-pi, pi, f"{phase} * {factor}", 60, error, per * (a.slope + b.slope))

    def _sin(self, a: FixedNumber, quarter: str = "") -> FixedNumber:
        self.used.add("sine")
        turned = self._shifted(f"(int64_t){a.name} * {round(2 * TURN)}", a.places + 1)
        text = f"{self.prefix}_sine((uint32_t)({turned}){quarter})"
        error = a.error + a.size * 2.0**-31 + 0.5 / TURN + SINE_ERROR
        return self._stated(-1.0, 1.0, text, 30, error, a.slope)

    def _cos(self, a: FixedNumber) -> FixedNumber:
        return self._sin(a, f" + UINT32_C({1 << 30})")

    def _tanh(self, a: FixedNumber) -> FixedNumber:
        self.used |= {"tanh", "gain"}
        per = round(2 / np.log(2) * 2.0 ** (RATE_PLACES - a.places))
        limit = int(SATURATED * 2.0**a.places)
        text = f"{self.prefix}_tanh({a.name}, UINT64_C({per}), UINT64_C({limit}))"
        return self._stated(tanh(a.low), tanh(a.high), text, 30, a.error + TANH_ERROR, a.slope)

    def of_state(
        self, name: str, low: float, high: float, places: int, error: float
    ) -> FixedNumber:
        """A number of the state, which has 64 bits, with its places and its error."""
        if low == high:
            return self.constant(low)
        return self._written(low, high, name, places, error, np.zeros(self.k))

    def held(self, a: FixedNumber, limit: float) -> FixedNumber:
        """A number held to -limit ... limit."""
        (whole,) = integers(np.array(limit), a.places)
        text = f"{a.name} < -{whole} ? -{whole} : {a.name} > {whole} ? {whole} : {a.name}"
        return self._stated(
            max(a.low, -limit), min(a.high, limit), text, a.places, a.error, a.slope
        )

    def rounded(self, a: FixedNumber, places: int) -> FixedNumber:
        """A number with these places, or as many as it has."""
        if a.places <= places:
            return a
        text = f"(int32_t){self._shifted(a.name, a.places - places)}"
        return self._stated(a.low, a.high, text, places, a.error + 2.0 ** (-places - 1), a.slope)

    def _written(
        self, low: float, high: float, expression: str, places: int, error: float, slope: Array
    ) -> FixedNumber:
        """A number from an expression in 64 bits with its places."""
        bound = max(abs(low), abs(high))
        if not isfinite(bound) or bound > 2.0**62:
            raise no_integers("a value without a bound over the range")
        own = min(places_for(bound, BITS), places + BITS)  # no more than the expression may have
        shift = places - own
        error += 2.0 ** (-own - 1) if shift > 0 else 0.0
        return self._stated(
            low, high, f"(int32_t){self._shifted(expression, shift)}", own, error, slope
        )

    def _stated(
        self, low: float, high: float, text: str, places: int, error: float, slope: Array
    ) -> FixedNumber:
        return FixedNumber(self._named("int32_t", text), low, high, places, error, slope)

    def _named(self, kind: str, text: str) -> str:
        name = f"t{len(self.statements)}"
        self.statements.append(f"const {kind} {name} = {text};")
        return name

    def _aligned(self, a: FixedNumber, places: int) -> str:
        """A number in 64 bits with other places."""
        text = f"(int64_t){a.name}"
        return text if a.places == places else self._shifted(text, a.places - places)

    def _shifted(self, text: str, places: int) -> str:
        """An expression over 2^places, rounded to the nearest; all are below 2^62."""
        if places > 62:
            return f"(({text}) * 0)"
        if places > 0:
            return f"{self.prefix}_shifted({text}, {places})"
        return f"(({text}) * ((int64_t)1 << {-places}))" if places else f"({text})"


def _lost(a: FixedNumber, places: int) -> float:
    """What rounding a number to these places adds to its error."""
    return 2.0 ** (-places - 1) if a.places > places else 0.0


def _least(a: FixedNumber) -> float:
    """The smallest absolute value."""
    return 0.0 if a.low < 0 < a.high else min(map(abs, _ends(a)))


def _ends(a: FixedNumber) -> tuple[float, float]:
    return a.low, a.high


def _extremes(values: Any) -> tuple[float, float]:
    found = list(values)
    return min(found), max(found)


def no_integers(found: str, sensor: str = "") -> TiltcalError:
    """The error for terms that integers do not have. sensor: whose readings have what was found."""
    changed = 2.0 ** (-BITS / ROUNDS)  # halves the last place within the rounds
    return TiltcalError(
        "firmware in integers" + (sensor and f", sensor {sensor}"),
        found=found,
        need=f"terms that change by less than {changed:.2g} of their input: one for each reading",
        do="export with --no-integers, or state a smaller full_scale of the sensor in the scenario",
    )
