"""A traced computation as C in floating point."""

from tiltcal.calibration.firmware.traced import Node, Program

FORMS = {
    "add": "({} + {})",
    "subtract": "({} - {})",
    "multiply": "({} * {})",
    "divide": "({} / {})",
    "hypot": "{F}(hypot)({}, {})",
    "arctan2": "{F}(atan2)({}, {})",
    "negative": "(-{})",
    "absolute": "{F}(fabs)({})",
    "tanh": "{F}(tanh)({})",
    "sin": "{F}(sin)({})",
    "cos": "{F}(cos)({})",
    "sqrt": "{F}(sqrt)({})",
    "sign": "({0} > 0 ? 1 : {0} < 0 ? -1 : ({R})0)",
    "share": "({0} / ({0} + {1}))",
}
"""C of each operation; ``{F}`` wraps the name of a function, ``{R}`` is the type of numbers."""


def float_code(program: Program, results: list[int], name: str) -> tuple[list[str], list[str]]:
    """Statements, and the expressions of the results.

    Args:
        program: the computation.
        results: nodes.
        name: what every C name begins with.
    """
    real, function = f"{name}_real", f"{name.upper()}_FN"
    names: dict[int, str] = {}
    statements = []
    for index in program.needed(results):
        node = program.nodes[index]
        if node.operation == "input":
            names[index] = node.name
        elif node.operation == "constant":
            names[index] = f"({real}){node.value!r}"
        else:
            given = [names[a] for a in node.arguments]
            names[index] = f"t{index}"
            statements.append(f"const {real} t{index} = {_form(node, given, real, function)};")
    return statements, [names[r] for r in results]


def _form(node: Node, given: list[str], real: str, function: str) -> str:
    if node.operation != "upright":
        return FORMS[node.operation].format(*given, F=function, R=real)
    g = f"({real}){node.value!r}"
    rest = " - ".join([f"{g} * {g}", *(f"{a} * {a}" for a in given)])
    return f"{rest} > 0 ? {function}(sqrt)({rest}) : 0"
