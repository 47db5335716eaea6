"""Diagnosing: what differs, what it may be, what to record next, and the amended model at work."""

from pathlib import Path
from typing import Any

from nicegui import ui

from tiltcal.app.bench import Bench
from tiltcal.app.parts import command_line, notes, page_of, table, verdict

FOLDER, NEXT, PREDICTED = "diagnosis", "next", "predicted.csv"


def diagnose_page(bench: Bench) -> None:
    """The diagnosis and what follows from it."""
    chosen = bench.workspace.chosen
    if not (chosen.recording and chosen.scenario):
        ui.label("Choose a recording and a scenario on the page Open.")
        return
    words = ("diagnose", chosen.recording, "--scenario", chosen.scenario, "-o", FOLDER)
    ui.button("Diagnose", on_click=lambda: bench.start(*words)).props("no-caps")
    command_line(*words)
    result = bench.workspace.result(f"{FOLDER}/diagnosis.json")
    if result is None:
        return
    ui.separator()
    names = [Path(str(name)).name for name in result["recordings"]]
    if names != [chosen.recording]:
        ui.label(f"This is the result of {', '.join(names)}.").classes("text-warning")
    verdict(str(result["verdict"]), str(result["statement"]))
    for finding in result["findings"]:
        _card(finding)
    notes([str(n) for n in result["notes"]])
    _further(bench, result)
    page_of(f"{FOLDER}/report.html", "report")


def _card(finding: dict[str, Any]) -> None:
    with ui.card().classes("w-full"):
        ui.label(str(finding["statement"]))
        rows = [
            [name, f"{p['value']:.5g}", f"{p['sigma']:.2g}"]
            for name, p in finding["parameters"].items()
        ]
        if rows:
            table(["parameter", "value", "standard uncertainty"], rows, numbers=2)
        if finding.get("rivals"):
            names = ", ".join(str(r["effect"]) for r in finding["rivals"])
            ui.label(f"It may also be: {names}").classes("text-sm")
        if finding.get("next_measurement"):
            ui.label(f"Record next: {finding['next_measurement']}").classes("text-sm")


def _further(bench: Bench, result: dict[str, Any]) -> None:
    chosen = bench.workspace.chosen
    amended = f"{FOLDER}/amended.toml"
    predict = ("simulate", amended, "--motion", chosen.recording, "--noise", "off", "-o", PREDICTED)
    split = ("design", "--split", f"{FOLDER}/diagnosis.json", "--scenario", chosen.scenario)
    with ui.row().classes("w-full columns"):
        with ui.column().classes("col"):
            ui.button(
                "Predict this recording with the amended model",
                on_click=lambda: bench.start(*predict),
            ).props("dense no-caps")
            command_line(*predict)
            if (bench.workspace.folder / PREDICTED).exists():
                ui.link(PREDICTED, f"/file/{PREDICTED}", new_tab=True)
        if result["verdict"] == "ambiguous":
            with ui.column().classes("col"):
                ui.button(
                    "Design the block that separates the names",
                    on_click=lambda: bench.start(*split, "-o", NEXT),
                ).props("dense no-caps")
                command_line(*split, "-o", NEXT)
    if (bench.workspace.folder / NEXT / "report.html").exists():
        page_of(f"{NEXT}/report.html", "proposed block")
