"""``tiltcal methods``."""

import inspect
from importlib.metadata import entry_points

from tiltcal.calibration.methods.registry import GROUP, METHODS
from tiltcal.cli.options import Json
from tiltcal.cli.output import paragraph, print_json, print_table


def methods(*, as_json: Json = False) -> int:
    """List the calibration methods."""
    rows = [
        (name, (inspect.getdoc(method) or "").splitlines()[0], _options(method))
        for name, method in METHODS.items()
    ]
    rows += [(e.name, f"installed: {e.value}", "") for e in entry_points(group=GROUP)]
    if as_json:
        print_json([{"method": n, "does": d, "options": o} for n, d, o in rows])
        return 0
    print_table(["method", "does", "options"], rows)
    paragraph(
        "Your own method: --method package.module:function. It is called with (Recording, Setup)"
        " and returns a Calibration."
    )
    return 0


def _options(method: object) -> str:
    parameters = inspect.signature(method).parameters.values()  # type: ignore[arg-type]
    return ", ".join(
        p.name for p in parameters if p.kind is p.KEYWORD_ONLY and p.name != "segments"
    )
