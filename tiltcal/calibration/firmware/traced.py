"""Terms as C: an effect is evaluated on traced numbers, which write down what is computed."""

import re
from collections.abc import Callable
from typing import Any

import numpy as np

from tiltcal.core.arrays import Array
from tiltcal.core.errors import TiltcalError
from tiltcal.effects.sense import Sense

BINARY = {
    np.add: "({} + {})",
    np.subtract: "({} - {})",
    np.multiply: "({} * {})",
    np.true_divide: "({} / {})",
    np.hypot: "{{F}}(hypot)({}, {})",
    np.arctan2: "{{F}}(atan2)({}, {})",
}
UNARY = {
    np.negative: "(-{})",
    np.abs: "{{F}}(fabs)({})",
    np.tanh: "{{F}}(tanh)({})",
    np.sin: "{{F}}(sin)({})",
    np.cos: "{{F}}(cos)({})",
    np.sqrt: "{{F}}(sqrt)({})",
    np.sign: "({0} > 0 ? 1 : {0} < 0 ? -1 : ({{R}})0)",
}
"""C of each operation; ``{F}`` wraps the name of a function, ``{R}`` is the type of numbers."""


WORD = re.compile(r"\bt\d+\b")


class Program:
    """Statements in the order of the computation; what is computed twice is written once.

    Args:
        real: type of its numbers in C.
        function: macro that gives a function its suffix.
    """

    def __init__(self, real: str, function: str) -> None:
        self.real, self.function = real, function
        self.statements: list[str] = []
        self._known: dict[str, str] = {}

    def number(self, expression: str) -> "Traced":
        """A number with this expression."""
        expression = expression.format(F=self.function, R=self.real)
        if expression not in self._known:
            name = f"t{len(self._known)}"
            self._known[expression] = name
            self.statements.append(f"const {self.real} {name} = {expression};")
        return Traced(self, self._known[expression])

    def needed(self, results: list[str]) -> list[str]:
        """The statements that some results need."""
        names = {name: expression for expression, name in self._known.items()}
        used, open_ = set(), [word for r in results for word in WORD.findall(r)]
        while open_:
            name = open_.pop()
            if name in names and name not in used:
                used.add(name)
                open_ += WORD.findall(names[name])
        known = zip(self._known.values(), self.statements, strict=True)
        return [statement for name, statement in known if name in used]

    def constant(self, value: float) -> str:
        """A constant in C."""
        return f"({self.real}){value!r}"


class Traced(np.lib.mixins.NDArrayOperatorsMixin):
    """One row of a column: a number in C.

    Args:
        program: that it is part of.
        name: of the number, or its expression.
    """

    def __init__(self, program: Program, name: str) -> None:
        self.program, self.name = program, name

    def __array_ufunc__(self, ufunc: Any, method: str, *inputs: Any, **options: Any) -> "Traced":
        """What numpy calls for an operation on it."""
        if method != "__call__" or options.get("out") is not None:
            raise _no_code(f"{ufunc.__name__}.{method}")
        if ufunc is np.square:
            ufunc, inputs = np.power, (inputs[0], 2)
        if ufunc is np.power:
            return self._power(*inputs)
        names = [self._name_of(value) for value in inputs]
        form = BINARY.get(ufunc) if len(names) == 2 else UNARY.get(ufunc)
        if form is None:
            raise _no_code(ufunc.__name__)
        return self.program.number(form.format(*names))

    def __array_function__(
        self, function: Callable[..., Any], types: Any, inputs: Any, options: Any
    ) -> "Traced":
        """What numpy calls for ``ones_like`` and ``zeros_like``."""
        filled = {"ones_like": 1.0, "zeros_like": 0.0}.get(function.__name__)
        if filled is None:
            raise _no_code(function.__name__)
        return Traced(self.program, self.program.constant(filled))

    def _power(self, base: Any, exponent: Any) -> "Traced":
        """A power by repeated multiplication: the exponent is a whole number."""
        count = int(exponent)
        if count != exponent or count < 0 or not isinstance(base, Traced):
            raise _no_code(f"power {exponent}")
        found = Traced(self.program, self.program.constant(1.0)) if count == 0 else base
        for _ in range(count - 1):
            found = found * base
        return found

    def _name_of(self, value: Any) -> str:
        if isinstance(value, Traced):
            return value.name
        return self.program.constant(float(np.asarray(value).item()))


class TracedRows:
    """What stands for an array of three columns: ``rows[:, i]`` is a traced number.

    Args:
        columns: the three.
    """

    def __init__(self, columns: list[Traced]) -> None:
        self.columns = columns

    def __getitem__(self, index: Any) -> Any:
        """A column."""
        return self.columns[index[1]]

    def __pow__(self, exponent: int) -> "TracedRows":
        """Each column to a power."""
        return TracedRows([column**exponent for column in self.columns])

    def __matmul__(self, vector: Array) -> Traced:
        """Sum of the columns, each times a number."""
        return sum(
            (c * float(v) for c, v in zip(self.columns[1:], vector[1:], strict=True)),
            self.columns[0] * float(vector[0]),
        )

    def sum(self, axis: int) -> Traced:
        """Sum over the columns."""
        total = self.columns[0] + self.columns[1]
        return total + self.columns[2] if axis == 1 else total


class TracedSense(Sense):
    """What a sensor senses, as traced numbers."""

    def vector_input(self) -> Any:
        """Force or rate along the three body axes."""
        return self.force if self.kind in ("accelerometer", "inclinometer") else self.rate

    def true_input(self) -> Any:
        """Force or rate along each channel."""
        if self.kind == "fog":
            rate: Any = self.rate
            return TracedRows([rate @ self.input_vector])
        return TracedRows([self.vector_input().columns[i] for i in self.axes])


class Unknown(np.lib.mixins.NDArrayOperatorsMixin):
    """What firmware does not know: whatever computes with it has no C.

    Args:
        what: it is.
    """

    def __init__(self, what: str) -> None:
        self.what = what

    def __array_ufunc__(self, *_: Any, **__: Any) -> Any:
        """Refused."""
        raise _no_code(self.what)

    def __array_function__(self, *_: Any, **__: Any) -> Any:
        """Refused."""
        raise _no_code(self.what)

    def __getitem__(self, _: Any) -> Any:
        """Refused."""
        raise _no_code(self.what)

    def __len__(self) -> int:
        """Refused."""
        raise _no_code(self.what)


def traced_sense(
    like: Sense, inputs: Any, force: Any, temperature: Traced | None, memory: Traced | None
) -> TracedSense:
    """A sense whose input, force and temperature are traced.

    Args:
        like: of one row, for what is not traced.
        inputs: force or rate, as TracedRows.
        force: with a gyro, as TracedRows; None: none.
        temperature: minus T0; None: at T0.
        memory: of the temperature; None: none.
    """
    known: dict[str, Any] = dict(vars(like))
    own = "force" if like.kind in ("accelerometer", "inclinometer") else "rate"
    known[own] = inputs
    if force is not None:
        known["force"] = force
    zero: Array = np.zeros(1)
    known["temperature"] = zero if temperature is None else temperature
    known["temperature_memory"] = zero if memory is None else memory
    known["time"] = known["elapsed"] = Unknown("the time")
    return TracedSense(**known)


def _no_code(what: str) -> TiltcalError:
    return TiltcalError(
        "firmware",
        found=f"a term with {what}, for which there is no C",
        need="terms of the reading and the temperature",
        do="correct it on a computer",
    )
