"""The elements that pages are made of, over those of NiceGUI: sections that follow the session,
tables and plots of text, controls that keep what is entered, and actions with their command.
"""

import asyncio
import json
from collections.abc import Callable, Hashable, Sequence
from pathlib import Path
from typing import Any, Generic, TypeVar

from nicegui import background_tasks, ui
from nicegui.element import Element
from nicegui.elements.mixins.value_element import ValueElement

from tiltcal.app.jobs import Job, as_command
from tiltcal.app.session import JOBS, Session
from tiltcal.core.errors import TiltcalError
from tiltcal.core.safe_text import plain
from tiltcal.report.plots import Plot

Loaded = TypeVar("Loaded")
Column = tuple[str, str]
"""Label and kind of a column: "" for text, n for numbers, unit, mark or long for sentences."""


class Table(Element, component="static/table.js"):
    """A table of text.

    Args:
        columns: label and kind of each.
        rows: cells of each.
        caption: above it.
        empty: what is said where there are no rows.
        pick: called with the index of a row that is chosen.
        picked: indices of the chosen rows; -1: none.
    """

    def __init__(
        self,
        columns: Sequence[Column],
        rows: Sequence[Sequence[str]],
        *,
        caption: str = "",
        empty: str = "",
        pick: Callable[[int], None] | None = None,
        picked: int | Sequence[int] = -1,
    ) -> None:
        super().__init__()
        self._props["columns"] = [{"label": label, "kind": kind} for label, kind in columns]
        self._props["caption"], self._props["empty"] = caption, empty
        self._props["pickable"] = pick is not None
        self.show(rows, picked)
        if pick is not None:
            self.on("pick", lambda event: self._picked(str(event.args), pick))

    def _picked(self, first: str, pick: Callable[[int], None]) -> None:
        """A row by its first cell: others may have come above it meanwhile."""
        cells = [row[0] for row in self._props["rows"]]
        if first in cells:
            pick(cells.index(first))

    def show(self, rows: Sequence[Sequence[str]], picked: int | Sequence[int] = -1) -> None:
        """Other rows, in place: what is clicked meanwhile is not lost."""
        self._props["rows"] = [[plain(cell) for cell in row] for row in rows]
        self._props["picked"] = [picked] if isinstance(picked, int) else list(picked)
        self.update()


class Figure(Element, component="static/figure.js"):
    """A plot of a report.

    Args:
        plot: data and layout.
        ranged: called with the visible range, s, and None for all of it; returns the lines for it.
        picked: called with the index of a point that is clicked.
        moved: called with the index of a band that was dragged, and its ends.
    """

    def __init__(
        self,
        plot: Plot,
        *,
        ranged: "Callable[[tuple[float, float] | None], Sequence[dict[str, Any]]] | None" = None,
        picked: Callable[[int], None] | None = None,
        moved: Callable[[int, float, float], None] | None = None,
    ) -> None:
        super().__init__()
        shown = json.loads(plot.to_json())
        about = {"height": plot.height, "caption": plot.caption, "alternative": plot.alternative}
        self._props["plot"], self._props["ranged"] = shown | about, ranged is not None
        self._count = 0
        if ranged is not None:
            self.on("range", lambda event: self._show(event.args, ranged))
        if picked is not None:
            self.on("point", lambda event: picked(int(event.args["index"])))
        if moved is not None:
            self.on("band", lambda event: moved(int(event.args[0]), *map(float, event.args[1:])))

    async def _show(self, given: Any, lines: Callable[..., Sequence[dict[str, Any]]]) -> None:
        """Send the points of the range that is visible now; an older answer is not sent."""
        self._count += 1
        mine = self._count
        within = None if not given else (float(given[0]), float(given[1]))
        found = await asyncio.to_thread(lines, within)
        if mine == self._count and not self.is_deleted:
            text = Plot(found, "", "").to_json()
            data = [{"x": t["x"], "y": t["y"]} for t in json.loads(text)["data"]]
            self.run_method("show", data)


class Upload(Element, component="static/upload.js"):
    """Files dropped or chosen.

    Args:
        label: of the input.
        most: bytes of a file.
        done: called with the name of each file that has come.
    """

    def __init__(self, label: str, most: int, done: Callable[[str], None]) -> None:
        super().__init__()
        self._props["label"], self._props["most"] = label, most
        self.on("uploaded", lambda event: done(str(event.args)))


class CommandLine(Element, component="static/command.js"):
    """A command, or Python, that does the same.

    Args:
        text: to be copied.
        lead: before it.
    """

    def __init__(self, text: str, lead: str = "as command") -> None:
        super().__init__()
        self._props["text"], self._props["lead"] = plain(text), lead

    def show(self, text: str) -> None:
        """Another command."""
        if self._props["text"] != plain(text):
            self._props["text"] = plain(text)
            self.update()


class Section(Generic[Loaded]):
    """A part of a page that is built again when something it shows has changed. What it shows is
    read in a thread: a page never waits for a file.

    Args:
        session: that it follows.
        topics: keys of values, ``files`` or ``jobs``.
        load: reads what is shown.
        build: shows it.
        same: as long as it returns the same, nothing is built again: a page does not jump.
    """

    def __init__(
        self,
        session: Session,
        topics: Sequence[str],
        load: Callable[[], Loaded],
        build: Callable[[Loaded], None],
        same: Callable[[], Hashable] | None = None,
    ) -> None:
        self._load, self._build = load, build
        self._same = same
        self._seen: Hashable = object()
        self._wanted = self._running = False
        self.box = ui.element("div").classes("section")
        end = session.listen(tuple(topics), self.refresh)
        ui.context.client.on_delete(end)
        self.refresh()

    def refresh(self) -> None:
        """Build it again, once for all changes that came meanwhile."""
        if self._same is not None:
            now = self._same()
            if now == self._seen:
                return
            self._seen = now
        self._wanted = True
        if not self._running:
            self._running = True
            background_tasks.create(self._run(), name="section")

    async def _run(self) -> None:
        while self._wanted and not self.box.is_deleted:
            self._wanted = False
            try:
                found = await asyncio.to_thread(read_for_page, self._load)
            except TiltcalError as error:
                self._show(lambda error=error: problem(str(error)))  # type: ignore[misc]
                continue
            self._show(lambda found=found: self._build(found))  # type: ignore[misc]
        self._running = False

    def _show(self, build: Callable[[], None]) -> None:
        if self.box.is_deleted:
            return
        self.box.clear()
        with self.box:
            build()


def read_for_page(load: Callable[[], Loaded]) -> Loaded:
    """What a part of a page reads from files that others may write, move or delete meanwhile.

    Raises:
        TiltcalError: a file is wrong, or went away between being found and being read.
    """
    try:
        return load()
    except OSError as error:
        raise TiltcalError(
            Path(error.filename).name if error.filename else "workspace",
            found=error.strerror or str(error),
            need="files that stay while they are read",
            do="choose it again",
        ) from error


def follow(
    session: Session,
    topics: Sequence[str],
    build: Callable[[], None],
    same: Callable[[], Hashable] | None = None,
) -> None:
    """A part that needs nothing read: built at once, and again at each change, unless ``same``
    returns what it did.
    """
    box = ui.element("div").classes("section")
    seen: list[Hashable] = [object()]

    def again() -> None:
        if same is not None and seen[0] == same():
            return
        seen[0] = same() if same is not None else None
        box.clear()
        with box:
            build()

    watch(session, topics, again, box)


def problem(text: str) -> None:
    """A message of what is wrong."""
    ui.label(plain(text)).classes("problem").props('role="alert"')


def text(content: str, style: str = "") -> None:
    """A paragraph of text."""
    ui.label(plain(content)).classes(f"para {style}")


def heading(content: str, level: int = 2) -> None:
    """A heading."""
    with ui.element(f"h{level}"):
        ui.label(content).classes("in")


def _kept(session: Session, key: str, control: ValueElement[Any]) -> None:
    """A control whose value is that of the session, in every tab."""
    control.on_value_change(lambda event: session.set(key, event.value))

    def follow_session() -> None:
        if not control.is_deleted and control.value != session.values.get(key):
            control.set_value(session.values.get(key))

    end = session.listen((key,), follow_session)
    ui.context.client.on_delete(end)


def entry(session: Session, key: str, label: str, default: str = "", hint: str = "") -> ui.input:
    """A text that is kept."""
    session.values.setdefault(key, default)
    made = ui.input(label, value=session.text(key), placeholder=hint)
    made.props(f"dense outlined{' stack-label' if hint else ''}")
    _kept(session, key, made)
    return made.classes("field")


def number(
    session: Session,
    key: str,
    label: str,
    default: float,
    *,
    least: float | None = None,
    most: float | None = None,
) -> ui.number:
    """A number that is kept."""
    session.values.setdefault(key, default)
    value = session.number(key, default)
    made = ui.number(label, value=value, min=least, max=most).props("dense outlined")
    _kept(session, key, made)
    return made.classes("field short")


def choice(
    session: Session,
    key: str,
    label: str,
    options: Sequence[str],
    *,
    several: bool = False,
    clearable: bool = True,
) -> ui.select:
    """One of some texts, or several of them, that is kept; what is no option any more is left out
    of the control, not of the session.
    """
    known = {name: name for name in options}
    current: Any = (
        [x for x in session.texts(key) if x in known]
        if several
        else (session.text(key) if session.text(key) in known else None)
    )
    made = ui.select(known, label=label, value=current, multiple=several)
    chips = " use-chips" if several else " clearable" if clearable else ""
    made.props(f"dense outlined options-dense{chips}")
    made.on_value_change(lambda event: session.set(key, event.value or ([] if several else "")))

    def follow_session() -> None:
        value = session.values.get(key)
        if not made.is_deleted and (made.value or "") != (value or ""):
            there = value in known if isinstance(value, str) else value
            made.set_value(value if there else None)

    end = session.listen((key,), follow_session)
    ui.context.client.on_delete(end)
    return made.classes("field")


def tick(session: Session, key: str, label: str, default: bool = False) -> ui.checkbox:
    """A flag that is kept."""
    session.values.setdefault(key, default)
    made = ui.checkbox(label, value=session.flag(key)).props("dense")
    _kept(session, key, made)
    return made


Then = Callable[[Job], None]


def action(
    session: Session,
    label: str,
    topics: Sequence[str],
    words: Callable[[], list[str] | None],
    then: Then | None = None,
    *,
    missing: str = "",
) -> None:
    """A button that runs a command, with the command below it.

    Args:
        session: that the command runs in.
        label: of the button, and title of the job.
        topics: that the command depends on.
        words: of the command; None: something is missing.
        then: called when it has ended, whoever still looks.
        missing: what is missing, as text.
    """

    async def run() -> None:
        given = words()
        if given is not None and not _busy(session, given):
            job = await session.run(label, given)
            if then is not None and not job.failed:
                then(job)

    with ui.element("div").classes("action"):
        button = ui.button(label, color=None).props("no-caps unelevated dense").classes("primary")
        button.on_click(lambda: background_tasks.create(run(), name=label))
        hint = ui.label(missing).classes("soft")
        command = CommandLine("")
    wrong = ui.label("").classes("problem").props('role="alert"')

    def update() -> None:
        """In place: what is clicked stays where it is."""
        given = words()
        button.set_enabled(given is not None and not _busy(session, given))
        hint.set_visibility(given is None)
        command.set_visibility(given is not None)
        command.show(as_command(given or ()))
        mine = [j for j in session.jobs.all if given is not None and j.words == tuple(given)]
        failed = bool(mine) and mine[0].failed and not mine[0].cancelled
        wrong.set_text("\n".join(list(mine[0].lines)[-3:]) if failed else "")
        wrong.set_visibility(failed)

    watch(session, (*topics, JOBS), update, button)


def _busy(session: Session, words: Sequence[str]) -> bool:
    return any(job.words == tuple(words) for job in session.jobs.running)


def watch(
    session: Session, topics: Sequence[str], update: Callable[[], None], element: Element
) -> None:
    """Update something now and at each change, as long as an element is there."""

    def again() -> None:
        if not element.is_deleted:
            update()
        else:
            end()

    end = session.listen(tuple(topics), again)
    ui.context.client.on_delete(end)
    update()
