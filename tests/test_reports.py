"""The HTML reports in a real browser: they stand alone, draw, fit a telephone, follow dark mode and
the keyboard, and what comes from files stays text.
"""

import json
import re
import shutil
from dataclasses import replace
from itertools import islice

import numpy as np
import pytest
from diagnosis_fixtures import bench, honest, recorded, tumble

from tests.scenario_files import BENCH_SCENARIO
from tiltcal.api.diagnosing import write_results
from tiltcal.api.table_scene import table_in, table_picture
from tiltcal.calibration.result import load_calibration
from tiltcal.cli import main
from tiltcal.design.identifiability import reference_scenario
from tiltcal.design.recording_blocks import CIRCLE, TableLimits, candidates
from tiltcal.diagnosis.conclusions.finding import Finding, Where
from tiltcal.diagnosis.conclusions.residual_plots import Spectrum, angles_of
from tiltcal.diagnosis.diagnose import diagnose
from tiltcal.diagnosis.investigation.discriminating_blocks import BlockProposal, Pair
from tiltcal.diagnosis.investigation.next_block import NextBlock
from tiltcal.diagnosis.investigation.progress_log import Entry, Investigation
from tiltcal.effects import CATALOGUE
from tiltcal.effects.base import AngleEffect, FrameEffect
from tiltcal.laboratory.scenario import load_scenario, parse_scenario
from tiltcal.report.certificate import certificate_page, make_certificate
from tiltcal.report.design import write_separating_block
from tiltcal.report.diagnosis import curve_plots, lead, spectrum_plot, write_diagnosis
from tiltcal.report.investigation import write_investigation
from tiltcal.report.poses import poses_of, poses_of_steps
from tiltcal.report.stated import Stated

HOSTILE = "</script><script>document.title='run'</script><b>\"'&amp;"
MARKED = "<script>document.title='run'<!--.toml"
PAGES = (
    "diagnosis",
    "verification",
    "campaign",
    "design",
    "visible_poses",
    "separating_block",
    "investigation",
    "certificate",
)
DRAWN = tuple(page for page in PAGES if page != "certificate")  # one that is printed has no plots
LIMIT = 6 * 2**20  # bytes
VISIBLE = ("--all-effects-observable", "14", "--terms", "acc_K2", "acc_Kip", "acc_drift")
PHONE = {"width": 390, "height": 844}
DESK = {"width": 1280, "height": 900}


@pytest.fixture(scope="module")
def remounted():
    """A diagnosis of a recording with two mountings, its recording and its honest scenario."""
    base = bench({"id": "acc_K2", "sensor": "accel", "k2_x_ug_g2": 600.0})
    table = base.model_dump(exclude_defaults=True, by_alias=True) | {"schema": 1}
    half = tumble(10)
    table["sequence"] = [*half, {"action": "remount", "mount": "Rz(180)"}, *half]
    truth = parse_scenario(table)
    data = recorded(truth, 11)
    return diagnose(honest(truth), [data]), data, honest(truth)


@pytest.fixture(scope="module")
def pages(good, remounted, tmp_path_factory):
    """A small report of each kind; names in them are markup wherever a user may choose them."""
    out = tmp_path_factory.mktemp("reports")
    found, data, scenario = remounted
    poses = [replace(p, group=f"{p.group} {HOSTILE}") for p in poses_of([data], scenario)]
    table = table_in(poses, scenario)
    write_diagnosis(found, out / "diagnosis.html", HOSTILE, poses, table)
    named = BENCH_SCENARIO.replace('name = "', f'name = {json.dumps(HOSTILE)} # "', 1)
    (out / "claims.toml").write_text(named)
    (out / "model.toml").write_text(named.partition("[[method]]")[0])
    shutil.copy(out / "claims.toml", out / MARKED)
    words = ["--effect", "acc_bias.bias_y_ug=-1500:0:2", "--seeds", "2"]
    for command in (
        ["run", out / "claims.toml", "-o", out / "run"],
        ["sweep", out / MARKED, *words, "-o", out / "s.parquet"],
        ["design", out / "model.toml", "--budget-s", "60", "-o", out / "design"],
        ["design", out / "model.toml", *VISIBLE, "-o", out / "visible"],
    ):
        assert main([str(word) for word in command]) == 0
    shutil.copy(out / "run" / "report.html", out / "verification.html")
    shutil.copy(out / "s.html", out / "campaign.html")
    shutil.copy(out / "design" / "report.html", out / "design.html")
    shutil.copy(out / "visible" / "report.html", out / "visible_poses.html")
    write_block(out / "separating_block.html", load_scenario(out / "model.toml"))
    answer = json.loads(json.dumps(found.to_json()))
    entry = Entry(HOSTILE, HOSTILE, 2.0, 0.9, "sequence_1.csv", "recording_1.csv")
    state = Investigation((), (entry, entry), ("ambiguous",) * 2, HOSTILE)
    write_investigation(state, [answer, answer], out / "investigation.html", poses, table)
    made = make_certificate(load_calibration(good / "CAL.json"), Stated(instrument=HOSTILE))
    made = replace(made, picture=table_picture(made.setup))
    (out / "certificate.html").write_text(certificate_page(made), encoding="utf-8")
    return {name: out / f"{name}.html" for name in PAGES}


def write_block(path, scenario):
    """The report of a block whose words and rivals are markup."""
    limits = TableLimits(scenario.rig, dict.fromkeys(scenario.rig.axis_names, CIRCLE), 30.0, 3.0)
    blocks = [replace(b, description=HOSTILE) for b in islice(candidates(limits), 3)]
    pairs = (Pair(HOSTILE, "acc_K2", 30.0, 0.9), Pair("acc_K2", HOSTILE, 90.0, 1.0))
    proposals = tuple(BlockProposal(b, 1.0 + k, 0.9, pairs) for k, b in enumerate(blocks))
    plan = NextBlock(proposals[0], HOSTILE, (HOSTILE,), proposals)
    poses = poses_of_steps(blocks[0].steps, scenario, HOSTILE)
    table = table_in(poses, scenario)
    write_separating_block(plan, path, scenario, scenario.name, poses, table)


class Seen:
    """A page that was opened, and what it complained of or asked for."""

    def __init__(self, browser, path, size):
        self.context = browser.new_context(viewport=size, color_scheme="light")
        self.page = self.context.new_page()
        self.complaints, self.asked = [], []
        self.page.on("pageerror", lambda error: self.complaints.append(str(error)))
        self.page.on("console", self._noted)
        self.page.on("request", lambda request: self.asked.append(request.url))
        self.page.goto(path.as_uri())

    def _noted(self, message):
        if message.type == "error":
            self.complaints.append(message.text)

    def value(self, script):
        return self.page.evaluate(script)

    def draw_all(self):
        """Open what is folded and let everything draw."""
        self.value("document.querySelectorAll('main details:not(.data)').forEach(d => d.open = 1)")
        self.value("dispatchEvent(new Event('beforeprint'))")
        self.page.wait_for_function(
            "[...document.querySelectorAll('[data-plot]')]"
            ".every(p => p.querySelector('.main-svg, .gl-container'))"
        )


@pytest.fixture
def opened(browser):
    """Opens pages, and closes them in the end."""
    seen = []

    def look(path, size):
        seen.append(Seen(browser, path, size))
        return seen[-1]

    yield look
    for one in seen:
        one.context.close()


# --------------------------------------------------------------------------------------------------
# ---- without a browser


@pytest.mark.parametrize("name", PAGES)
def test_a_report_is_one_file_of_limited_size_with_its_result_first(pages, name):
    text = pages[name].read_text(encoding="utf-8")
    assert len(text.encode()) < LIMIT
    body = text[text.index("<main") :]
    assert body.index('class="lead"') < body.index("<table")
    assert '<a class="skip" href="#main">' in text
    for part in ('name="viewport"', "prefers-color-scheme: dark", "@media print"):
        assert part in text


@pytest.mark.parametrize("name", PAGES)
def test_no_name_from_a_file_is_markup(pages, name):
    text = pages[name].read_text(encoding="utf-8")
    assert "document.title='run'</script>" not in text
    assert "&lt;script&gt;document.title" in text


def test_every_plot_has_a_text_alternative_with_figures(pages):
    for name in DRAWN:
        text = pages[name].read_text(encoding="utf-8")
        labels = [part.split('"')[0] for part in text.split('role="img" aria-label="')[1:]]
        assert labels
        assert all(len(label) > 20 for label in labels)


def test_a_law_is_drawn_with_its_data_in_the_users_units(remounted):
    found, *_ = remounted
    (finding,) = found.findings
    laws = [law for law in finding.laws if law.subject == "accel.x"]
    assert [law.mount for law in laws] == ["identity", "Rz(180)"]
    for law in laws:
        assert law.unit == "ug"
        f = law.coordinates["input_g"]
        expected = finding.parameters["k2_x_ug_g2"][0] * f**2
        # within a move the mean of a square is not the square of a mean
        np.testing.assert_allclose(law.law[law.still], expected[law.still], rtol=0.02, atol=1.0)
        pull = (law.data - law.law)[law.still] / law.sigma[law.still]
        assert 0.5 < np.sqrt(np.mean(pull**2)) < 1.5
        assert np.abs(law.data[law.still]).max() > 300


def test_held_out_residuals_are_shown_for_each_mounting(remounted):
    found, *_ = remounted
    own = [v for v in found.views if v.channel == "accel.x"]
    assert [v.mount for v in own] == ["identity", "Rz(180)"]
    for view in own:
        first, last = (np.sqrt(np.mean(x**2)) for x in (view.before, view.after))
        assert first > 3 * last
        assert last < 2 * np.sqrt(np.mean(view.sigma**2))


def test_every_geometric_effect_has_its_angles_for_a_picture():
    drawn = set()
    for id, cls in CATALOGUE.items():
        if not issubclass(cls, AngleEffect | FrameEffect):
            continue
        scenario = reference_scenario(id)
        drive = scenario.schedule.drive(np.linspace(*scenario.schedule.times, 100))
        effect = next(e for e in scenario.effects if e.id == id)
        angles = angles_of(effect, drive, scenario)
        assert all(a.shape in ((1,), (100,)) for a in angles.values())
        if any(np.ptp(a) > 0 for a in angles.values()):
            drawn.add(cls)
    assert len(drawn) >= 15


def test_the_lead_of_a_diagnosis_names_effect_place_and_size(remounted):
    found, *_ = remounted
    words = lead(found)
    assert words.startswith("The scenario leaves out acc_K2")
    assert "on accel x" in words
    assert "of held-out data goes from" in words
    fault = Finding("data_stuck", ("data_stuck",), "data", ("accel",), ("y",), Where("sample"))
    both = replace(found, findings=(*found.findings, fault, fault))
    words = lead(both)
    assert words.startswith("The recording has data_stuck on accel y (2 times), and the scenario")
    assert lead(replace(both, verdict="cannot_tell")).startswith("Not confirmed: the recording")
    assert lead(replace(found, findings=(), verdict="match")).endswith("agrees with the scenario.")


def test_a_law_that_is_the_same_throughout_says_its_size(remounted):
    (finding,) = remounted[0].findings
    law = next(law for law in finding.laws if law.subject == "accel.x")
    (varied, *_) = curve_plots(replace(finding, laws=(law,)))
    assert f"{np.ptp(law.law):.3g} µg from lowest to highest" in varied.caption
    step = np.full_like(law.law, -400.0)
    (same, *_) = curve_plots(replace(finding, laws=(replace(law, law=step, leading=step),)))
    assert same.caption.endswith("-400 µg throughout.")


def test_spectra_of_one_channel_in_two_recordings_have_names_of_their_own():
    values = np.arange(1.0, 5.0)
    spectra = [Spectrum(f"accel.{axis}", values, values, values) for axis in "xyx"]
    named = [trace["name"].removesuffix(" after") for trace in spectrum_plot(spectra).traces[1::2]]
    assert named == ["accel.x, recording 1", "accel.y", "accel.x, recording 2"]


def test_units_are_printed_as_signs(pages):
    for name in PAGES:
        text = pages[name].read_text(encoding="utf-8")
        cells = re.findall(r"<td[^>]*>([^<]*)</td>", text)
        assert not {"ug", "m_s2", "deg_h", "ug_rthz", "ug_rts"} & set(cells), name
    assert "µg/√Hz" in pages["diagnosis"].read_text(encoding="utf-8")


def test_the_files_of_a_diagnosis_hold_its_poses(remounted, here):
    found, data, scenario = remounted
    write_results(found, here / "out", scenario, [data], [here / "run.csv"])
    text = (here / "out" / "report.html").read_text(encoding="utf-8")
    count = len(poses_of([data], scenario))
    assert count >= 20
    assert f"Directions of gravity in the body frame, {count} poses" in text
    assert f"The table in {min(count, 30)} of {count} poses" in text


# --------------------------------------------------------------------------------------------------
# ---- in the browser


@pytest.mark.parametrize("name", PAGES)
def test_a_report_in_a_browser(pages, opened, name):
    """It draws, asks for nothing, complains of nothing, fits a telephone, and follows dark mode."""
    seen = opened(pages[name], PHONE)
    plots = "document.querySelectorAll('[data-plot]').length"
    assert (seen.value(plots) > 0) == (name in DRAWN)
    look = (
        "[getComputedStyle(document.body).backgroundColor, getComputedStyle(document.body).color,"
        " document.querySelector('[data-drawn]')?.layout.paper_bgcolor ?? String(matchMedia("
        "'(prefers-color-scheme: dark)').matches)]"
    )
    if name in DRAWN:
        seen.page.wait_for_selector("[data-drawn] .main-svg", state="attached")
    light = seen.value(look)
    seen.page.emulate_media(color_scheme="dark")
    seen.page.wait_for_function(f"{look}[2] !== '{light[2]}'")
    assert all(a != b for a, b in zip(light, seen.value(look), strict=True))
    seen.draw_all()
    if name in DRAWN:  # on paper it is light
        assert seen.value(look)[2] == "#fff"
    assert seen.value("document.documentElement.scrollWidth") <= PHONE["width"]
    assert seen.page.title() != "run"
    assert seen.complaints == []
    assert [url for url in seen.asked if not url.startswith(("file:", "data:", "blob:"))] == []


@pytest.fixture(scope="module")
def diagnosed(pages, browser):
    """The report of a diagnosis on a desk, in light."""
    seen = Seen(browser, pages["diagnosis"], DESK)
    yield seen
    seen.context.close()


def test_the_keyboard_reaches_the_content_and_opens_the_details(diagnosed):
    seen = diagnosed
    seen.page.keyboard.press("Tab")
    assert seen.value("document.activeElement.className") == "skip"
    for _ in range(40):
        seen.page.keyboard.press("Tab")
        if seen.value("document.activeElement.tagName") == "SUMMARY":
            break
    closed = "document.activeElement.parentElement.open"
    assert not seen.value(closed)
    assert seen.value("getComputedStyle(document.activeElement).outlineStyle") != "none"
    seen.page.keyboard.press("Enter")
    assert seen.value(closed)


def test_a_hover_shows_names_and_units(diagnosed):
    seen = diagnosed
    place = seen.page.locator("[data-plot]").first
    place.scroll_into_view_if_needed()
    seen.page.wait_for_selector("[data-drawn] .main-svg", state="attached")
    point = "{curveNumber: 0, pointNumber: 3}"
    seen.value(f"Plotly.Fx.hover(document.querySelector('[data-drawn]'), [{point}])")
    label = seen.page.locator(".hoverlayer").first.text_content()
    assert "measured" in label
    assert "µg" in label
    assert "own reading" in label
    assert "trace" not in label


def test_the_page_of_the_table_in_motion_asks_for_nothing(good, here, opened):
    assert main(["view", str(good / "bench.toml"), "--seconds", "1", "-o", "view.html"]) == 0
    seen = opened(here / "view.html", DESK)
    seen.page.wait_for_selector("canvas")
    assert seen.complaints == []
    assert [url for url in seen.asked if not url.startswith(("file:", "data:", "blob:"))] == []


def test_the_data_of_a_plot_can_be_read_as_a_table(diagnosed):
    seen = diagnosed
    seen.value("document.querySelector('details.data').open = true")
    seen.page.wait_for_selector("details.data table")
    rows = seen.value("document.querySelector('details.data table').rows.length")
    assert rows > 20
    seen.value("[...document.querySelectorAll('details.data')].forEach(d => d.open = true)")
    assert "<script>" in seen.page.locator("#poses ~ .plot-grid table").first.text_content()
