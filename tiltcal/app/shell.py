"""The frame of every page: its title, the way to the other pages, what was chosen for all of them,
and the commands that run.
"""

from collections.abc import Callable
from functools import cache
from pathlib import Path, PurePosixPath
from urllib.parse import quote

from nicegui import background_tasks, ui

from tiltcal.app.elements import CommandLine, Table, choice, follow, problem, text, watch
from tiltcal.app.jobs import Job
from tiltcal.app.session import FILES, JOBS, Session
from tiltcal.report.page import TEMPLATES

PAGES = {
    "/": "Open",
    "/recording": "Recording",
    "/calibrate": "Calibrate",
    "/diagnose": "Diagnose",
    "/plan": "Plan",
    "/guide": "Guide",
}
RECORDING, SCENARIO, SEGMENTS = "recording", "scenario", "segments"
"""Keys of what is chosen for all pages."""
STATIC = Path(__file__).parent / "static"
SCRIPTS = "".join(
    f'<script async src="/_tiltcal/{name}"></script>' for name in ("plotly.js", "drawing.js")
)
"""What draws plots, asked for by the page itself: it is there before the first one is chosen."""
SHOWN_JOBS = 8
SECONDS_S = 2.0  # between two counts of the time that a command has taken


@cache
def style() -> str:
    """The style of the reports, and that of the application."""
    reports = (TEMPLATES / "style.css").read_text(encoding="utf-8")
    variables = reports[: reports.index("* {")]
    return variables + (STATIC / "app.css").read_text(encoding="utf-8")


def frame(session: Session, path: str, build: Callable[[], None]) -> None:
    """A page.

    Args:
        session: that it shows.
        path: of the page.
        build: its content.
    """
    ui.page_title(f"{PAGES[path]} · tiltcal")
    ui.add_css(style())
    ui.add_head_html(SCRIPTS)
    with ui.element("a").classes("skip").props('href="#main"'):
        ui.label("Skip to the content").classes("in")
    with ui.element("header"):
        ui.label("tiltcal").classes("brand")
        with ui.element("nav").props('aria-label="Pages"'):
            for target, title in PAGES.items():
                link = ui.link(title, target)
                if target == path:
                    link.props('aria-current="page"')
        ui.label(str(session.workspace.folder)).classes("where soft")
    with ui.element("div").classes("page").props('id="main"'):
        with ui.element("h1"):
            ui.label(PAGES[path]).classes("in")
        follow(
            session,
            (FILES,),
            lambda: _chosen(session),
            lambda: session.names(RECORDING, SCENARIO, SEGMENTS),
        )
        _jobs(session)
        build()
    ui.timer(SECONDS_S, lambda: _count(session))


def dwells_name(recording: str) -> str:
    """The list of dwells that belongs to a recording."""
    return str(PurePosixPath(recording).with_suffix(".segments.csv")) if recording else ""


def follow_recording(session: Session) -> None:
    """Dwells are those of the recording that is chosen, never of the one before."""
    session.listen(
        (RECORDING,), lambda: session.set(SEGMENTS, dwells_name(session.text(RECORDING)))
    )


def _count(session: Session) -> None:
    """The seconds of what runs go on, and files come from elsewhere."""
    session.look()
    if session.jobs.running:
        session.tell(JOBS)


def _chosen(session: Session) -> None:
    """What all pages work on."""
    with ui.element("div").classes("bar"):
        names = [e.name for e in session.files("recording")]
        choice(session, RECORDING, "Recording", names)
        choice(session, SCENARIO, "Scenario", [e.name for e in session.files("scenario")])
        choice(session, SEGMENTS, "Dwells", [e.name for e in session.files("segments")])


def _jobs(session: Session) -> None:
    """The commands that run, each with its latest line, and those that have ended."""
    box = ui.element("div")
    shown: dict[int, tuple[ui.label, ui.label]] = {}
    known: list[tuple[int, int | None]] = [(0, 0)]

    def update() -> None:
        """In place, unless a command has come or ended: what is clicked stays where it is."""
        now = [(id(job), job.status) for job in session.jobs.all]
        if now != known:
            known[:] = now
            shown.clear()
            box.clear()
            with box:
                shown.update({id(job): _running(session, job) for job in session.jobs.running})
                _ended(session)
        for job in session.jobs.running:
            title, line = shown[id(job)]
            title.set_text(f"{job.title}, {job.seconds:.0f} s")
            line.set_text(job.last)

    watch(session, (JOBS,), update, box)


def _running(session: Session, job: Job) -> tuple[ui.label, ui.label]:
    with ui.element("div").classes("job").props('role="status"'):
        title, line = ui.label().classes("strong"), ui.label().classes("grow")
        button = ui.button("Cancel", color=None).props("no-caps dense flat").classes("plain")
        button.on_click(lambda: _cancel(session, job))
    return title, line


def _ended(session: Session) -> None:
    done = [j for j in session.jobs.all if not j.running][:SHOWN_JOBS]
    if not done:
        return
    if done[0].failed and not done[0].cancelled and not session.jobs.running:
        problem("\n".join(list(done[0].lines)[-2:]))
    with ui.expansion(f"Commands so far: {len(done)}").props("dense").classes("log"):
        rows = [[state(j), j.title, f"{j.seconds:.1f}", j.last if j.lines else ""] for j in done]
        Table([("", "mark"), ("what", ""), ("s", "n"), ("said", "long")], rows)
        for job in done:
            CommandLine(job.command, job.title)


def state(job: Job) -> str:
    """How a command ended, in a word."""
    if job.running:
        return "running"
    if job.cancelled:
        return "cancelled"
    return {0: "done", 1: "not accepted"}.get(job.status or 0, "failed")


def _cancel(session: Session, job: Job) -> None:
    background_tasks.create(session.jobs.cancel(job), name="cancel")


def report_frame(name: str, title: str) -> None:
    """A report of the workspace, in a frame without rights, and links to it."""
    address = f"/files/{quote(name)}"
    with ui.element("div").classes("links"):
        ui.link("Open in a tab of its own", address, new_tab=True)
        ui.link("Download", f"{address}?download=true")
    frame = ui.element("iframe").classes("report")
    frame.props["src"], frame.props["title"] = address, title


def need(what: str) -> None:
    """What has to be chosen first."""
    text(what, "soft")
