"""The first page: files of the workspace, what a log holds and how it is read, the scenario."""

import re
from pathlib import Path
from typing import Any

from nicegui import events, ui

from tiltcal.app.bench import Bench
from tiltcal.app.parts import command_line, notes, table
from tiltcal.app.workspace import RECORDINGS, SCENARIOS
from tiltcal.core.errors import TiltcalError
from tiltcal.core.files import write_text
from tiltcal.laboratory.scenario import load_scenario

MAP, RUN = "map.toml", "run.csv"
LARGEST = 4 * 2**30  # bytes of an upload: it is written piece by piece
LINE = re.compile(r"(\w+) = (.*?)\s*(?:# (.*))?$")


def open_page(bench: Bench) -> None:
    """Files, import, scenario."""
    with ui.row().classes("w-full columns"):
        with ui.column().classes("col gap-1"):
            _files(bench)
        with ui.column().classes("col gap-1"):
            _scenario(bench)
    _import(bench)


def _files(bench: Bench) -> None:
    ui.label("Recording").classes("text-h6")
    upload = ui.upload(
        label="Drop a log, a recording or a scenario here",
        auto_upload=True,
        multiple=True,
        max_file_size=LARGEST,
        on_upload=lambda event: _came(bench, event),
        on_rejected=lambda: ui.notify("The file is too large.", type="negative"),
    )
    upload.classes("w-full").props("flat bordered")
    space, chosen = bench.workspace, bench.workspace.chosen
    ui.select(
        space.names(*RECORDINGS),
        value=_there(chosen.recording, space.names(*RECORDINGS)),
        label="Recording of the workspace",
        on_change=lambda e: bench.choose(recording=e.value or ""),
    ).classes("w-full").props("dense")
    ui.select(
        space.names(),
        value=_there(chosen.log, space.names()),
        label="Log of another system, to import",
        on_change=lambda e: bench.choose(log=e.value or ""),
    ).classes("w-full").props("dense")


def _there(name: str, names: list[str]) -> str | None:
    return name if name in names else None


async def _came(bench: Bench, event: events.UploadEventArguments) -> None:
    """Store an upload and choose it."""
    try:
        name = await bench.workspace.take_in(event.file.name, event.file.iterate())
    except TiltcalError as error:
        ui.notify(str(error), type="negative")
        return
    ending = Path(name).suffix.lower()
    if ending in SCENARIOS:
        bench.choose(scenario=name)
    elif ending == ".csv" and _is_recording(bench.path(name)):
        bench.choose(recording=name)
    else:
        bench.choose(log=name)


def _is_recording(path: Path) -> bool:
    """Whether a CSV file has the columns of a recording."""
    with path.open(encoding="utf-8", errors="replace") as file:
        lines = (line for line in file if not line.startswith("#"))
        return "time_s" in next(lines, "").split(",")


def _scenario(bench: Bench) -> None:
    ui.label("Scenario").classes("text-h6")
    space, chosen = bench.workspace, bench.workspace.chosen
    names = [n for n in space.names(*SCENARIOS) if n != MAP]
    ui.select(
        names,
        value=_there(chosen.scenario, names),
        label="Scenario of the workspace",
        on_change=lambda e: bench.choose(scenario=e.value or ""),
    ).classes("w-full").props("dense")
    if chosen.recording:
        made = f"{Path(chosen.recording).stem}.toml"
        words = ("init", "--from", chosen.recording, "-o", made)
        ui.button(
            "Write one by the recording",
            on_click=lambda: bench.start(*words, then=lambda _: bench.choose(scenario=made)),
        ).props("dense no-caps")
        command_line(*words)
    if chosen.scenario in names:
        _edited(bench, chosen.scenario)


def _edited(bench: Bench, name: str) -> None:
    """A scenario as text, checked when it is saved."""
    with ui.expansion(f"Edit {name}").classes("w-full"):
        text = bench.path(name).read_text(encoding="utf-8", errors="replace")
        area = ui.textarea(label=name, value=text).classes("w-full font-mono text-xs")
        area.props("autogrow")

        def save() -> None:
            write_text(bench.path(name), area.value)
            try:
                load_scenario(bench.path(name))
            except TiltcalError as error:
                ui.notify(str(error), type="negative", multi_line=True)
                return
            ui.notify("saved; the scenario reads")
            bench.choose(scenario=name)

        ui.button("Save and check", on_click=save).props("dense no-caps")


def _import(bench: Bench) -> None:
    log = bench.workspace.chosen.log
    if not log:
        return
    ui.label(f"Import {log}").classes("text-h6")
    words = ("import", log, "--propose", "-o", MAP)
    with ui.row():
        ui.button(
            "Propose how it is read", on_click=lambda: bench.start(*words, then=lambda _: None)
        ).props("dense no-caps")
    command_line(*words)
    if (bench.workspace.folder / MAP).exists():
        _mapping(bench, log)


def _mapping(bench: Bench, log: str) -> None:
    """The proposal, each guess with its reason and to be changed."""
    text = bench.path(MAP).read_text(encoding="utf-8", errors="replace")
    lines = text.splitlines()
    inputs: dict[int, Any] = {}
    with ui.element("div").classes("mapping w-full"):
        for k, line in enumerate(lines):
            found = LINE.match(line)
            if found is None:
                if line.startswith("["):
                    ui.label(line.strip("[]")).classes("text-bold head")
                continue
            with ui.element("div").classes("line"):
                ui.label(found[1]).classes("font-mono text-xs")
                inputs[k] = ui.input(value=found[2]).props(f'dense aria-label="{found[1]}"')
                ui.label(found[3] or "").classes("text-xs text-gray-500 reason")
    notes([line[2:] for line in lines if line.startswith("# cannot know")])
    name = f"{Path(log).stem}-{RUN}" if log != RUN else f"imported-{RUN}"
    words = ("import", log, "--map", MAP, "-o", name)

    def go() -> None:
        changed = list(lines)
        for k, box in inputs.items():
            key, _, reason = lines[k].partition(" = ")[0], "", LINE.match(lines[k])
            said = f"  # {reason[3]}" if reason and reason[3] else ""
            changed[k] = f"{key} = {box.value}{said}"
        write_text(bench.path(MAP), "\n".join(changed) + "\n")
        bench.start(*words, then=lambda _: bench.choose(recording=name))

    ui.button("Import", on_click=go).props("dense no-caps")
    command_line(*words)
    job = bench.job
    if job is not None and job.words[:1] == ("import",) and job.said and not job.runs:
        table(["said by the import"], [[line] for line in job.said])
