"""*Guide*: a calibration while it is recorded: what the sensor reads, the next pose, sigmas that
fall towards their goals, and what is to be mended.
"""

from collections.abc import Callable, Sequence
from functools import cache

from nicegui import ui

from tiltcal.app.elements import (
    CommandLine,
    Figure,
    Table,
    choice,
    entry,
    follow,
    heading,
    number,
    problem,
    text,
    tick,
    watch,
)
from tiltcal.app.jobs import as_command
from tiltcal.app.live import Live, Task, words_of
from tiltcal.app.session import FILES, Session
from tiltcal.app.shell import SCENARIO, report_frame
from tiltcal.core.errors import TiltcalError
from tiltcal.core.units import split_unit, unit_sign
from tiltcal.guide.state import GuideState
from tiltcal.report.plots import LOGARITHMIC, Plot, Trace, axes, colour, line
from tiltcal.report.stated import Stated

SOURCE, METHOD, GOALS, HOLD, SPEED, COLUMNS, RATE, FOLDER, CERTIFY, ANGLES = (
    f"guide.{name}"
    for name in (
        "source",
        "method",
        "goals",
        "hold_s",
        "speed",
        "columns",
        "rate_hz",
        "folder",
        "certificate",
        "angles",
    )
)
INPUTS = (SOURCE, METHOD, GOALS, HOLD, SPEED, COLUMNS, RATE, FOLDER, CERTIFY, SCENARIO, FILES)
TICK_S = 0.25  # between two looks at the state: four a second are read well
METHODS = ("norm", "six_position")
SPHERE_PX = 380
SEEN = 2  # decimals of a direction: half a degree is seen on a sphere of 200 px, noise is not drawn
NO_AXES = {"showticklabels": False, "title": {"text": ""}, "showspikes": False, "visible": False}


@cache
def live_of(session: Session) -> Live:
    """The guide of a workspace: one for all tabs."""
    return Live(session)


def build(session: Session) -> None:
    """The page."""
    live = live_of(session)
    heading("Source and goals")
    _inputs(session)
    _start(session, live)
    heading("Now")
    _Display(session, live)
    heading("Files")
    follow(session, (FILES,), lambda: _files(live))


def _inputs(session: Session) -> None:
    session.values.setdefault(METHOD, "norm")
    with ui.element("div").classes("fields"):
        hint = "/dev/ttyUSB0, tcp://HOST:PORT, serve://HOST:PORT or a recording"
        entry(session, SOURCE, "Source", hint=hint)
        choice(session, METHOD, "Method", METHODS, clearable=False)
        entry(session, GOALS, "Goals: the largest σ of each kind", hint="bias=50ug scale=40ppm")
        entry(session, FOLDER, "Folder of the results", "guided")
    with ui.element("div").classes("fields"):
        number(session, HOLD, "Length of a dwell, s", 5.0, least=1, most=3600)
        number(session, SPEED, "Replay speed of a file", 1.0, least=0)
        number(session, RATE, "Lines a second", 0.0, least=0)
        entry(
            session,
            COLUMNS,
            "Columns, where no header is sent",
            hint="time_s,accel_x_m_s2,accel_y_m_s2,...",
        )
        tick(session, CERTIFY, "certificate")


def task_of(session: Session) -> Task | None:
    """What is to be guided; None where something is missing."""
    source, scenario = session.text(SOURCE).strip(), session.chosen(SCENARIO)
    if not (source and scenario):
        return None
    return Task(
        source,
        scenario,
        session.text(METHOD) or "norm",
        tuple(session.text(GOALS).split()),
        session.number(HOLD, 5.0),
        session.number(SPEED, 1.0),
        tuple(cell.strip() for cell in session.text(COLUMNS).split(",") if cell.strip()),
        session.number(RATE, 0.0) or None,
        session.text(FOLDER) or "guided",
        Stated() if session.flag(CERTIFY) else None,
    )


def _start(session: Session, live: Live) -> None:
    def start() -> None:
        task = task_of(session)
        if task is not None:
            _trying(lambda: live.start(task))

    with ui.element("div").classes("action"):
        button = ui.button("Start", color=None, on_click=start).props("no-caps unelevated dense")
        button.classes("primary")
        hint = ui.label(
            "Choose a scenario at the top (the page Open makes one) and name a source."
        ).classes("soft")
        command = CommandLine("")

    def update() -> None:
        task = task_of(session)
        button.set_enabled(task is not None)
        hint.set_visibility(task is None)
        command.set_visibility(task is not None)
        command.show(as_command(words_of(task)) if task is not None else "")

    watch(session, INPUTS, update, button)


def _trying(act: Callable[[], None]) -> None:
    """Do something; what is wrong with it is said."""
    try:
        act()
    except TiltcalError as error:
        ui.notify(str(error), type="negative", multi_line=True)


class _Display:
    """What the guide says, looked at a few times a second; only what has changed is sent.

    Args:
        session: of the workspace.
        live: the guide.
    """

    def __init__(self, session: Session, live: Live) -> None:
        self._session, self._live = session, live
        self._seen: object = None
        self._drawn: Sequence[Trace] = ()
        self._ran = live.running
        self._wrong = ui.element("div")
        self._instruction = ui.label("").classes("para lead verdict").props('role="status"')
        self._held = ui.linear_progress(0.0, show_value=False).props('aria-label="Standstill"')
        with ui.element("div").classes("action"):
            _button("Reject the last dwell", lambda: _trying(live.reject))
            _button("Stop and write", live.stop)
            entry(session, ANGLES, "Angles of the head, °", hint="outer=90 inner=0")
            _button("Set the angles", lambda: _trying(lambda: live.type_angles(self._angles())))
        with ui.element("div").classes("columns"):
            self._left = ui.element("div")
            self._sphere = Figure(sphere_of(live.state))
        self._tables = ui.element("div").classes("columns")
        self._update()
        ui.timer(TICK_S, self._update)

    def _angles(self) -> dict[str, float]:
        """The angles that were typed.

        Raises:
            TiltcalError: one does not read.
        """
        found: dict[str, float] = {}
        for word in self._session.text(ANGLES).split():
            axis, _, angle = word.partition("=")
            try:
                found[axis] = float(angle)
            except ValueError as error:
                raise TiltcalError(
                    f"angle {word}", found="no AXIS=ANGLE", need="such as outer=90", do="correct it"
                ) from error
        return found

    def _update(self) -> None:
        live, state = self._live, self._live.state
        if self._ran and not live.running:
            self._session.listed()
        self._ran = live.running
        self._wrong.clear()
        with self._wrong:
            if live.error:
                problem(live.error)
            for notice in state.notices if state else ():
                problem(notice.statement)
        if state is None:
            self._instruction.set_text("Nothing is read yet.")
            return
        self._instruction.set_text(state.instruction if live.running else _ended(state))
        self._held.set_value(min(state.held_s / state.hold_s, 1.0) if state.standing else 0.0)
        self._left.clear()
        with self._left:
            _reading(state)
        places = _places(state)
        if places != self._drawn:
            self._drawn = places
            self._sphere.run_method("show", places)
        seen = (len(state.dwells), live.running, [p.sigma for p in state.parameters.values()])
        if seen != self._seen:
            self._seen = seen
            self._tables.clear()
            with self._tables:
                _sigmas(state, live.sigmas)


def _button(label: str, click: Callable[[], None]) -> None:
    ui.button(label, color=None, on_click=click).props("no-caps dense flat").classes("plain")


def _ended(state: GuideState) -> str:
    reached = "every goal is reached" if state.reached else "not every goal is reached"
    return f"Ended with {len(state.dwells)} dwells: {reached}; verdict {state.verdict or 'none'}."


def _reading(state: GuideState) -> None:
    rows = []
    for name, value in state.reading.items():
        stem, unit = split_unit(name)
        rows.append([stem, f"{value:.5f}", unit_sign(unit or "")])
    Table((("reads now", "short"), ("", "n"), ("", "unit")), rows)
    still = f"still for {state.held_s:.1f} s of {state.hold_s:g} s"
    rate = f"; {state.rate_hz:.1f} Hz" if state.rate_hz else ""
    text(f"{still if state.standing else 'moving'}; {state.rows} rows{rate}", "soft")
    expected = f" of about {state.expected_dwells}" if state.expected_dwells else ""
    text(f"{sum(d.used for d in state.dwells)} dwells{expected}", "strong")
    if state.next is not None and state.next.off_deg is not None:
        text(f"Next pose: {state.next.off_deg:.0f}° away", "strong")


def _sigmas(state: GuideState, history: Sequence[dict[str, float]]) -> None:
    Table(
        (("parameter", "short"), ("σ", "n"), ("goal", "n"), ("", "unit"), ("reached", "mark")),
        [
            [
                n,
                f"{p.sigma:.3g}",
                f"{p.goal:.3g}",
                unit_sign(p.unit),
                "yes" if p.reached else "not yet",
            ]
            for n, p in state.parameters.items()
        ],
        empty="No sigma is known yet.",
    )
    with ui.element("div"):
        if len(history) > 1:
            Figure(sigma_plot(history))
        Table(
            (("dwell", "n"), ("from, s", "n"), ("to, s", "n"), ("pose", "short"), ("", "long")),
            [
                [str(k), f"{d.start_s:.1f}", f"{d.end_s:.1f}", d.label, d.reason]
                for k, d in enumerate(state.dwells, start=1)
            ],
            empty="No dwell is taken yet.",
        )


def sigma_plot(history: Sequence[dict[str, float]]) -> Plot:
    """The sigma of each parameter over its goal, dwell by dwell."""
    names = list(history[-1])
    x = list(range(1, len(history) + 1))
    traces = [line(x, [h.get(n, float("nan")) for h in history], n, k) for k, n in enumerate(names)]
    layout = axes("dwell", "σ over its goal", showlegend=False)
    layout["yaxis"] |= LOGARITHMIC
    return Plot(
        traces,
        "Sigma of each parameter over its goal; at 1 it is reached.",
        "Sigma of each parameter over its goal as dwells are added",
        layout,
        height=220,
    )


def _places(state: GuideState | None) -> list[Trace]:
    """Dwells, the present direction, and the way to the next."""
    dwells = [d.up for d in state.dwells if d.up and d.used] if state else []
    now = [tuple(round(v, SEEN) for v in state.up)] if state and state.up else []
    there = [state.next.up] if state and state.next else []
    ways = ([*now, *there], dwells, now, there)
    return [{axis: [p[k] for p in way] for k, axis in enumerate("xyz")} for way in ways]


def sphere_of(state: GuideState | None) -> Plot:
    """Up in the body frame: the dwells, now, and the way to the next pose."""
    common = {"type": "scatter3d", "hovertemplate": "%{fullData.name}<extra></extra>"}
    names = ("way", "dwells", "now", "next")
    looks: Sequence[Trace] = (
        {"mode": "lines", "line": {"color": colour(1), "width": 6}},
        {"mode": "markers", "marker": {"size": 5, "color": colour(2)}},
        {"mode": "markers", "marker": {"size": 8, "color": colour(0)}},
        {"mode": "markers", "marker": {"size": 9, "color": colour(1), "symbol": "diamond"}},
    )
    parts = zip(names, looks, _places(state), strict=True)
    traces = [common | {"name": name} | look | place for name, look, place in parts]
    reach = {"range": [-1.25, 1.25], **NO_AXES}
    scene = {f"{axis}axis": reach for axis in "xyz"} | {"aspectmode": "cube"}
    return Plot(
        traces,
        "Up in the body frame: turn the sensor so that the present point moves along the line.",
        "Unit sphere with the dwells taken, the present direction of up and the next one",
        {"sphere": True, "scene": scene, "margin": dict.fromkeys("lrtb", 0), "showlegend": True},
        height=SPHERE_PX,
    )


def _files(live: Live) -> None:
    if not live.written:
        text("They are written when the guide ends: recording, dwells, calibration.", "soft")
        return
    with ui.element("div").classes("links"):
        for kind, name in live.written.items():
            ui.link(f"Download {kind.replace('_', ' ')}", f"/files/{name}?download=true")
    pages = [n for n in live.written.values() if n.endswith(".html")]
    for name in pages[:1]:
        report_frame(name, "Calibration certificate")
