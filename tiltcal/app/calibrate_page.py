"""Calibrating: method, parameters, tests, certificate, comparison, exports."""

from typing import Any

from nicegui import ui

from tiltcal.api.calibrating import estimate
from tiltcal.app.bench import Bench, read_or_tell
from tiltcal.app.parts import command_line, notes, page_of, table, verdict
from tiltcal.app.recording_page import chosen_recording
from tiltcal.calibration.methods.registry import METHODS
from tiltcal.core.errors import TiltcalError
from tiltcal.core.units import readable_unit, unit_sign
from tiltcal.laboratory.scenario import Scenario, load_scenario
from tiltcal.recordings.recording import Recording

CAL, CERTIFICATE, DCC = "CAL.json", "certificate.html", "certificate.xml"
STATED = {
    "instrument": "Instrument",
    "serial": "Serial number",
    "manufacturer": "Manufacturer",
    "model": "Model",
    "customer": "Customer",
    "laboratory": "Laboratory, with address",
    "person": "Responsible person",
    "country": "Country, two letters",
    "date": "Day of the measurement, YYYY-MM-DD",
    "number": "Number of the certificate",
}
EXPORTS = {"imu.h": "c", "imu.params": "px4", "imu.param": "ardupilot"}


def calibrate_page(bench: Bench) -> None:
    """Method, result, certificate, comparison, exports."""
    chosen = bench.workspace.chosen
    if not (chosen.recording and chosen.scenario):
        ui.label("Choose a recording and a scenario on the page Open.")
        return
    with ui.row().classes("items-end w-full"):
        ui.select(
            list(METHODS),
            value=chosen.method if chosen.method in METHODS else None,
            label="Method",
            on_change=lambda e: bench.choose(method=e.value or ""),
        ).props("dense").classes("field")
        options = ui.input("Options, KEY=VALUE ...", value=chosen.options)
        options.props("dense").classes("field")
        options.on("blur", lambda: bench.workspace.choose(options=options.value))
        words = _words(bench)
        ui.button("Calibrate", on_click=lambda: _go(bench, options.value)).props("no-caps")
        ask = ui.button("Which methods does this recording allow?").props("flat no-caps")
    command_line(*words)
    place = ui.column().classes("w-full")
    ask.on_click(lambda: _asked(bench, place))
    result = bench.workspace.result(CAL)
    if result is not None:
        source = str(result["provenance"].get("recording", ""))
        if source.removeprefix("recording ") != chosen.recording:
            ui.label(f"This is the result of {source}.").classes("text-warning")
        _show(result)
        _certificate(bench)
        _exports(bench)
    _compare(bench)


def _words(bench: Bench, *more: str) -> tuple[str, ...]:
    chosen = bench.workspace.chosen
    options = [word for option in chosen.options.split() for word in ("--option", option)]
    if bench.path(bench.segments).exists():
        options += ["--segments", bench.segments]
    given = ("--scenario", chosen.scenario, "--method", chosen.method)
    return ("calibrate", chosen.recording, *given, *options, "-o", CAL, *more)


def _go(bench: Bench, options: str) -> None:
    bench.workspace.choose(options=options)
    bench.start(*_words(bench))


async def _asked(bench: Bench, place: ui.column) -> None:
    """Try every method, and list what it says."""
    place.clear()
    with place:
        if (found := chosen_recording(bench)) is None:
            return
        path = bench.path(bench.workspace.chosen.scenario)
        rows = await read_or_tell(lambda: _tried(found[0], load_scenario(path)))
        if rows is not None:
            table(["method", "result", "why not"], rows)


def _tried(recording: Recording, scenario: Scenario) -> list[list[str]]:
    """Every method with its verdict, or why it is not possible."""
    rows = []
    for name, method in METHODS.items():
        try:
            rows.append([name, estimate(method, recording, scenario, {})[0].verdict, ""])
        except TiltcalError as error:
            rows.append([name, "not possible", f"found {error.found}, need {error.need}"])
    return rows


def _show(result: dict[str, Any]) -> None:
    ui.separator()
    verdict(str(result["verdict"]), f"{result['method']}: {result['equation']}")
    rows = []
    for name, p in result["parameters"].items():
        factor, unit = readable_unit(p["unit"])
        value, sigma = p["value"] * factor, p["sigma"] * factor
        rows.append([name, f"{value:.5g}", f"{sigma:.2g}", unit_sign(unit)])
    table(["parameter", "value", "standard uncertainty", "unit"], rows, numbers=2)
    tests = [
        [
            t["name"],
            f"{t['p_value']:.2g}" if t.get("p_value") is not None else "",
            "passed" if t["passed"] else "failed",
            t["statement"],
        ]
        for t in result["tests"]
    ]
    table(["test", "p", "", "what it says"], tests, numbers=1)
    notes([str(w) for w in result["warnings"]])


def _certificate(bench: Bench) -> None:
    with ui.expansion("Certificate", value=bool(bench.workspace.chosen.stated)).classes("w-full"):
        boxes = {}
        with ui.element("div").classes("form w-full"):
            for key, title in STATED.items():
                kept = bench.workspace.chosen.stated.get(key, "")
                boxes[key] = ui.input(title, value=kept).props("dense")

        def write() -> None:
            stated = {k: box.value.strip() for k, box in boxes.items() if box.value.strip()}
            bench.workspace.choose(stated=stated)
            bench.start(*_certified(bench))

        ui.button("Write certificate and DCC", on_click=write).props("no-caps dense")
        command_line(*_certified(bench))
        _results(bench, CERTIFICATE, DCC)
        if (bench.workspace.folder / CERTIFICATE).exists():
            page_of(CERTIFICATE, "certificate")


def _certified(bench: Bench) -> tuple[str, ...]:
    stated = bench.workspace.chosen.stated
    said = [word for key, text in stated.items() for word in (f"--{key}", text)]
    dcc = ["--dcc", DCC] if "date" in stated else []
    return _words(bench, "--report", CERTIFICATE, *dcc, *said)


def _results(bench: Bench, *names: str) -> None:
    with ui.row():
        for name in names:
            if (bench.workspace.folder / name).exists():
                ui.link(name, f"/file/{name}", new_tab=True)


def _exports(bench: Bench) -> None:
    with ui.expansion("Firmware and autopilots").classes("w-full"):
        for name, form in EXPORTS.items():
            words = ("export", CAL, "--format", form, "-o", name)
            with ui.row().classes("items-center"):
                ui.button(form, on_click=lambda words=words: bench.start(*words)).props(
                    "dense no-caps"
                )
                command_line(*words)
        _results(bench, *EXPORTS)


def _compare(bench: Bench) -> None:
    names = [n for n in bench.workspace.names(".json") if _is_calibration(bench, n)]
    if len(names) < 2:
        return
    with ui.expansion("Compare and combine calibrations").classes("w-full"):
        which = ui.select(names, value=names[:2], multiple=True, label="Calibrations")
        which.classes("w-full").props("dense use-chips")
        ui.button(
            "Compare", on_click=lambda: bench.start("compare", *which.value, "-o", "comparison")
        ).props("dense no-caps")
        ui.button(
            "Combine", on_click=lambda: bench.start("combine", *which.value, "-o", "combined.json")
        ).props("dense no-caps")
        command_line("compare", *names[:2], "-o", "comparison")
        if (bench.workspace.folder / "comparison" / "report.html").exists():
            page_of("comparison/report.html", "comparison")


def _is_calibration(bench: Bench, name: str) -> bool:
    found = bench.workspace.result(name)
    return found is not None and "parameters" in found and "method" in found
