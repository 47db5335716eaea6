"""Planning: the poses with the most information for a table time, or for a goal."""

from nicegui import ui

from tiltcal.app.bench import Bench
from tiltcal.app.parts import command_line, page_of, table
from tiltcal.core.units import unit_sign

FOLDER = "plan"
FIELDS = {
    "budget-s": ("Table time, s", "300"),
    "rate-deg-s": ("Rate of moves, deg/s", "20"),
    "settle-s": ("Settling, s", "5"),
    "range-deg": ("Working range about level, deg", "180"),
    "goal": ("Goals, such as accel.bias=30ug U=0.01deg", ""),
    "angles": ("Limits, such as outer=-45:45", ""),
}


def plan_page(bench: Bench) -> None:
    """Options of the design and its result."""
    chosen = bench.workspace.chosen
    if not chosen.scenario:
        ui.label("Choose a scenario on the page Open.")
        return
    boxes = {}
    with ui.element("div").classes("form w-full"):
        for key, (title, usual) in FIELDS.items():
            boxes[key] = ui.input(title, value=chosen.plan.get(key, usual)).props("dense")

    def go() -> None:
        given = {key: box.value.strip() for key, box in boxes.items()}
        bench.workspace.choose(plan=given)
        bench.start(*_words(bench))

    ui.button("Design", on_click=go).props("no-caps")
    command_line(*_words(bench))
    if (result := bench.workspace.result(f"{FOLDER}/design.json")) is None:
        return
    ui.separator()
    ui.label(
        f"{len(result['poses'])} poses in {result['total_s']:.0f} s; tilt error"
        f" {result['tilt_rms_arcsec']:.3g} arcsec rms per axis; at least"
        f" {100 * result.get('efficiency', 0.0):.1f} % of the best possible"
    ).mark("plan")
    goals = [
        [g["name"], f"{g['limit']:.4g}", f"{g['expected']:.4g}", unit_sign(g["unit"])]
        for g in result.get("goals", [])
    ]
    if goals:
        table(["goal", "limit", "expected", "unit"], goals, numbers=2)
    rows = [
        [p["name"], f"{p['prior']:.4g}", f"{p['sigma']:.4g}", unit_sign(p["unit"])]
        for p in result["parameters"]
    ]
    table(["parameter", "before", "expected", "unit"], rows, numbers=2)
    with ui.row():
        for name in ("steps.csv", "steps.txt", "design.toml", "segments.csv"):
            ui.link(name, f"/file/{FOLDER}/{name}", new_tab=True)
    page_of(f"{FOLDER}/report.html", "plan")


def _words(bench: Bench) -> tuple[str, ...]:
    chosen = bench.workspace.chosen
    given = {key: chosen.plan.get(key, usual) for key, (_, usual) in FIELDS.items()}
    options = [w for key, text in given.items() if text for w in (f"--{key}", *text.split())]
    return ("design", chosen.scenario, *options, "-o", FOLDER)
