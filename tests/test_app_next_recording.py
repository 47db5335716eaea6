"""*Diagnose* goes on with `investigate` step by step: the next recording is planned, recorded and
diagnosed together with the first.
"""

import csv
import json
import os

import pytest
from docs_examples import BLOCK, ROOT

from tests.running_app import TOKEN, Page, running
from tiltcal.app.next_recording import following_folder
from tiltcal.cli import main

pytest.importorskip("nicegui", reason="the extra tiltcal[app] is not installed")


@pytest.fixture(scope="module")
def corner(tmp_path_factory):
    """A workspace with the worked example of docs/investigate.md: an encoder that is eccentric,
    swept about one corner.
    """
    folder = tmp_path_factory.mktemp("next") / "corner"
    folder.mkdir()
    for _, name, body in BLOCK.findall((ROOT / "docs/investigate.md").read_text(encoding="utf-8")):
        if name:
            (folder / name).write_text(body)
    assert main(["simulate", str(folder / "truth.toml"), "-o", str(folder / "run.csv")]) == 0
    return folder


def test_the_results_so_far_are_kept():
    assert following_folder("diagnosis", 2) == "diagnosis-2"
    assert following_folder("diagnosis-2", 3) == "diagnosis-3"
    assert following_folder("two-arms", 2) == "two-arms-2"


def test_an_ambiguous_diagnosis_is_led_to_one_cause(browser, corner):
    with running(corner, "--token", TOKEN) as app:
        page = Page(browser, app)
        page.page.set_default_timeout(120_000)
        page.page.get_by_role("button", name="run.csv", exact=True).click()
        page.page.get_by_role("button", name="nominal.toml", exact=True).click()
        page.go("Diagnose")
        page.press("Diagnose")
        page.shows(".verdict:has-text('ambiguous')")
        page.press("Plan the next recording")
        page.shows("text=Download the steps")
        with (corner / "diagnosis/next/sequence.csv").open() as file:
            steps = list(csv.DictReader(file))
        rows = page.page.locator("table:has(th:text-is('action')) tbody tr")
        shown = [row.split("\t") for row in rows.all_inner_texts()]
        assert [row[1] for row in shown] == [step["action"] for step in steps]
        with page.page.expect_download() as got:
            page.page.get_by_role("link", name="Download the steps").click()
        assert got.value.path().read_text() == (corner / "diagnosis/next/sequence.csv").read_text()
        page.page.get_by_label("Scenario of a simulated laboratory").click()
        page.page.locator(".q-menu:visible .q-item", has_text="truth.toml").first.click()
        page.press("Record in simulation")
        page.shows("code:has-text('run.csv run-next.csv')")
        page.press("Diagnose together")
        page.shows(".verdict:has-text('explained')")
        page.shows("text=No further recording is needed")
        page.shows("text=Diagnosed: run.csv, run-next.csv")
        assert page.command("tiltcal diagnose").endswith("-o diagnosis-2")
        page.shows(".section code:has-text('simulate diagnosis-2/amended.toml')")
        page.require_clean()
        page.context.close()
    found = json.loads((corner / "diagnosis-2/diagnosis.json").read_text())
    assert [f["effect"] for f in found["findings"]] == ["table_encoder_eccentricity"]
    first = json.loads((corner / "diagnosis/diagnosis.json").read_text())
    assert first["verdict"] == "ambiguous"


def test_a_plan_of_an_earlier_diagnosis_is_not_shown(tmp_path):
    from tiltcal.app.next_recording import _plan
    from tiltcal.app.session import Session
    from tiltcal.app.workspace import Workspace

    (tmp_path / "diagnosis/next").mkdir(parents=True)
    (tmp_path / "diagnosis/diagnosis.json").write_text("{}")
    (tmp_path / "diagnosis/next/next_block.json").write_text('{"block": null}')
    session = Session(Workspace(tmp_path))
    assert _plan(session) is not None
    later = (tmp_path / "diagnosis/next/next_block.json").stat().st_mtime_ns + 1_000_000
    os.utime(tmp_path / "diagnosis/diagnosis.json", ns=(later, later))
    assert _plan(session) is None
