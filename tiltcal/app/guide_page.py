"""The live guide: what the sensor reads, the next pose, and how far each uncertainty has come."""

from nicegui import run, ui

from tiltcal.api.scenario import load_scenario
from tiltcal.app.bench import Bench
from tiltcal.app.live import Live
from tiltcal.app.parts import command_line, drawn, figure, notes, table
from tiltcal.core.errors import TiltcalError
from tiltcal.core.units import unit_sign
from tiltcal.design.goals import parse_goals
from tiltcal.guide.state import GuideState
from tiltcal.guide.typed_angles import parse_angles
from tiltcal.report.plots import Plot, colour

FOLDER = "guided"
METHODS = ("norm", "six_position")
TICK_S = 0.3  # between two looks: a person sees no more
FIELDS = {
    "source": ("Source: serial port, tcp://, udp://, serve://HOST:PORT or a file", ""),
    "goal": ("Goals, such as accel.bias=60ug; empty: what a few poses bring", ""),
}


def guide_page(bench: Bench) -> None:
    """Source, state, result."""
    chosen = bench.workspace.chosen
    if not chosen.scenario:
        ui.label("Choose a scenario on the page Open.")
        return
    _start(bench)
    if bench.live is None:
        return
    place = ui.column().classes("w-full gap-2")
    _actions(bench, bench.live)
    with ui.row().classes("w-full columns"):
        with ui.column().classes("col"):
            sphere = figure(sphere_of(bench.live.state))
        numbers = ui.column().classes("col")
    seen: list[object] = []

    def show() -> None:
        live = bench.live
        if live is None:
            return
        now = (live.state, live.ended)
        if seen != [now]:
            seen[:] = [now]
            for part, draw in ((place, _state), (numbers, _parameters)):
                part.clear()
                with part:
                    draw(live)
            sphere.update_figure(drawn(sphere_of(live.state)))

    show()
    ui.timer(TICK_S, show)


def _start(bench: Bench) -> None:
    given = bench.workspace.chosen.guide
    boxes = {}
    with ui.element("div").classes("form w-full"):
        for key, (title, usual) in FIELDS.items():
            boxes[key] = ui.input(title, value=given.get(key, usual)).props("dense")
        method = ui.select(list(METHODS), value=given.get("method", METHODS[0]), label="Method")
        method.props("dense")

    def begin() -> None:
        said = {key: box.value.strip() for key, box in boxes.items()} | {"method": method.value}
        bench.workspace.choose(guide=said)
        if bench.live is not None:
            bench.live.stop()
        try:
            scenario = load_scenario(bench.path(bench.workspace.chosen.scenario))
            source = said["source"]
            if (bench.workspace.folder / source).is_file():
                source = str(bench.path(source))
            goal = parse_goals(said["goal"].split())
            bench.live = Live(scenario, said["method"], source, goal)
        except TiltcalError as error:
            ui.notify(str(error), type="negative", multi_line=True)
            return
        bench.draw()

    ui.button("Start", on_click=begin).props("no-caps")
    goals = [word for goal in given.get("goal", "").split() for word in ("--goal", goal)]
    words = ("--scenario", bench.workspace.chosen.scenario, "--method", given.get("method", "norm"))
    command_line("guide", given.get("source", "SOURCE") or "SOURCE", *words, *goals, "-o", FOLDER)


def _state(live: Live) -> None:
    state = live.state
    ui.label(live.ended or state.instruction).classes("text-h5").mark("instruction")
    if state.standing and live.runs:
        share = min(state.held_s / state.hold_s, 1.0)
        ui.linear_progress(value=share, show_value=False).props("rounded size=10px")
        left = max(state.hold_s - state.held_s, 0.0)
        ui.label(f"hold still: {left:.1f} s" if left > 0 else "taken; go on").classes("text-sm")
    for notice in state.notices:
        ui.label(notice.statement).classes("text-warning")
    reads = ", ".join(f"{name} {value:.5g}" for name, value in state.reading.items())
    ui.label(f"reads: {reads or 'nothing yet'}").classes("text-sm font-mono")


def _actions(bench: Bench, live: Live) -> None:
    def reject() -> None:
        try:
            live.reject()
        except TiltcalError as error:
            ui.notify(str(error), type="negative")

    async def save() -> None:
        try:
            written = await run.io_bound(live.save, bench.workspace.folder / FOLDER)
        except TiltcalError as error:
            ui.notify(str(error), type="negative")
            return
        names = ", ".join(p.name for p in (written or {}).values())
        ui.notify(f"written to {FOLDER}: {names}")

    with ui.row():
        ui.button("Stop", on_click=live.stop).props("dense no-caps")
        ui.button("Leave the last dwell out", on_click=reject).props("flat dense no-caps")
        _head(live)
        ui.button("Save recording and calibration", on_click=save).props("dense no-caps")


def _head(live: Live) -> None:
    """Where the dividing head stands: as proposed, or as typed."""

    def state_it() -> None:
        try:
            live.set_angles(parse_angles(typed.value, live.guide.axes))
        except TiltcalError as error:
            ui.notify(str(error), type="negative")

    with ui.row().bind_visibility_from(live, "by_head"):
        typed = ui.input("angles of the head, deg").props("dense")
        ui.button("The head stands there", on_click=state_it).props("flat dense no-caps")


def _parameters(live: Live) -> None:
    state = live.state
    said = f"{len(state.dwells)} dwells"
    if state.expected_dwells is not None:
        said += f" of about {state.expected_dwells}"
    ui.label(said + (f"; {state.verdict.replace('_', ' ')}" if state.verdict else ""))
    rows = [
        [
            name,
            "" if p.value is None else f"{p.value:.5g}",
            f"{p.sigma:.3g}",
            f"{p.goal:.3g}",
            unit_sign(p.unit),
            "reached" if p.reached else "",
        ]
        for name, p in state.parameters.items()
    ]
    table(["parameter", "value", "standard uncertainty", "goal", "unit", ""], rows, numbers=3)
    notes([f"dwell {k}: {d.reason}" for k, d in enumerate(state.dwells, 1) if d.reason])


def sphere_of(state: GuideState) -> Plot:
    """Up in the body frame: dwells, now, and the next pose."""
    groups = [
        ("dwells", [d.up for d in state.dwells if d.up is not None and d.used], 5),
        ("now", [state.up] if state.up is not None else [], 8),
        ("next", [state.next.up] if state.next is not None else [], 8),
    ]
    traces = []
    for k, (name, ups, size) in enumerate(groups):
        x, y, z = zip(*ups, strict=True) if ups else ((), (), ())
        traces.append(
            {
                "type": "scatter3d",
                "mode": "markers",
                "name": name,
                "x": list(x),
                "y": list(y),
                "z": list(z),
                "marker": {"size": size, "color": colour(k)},
            }
        )
    hidden = {"visible": False, "range": [-1.25, 1.25]}
    scene = {"xaxis": hidden, "yaxis": hidden, "zaxis": hidden, "aspectmode": "cube"}
    layout = {"sphere": True, "scene": scene, "uirevision": "guide", "showlegend": True}
    text = f"Up in the body frame: {len(groups[0][1])} dwells, now, and the next pose."
    return Plot(traces, text, text, layout, height=380)
