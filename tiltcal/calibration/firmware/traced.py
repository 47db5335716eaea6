"""Terms as a computation: an effect is evaluated on traced numbers, which write it down."""

from collections.abc import Callable
from math import prod
from typing import Any, NamedTuple

import numpy as np

from tiltcal.core.arrays import Array
from tiltcal.core.errors import TiltcalError
from tiltcal.effects.sense import Sense

ARITHMETIC = {"add", "subtract", "multiply", "divide", "negative", "absolute"}
OPERATIONS = ARITHMETIC | {"hypot", "arctan2", "sin", "cos", "tanh", "sqrt", "sign"}
"""What is traced, as numpy names it; in addition ``upright``, sqrt(g^2 - a^2 - ...) or 0, and
``share``, a / (a + c) of an ``a`` that is not negative and a constant c."""


class Node(NamedTuple):
    """One number of a computation.

    Args:
        operation: one of ``OPERATIONS``, ``upright``, ``share``, ``input`` or ``constant``.
        arguments: nodes that it is computed from.
        value: of a constant; of ``upright``: g, m/s2.
        name: of an input.
    """

    operation: str
    arguments: tuple[int, ...] = ()
    value: float = 0.0
    name: str = ""


class Program:
    """Nodes in the order of the computation; what is computed twice is one node."""

    def __init__(self) -> None:
        self.nodes: list[Node] = []
        self._known: dict[Node, int] = {}

    def input(self, name: str) -> "Traced":
        """What is given, such as ``x[0]``."""
        return self._traced(Node("input", name=name))

    def constant(self, value: float) -> "Traced":
        """A constant."""
        return self._traced(Node("constant", value=float(value)))

    def upright(self, across: "list[Traced]", gravity: float) -> "Traced":
        """The component that points up beside those across it, where the norm is g.

        Args:
            across: the others, m/s2.
            gravity: m/s2.
        """
        return self._traced(Node("upright", tuple(a.index for a in across), gravity))

    def number(self, operation: str, *arguments: "Traced") -> "Traced":
        """A number computed from others; what needs no computation is simplified."""
        known = self._simplified(operation, *arguments)
        return known or self._traced(Node(operation, tuple(a.index for a in arguments)))

    def _simplified(self, operation: str, *arguments: "Traced") -> "Traced | None":
        nodes = [a.node for a in arguments]
        values = [n.value if n.operation == "constant" else None for n in nodes]
        if None not in values:
            return self.constant(float(getattr(np, operation)(*values)))
        neutral = {"multiply": 1.0, "divide": 1.0}.get(operation, 0.0)
        if operation in ("add", "subtract", "multiply", "divide") and values[1] == neutral:
            return arguments[0]
        if operation in ("add", "multiply") and values[0] == neutral:
            return arguments[1]
        same = operation == "subtract" and arguments[0].index == arguments[1].index
        if same or (operation == "multiply" and 0.0 in values):
            return self.constant(0.0)
        if operation == "hypot" and values[1] == 0:
            return self.number("absolute", arguments[0])
        if operation == "divide" and nodes[1].operation == "add":
            a, c = nodes[1].arguments
            if a == arguments[0].index and self.nodes[c].operation == "constant":
                return self._traced(Node("share", (a, c)))
        return None

    def _traced(self, node: Node) -> "Traced":
        if node not in self._known:
            self._known[node] = len(self.nodes)
            self.nodes.append(node)
        return Traced(self, self._known[node])

    def needed(self, results: list[int], opaque: str = "") -> list[int]:
        """The nodes that some results need, in the order of the computation.

        Args:
            results: nodes.
            opaque: operation that needs nothing.
        """
        used, open_ = set[int](), list(results)
        while open_:
            index = open_.pop()
            if index not in used:
                used.add(index)
                node = self.nodes[index]
                open_ += node.arguments if node.operation != opaque else ()
        return sorted(used)


class Traced(np.lib.mixins.NDArrayOperatorsMixin):
    """One row of a column: a number of a computation.

    Args:
        program: that it is part of.
        index: of its node.
    """

    def __init__(self, program: Program, index: int) -> None:
        self.program, self.index = program, index

    @property
    def node(self) -> Node:
        """What it is computed from."""
        return self.program.nodes[self.index]

    def __array_ufunc__(self, ufunc: Any, method: str, *inputs: Any, **options: Any) -> "Traced":
        """What numpy calls for an operation on it."""
        if method != "__call__" or options.get("out") is not None:
            raise _no_code(f"{ufunc.__name__}.{method}")
        if ufunc is np.square:
            ufunc, inputs = np.power, (inputs[0], 2)
        if ufunc is np.power:
            return self._power(*inputs)
        if ufunc.__name__ not in OPERATIONS:
            raise _no_code(ufunc.__name__)
        return self.program.number(ufunc.__name__, *map(self._traced, inputs))

    def __array_function__(
        self, function: Callable[..., Any], types: Any, inputs: Any, options: Any
    ) -> "Traced":
        """What numpy calls for ``ones_like`` and ``zeros_like``."""
        filled = {"ones_like": 1.0, "zeros_like": 0.0}.get(function.__name__)
        if filled is None:
            raise _no_code(function.__name__)
        return self.program.constant(filled)

    def _power(self, base: Any, exponent: Any) -> "Traced":
        """A power by repeated multiplication: the exponent is a whole number."""
        count = int(exponent)
        if count != exponent or count < 0 or not isinstance(base, Traced):
            raise _no_code(f"power {exponent}")
        return prod([base] * count, start=self.program.constant(1.0))

    def _traced(self, value: Any) -> "Traced":
        if isinstance(value, Traced):
            return value
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
        parts = [c * float(v) for c, v in zip(self.columns, vector, strict=True)]
        return sum(parts[1:], parts[0])

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

    def _refuse(self, *_: Any, **__: Any) -> Any:
        raise _no_code(self.what)

    __array_ufunc__ = __array_function__ = __getitem__ = __len__ = _refuse


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
