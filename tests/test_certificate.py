"""The calibration certificate as a page, and as a PTB digital calibration certificate."""

import json
import re
import shutil
import subprocess
import sys
import types
import xml.etree.ElementTree as ET
from dataclasses import replace

import numpy as np
import pytest
from outside_files import SCHEMAS, reason_without

from tiltcal.calibration.methods.registry import calibrate
from tiltcal.calibration.result import Calibration, load_calibration
from tiltcal.cli import main
from tiltcal.core.assets import folder
from tiltcal.core.errors import TiltcalError
from tiltcal.core.units import ARCSEC, DEG_H, G0
from tiltcal.laboratory.laboratory import SimulatedLaboratory
from tiltcal.laboratory.scenario import load_scenario
from tiltcal.recordings.recording_files import read_recording
from tiltcal.report.certificate import certificate_page, make_certificate
from tiltcal.report.certificate_scope import not_tested, procedure
from tiltcal.report.certificate_tables import pose_table, rounded
from tiltcal.report.dcc import dcc_text, si_unit
from tiltcal.report.improvement import improvements
from tiltcal.report.indication import Indication, indications, repeatability
from tiltcal.report.pose_residuals import PoseRow, pose_rows
from tiltcal.report.stated import Stated
from tiltcal.report.wording import mounting, period
from tiltcal.validation.uncertainty_budget import Line, UncertaintyBudget

SIGNATURE = """\
<xs:schema xmlns:xs="http://www.w3.org/2001/XMLSchema"
 targetNamespace="http://www.w3.org/2000/09/xmldsig#"><xs:element name="Signature"/></xs:schema>
"""
HOSTILE = "<script>alert(1)</script>&\"'"
DAY = Stated(date="2026-11-23")
NS = {"dcc": "https://ptb.de/dcc", "si": "https://ptb.de/si"}
SECTIONS = (
    "Instrument",
    "Measurement",
    "Method",
    "Traceability",
    "Results: parameters with expanded uncertainty U, k = 2",
    "Uncertainty budget (GUM)",
    "Error of indication before and after",
    "Tilt error before and after",
    "Tests",
    "How to apply it",
    "Validity",
    "Not tested",
)


@pytest.fixture(scope="module")
def written(good, tmp_path_factory):
    """What ``calibrate --report --dcc`` writes, with the answer on stdout as JSON beside it."""
    out = tmp_path_factory.mktemp("certificate")
    words = ["calibrate", good / "run.csv", "--scenario", good / "bench.toml"]
    words += ["--method", "six_position", "-o", out / "CAL.json", "--report", out / "out.html"]
    words += ["--dcc", out / "out.xml", "--date", "2026-11-23", "--serial", "A-17"]
    assert main([str(w) for w in words]) == 0
    return out


@pytest.fixture(scope="module")
def plain(good):
    """A calibration of the small bench."""
    return load_calibration(good / "CAL.json")


@pytest.fixture(scope="module")
def schema(tmp_path_factory):
    """The schema of PTB, with a local stand-in for that of XML signatures."""
    if (reason := reason_without(SCHEMAS / "dcc-3.2.1.xsd")) is not None:
        pytest.skip(reason)
    import xmlschema

    signature = tmp_path_factory.mktemp("schema") / "signature.xsd"
    signature.write_text(SIGNATURE)
    places = [
        ("https://ptb.de/si", str(SCHEMAS / "SI_Format-2.1.0.xsd")),
        ("http://www.w3.org/2000/09/xmldsig#", str(signature)),
    ]
    return xmlschema.XMLSchema(str(SCHEMAS / "dcc-3.2.1.xsd"), locations=places, allow="local")


def text_of(page):
    """The words of a page."""
    return re.sub(r"\s+", " ", re.sub("<[^>]*>", " ", page))


def quantities(text):
    """Label -> (value, unit, U or None) of a DCC."""
    return {
        real.findtext("si:label", namespaces=NS): (
            float(real.findtext("si:value", namespaces=NS)),
            real.findtext("si:unit", namespaces=NS),
            None if (u := real.findtext(".//si:uncertainty", namespaces=NS)) is None else float(u),
        )
        for real in ET.fromstring(text).iterfind(".//dcc:results//si:real", NS)
    }


# --------------------------------------------------------------------------------------------------
# ---- numbers


@pytest.mark.parametrize(
    ("unit", "factor", "text"),
    [
        ("m_s2", 1.0, r"\metre\second\tothe{-2}"),
        ("1", 1.0, r"\one"),
        ("ppm", 1e-6, r"\one"),
        ("rad", 1.0, r"\radian"),
        ("rad_s", 1.0, r"\radian\second\tothe{-1}"),
        ("ug_g2", 1e-6 / G0, r"\metre\tothe{-1}\second\tothe{2}"),
        ("ug_g3", 1e-6 / G0**2, r"\metre\tothe{-2}\second\tothe{4}"),
        ("deg_h_g", DEG_H / G0, r"\radian\metre\tothe{-1}\second"),
        ("m_s2_degC2", 1.0, r"\metre\second\tothe{-2}\kelvin\tothe{-2}"),
        ("1_degC1", 1.0, r"\kelvin\tothe{-1}"),
        ("degC", 1.0, r"\degreecelsius"),
    ],
)
def test_units_in_D_SI_by_hand(unit, factor, text):
    found = si_unit(unit)
    assert found is not None
    assert found.text == text
    assert found.factor == pytest.approx(factor, rel=1e-14)


def test_a_unit_without_D_SI_form_has_none():
    assert si_unit("furlong") is None
    assert si_unit("furlong_degC2") is None


@pytest.mark.parametrize(
    ("value", "u", "shown"),
    [
        (1.23456, 0.0123, ("1.235", "0.012")),
        (-0.0784, 0.000075, ("-0.078400", "0.000075")),
        (12345.6, 234.0, ("12350", "230")),
        (3.0, 0.0, ("3", "0")),
        (1.5e-12, 2.0e-13, ("1.500000e-12", "2.0e-13")),
    ],
)
def test_the_uncertainty_has_two_digits_and_the_value_ends_there(value, u, shown):
    assert rounded(value, u) == shown


def test_residuals_and_tilt_errors_of_the_poses_by_hand(good, plain):
    recording = read_recording(good / "run.csv")
    setup = load_scenario(good / "bench.toml")
    rows = pose_rows(plain, recording, setup)
    assert [r.label for r in rows] == ["+z", "+y", "-z", "-y", "+x", "-x"]
    b = np.array([plain.value(f"accel.bias_{a}") for a in "xyz"])
    M = np.array(
        [
            [plain.value(f"accel.cross_{a}{c}") if a != c else 1 + plain.value(f"accel.scale_{a}")
             for c in "xyz"]
            for a in "xyz"
        ]
    )  # fmt: skip
    g = 9.80123
    for row in rows:
        inside = (recording.time >= row.start_s) & (recording.time <= row.end_s)
        mean = np.array([recording.column(f"accel_{a}_m_s2")[inside].mean() for a in "xyz"])
        up = np.zeros(3)
        up["xyz".index(row.label[1])] = 1.0 if row.label[0] == "+" else -1.0
        f = np.linalg.solve(M, mean - b)
        residual = np.array([row.residuals[a] for a in "xyz"])
        np.testing.assert_allclose(residual, (f - g * up) / (1e-6 * G0), atol=2.0)
        across = np.linalg.norm(mean - (mean @ up) * up)
        before = np.arctan2(across, mean @ up) / ARCSEC
        assert row.before == pytest.approx(before, rel=0.01, abs=1.0)
        assert row.after < row.before / 20 or row.before < 20


def test_two_channels_are_judged_on_their_own_side_of_level():
    scenario = load_scenario(folder("scenarios") / "tumble_inclinometer.toml")
    log = SimulatedLaboratory().record(scenario, 3)
    found = calibrate("six_position", log, scenario)
    assert max(r.after for r in pose_rows(found, log, scenario)) < 60


def test_of_many_poses_the_largest_residuals_are_shown():
    poses = [PoseRow(k, k + 1, "", {}, {"x": float(k)}, None, None) for k in range(40)]
    table = pose_table(poses)
    assert [row["number"] for row in table.rows] == list(range(29, 41))
    assert table.note == "Of 40 poses the 12 with the largest residuals."


def test_the_error_of_indication_by_hand(good, plain):
    setup = load_scenario(good / "bench.toml")
    x, y, z = indications(plain, setup, ())
    # bias 3000 and -1500 ug, scale_z 1200 ppm, over the inclination of the axis
    assert (x.unit, y.unit) == ("µg", "µg")
    b, S, C = (plain.value(f"accel.{n}") for n in ("bias_x", "scale_x", "cross_xz"))
    f = 9.80123 * np.sin(np.radians(x.curve[0]))
    across = 9.80123 * np.cos(np.radians(x.curve[0]))
    np.testing.assert_allclose(x.curve[1], (b + S * f + C * across) / G0 * 1e6, rtol=1e-9)
    assert x.before[3] == pytest.approx(3000, abs=30)  # at 0 deg
    names = ["accel.bias_z", "accel.scale_z", "accel.cross_zx"]
    rows = [list(plain.parameters).index(n) for n in names]
    covariance = np.asarray(plain.covariance)[np.ix_(rows, rows)]
    J = np.array([1.0, 9.80123, 0.0])  # at 90 deg
    assert z.U[-1] == pytest.approx(2 * np.sqrt(J @ covariance @ J) / G0 * 1e6, rel=1e-6)
    assert x.after is None
    measured = indications(plain, setup, pose_rows(plain, read_recording(good / "run.csv"), setup))
    assert np.abs(measured[0].after).max() < 100
    assert np.sort(measured[0].angle) == pytest.approx([-90, 0, 0, 0, 0, 90], abs=0.01)


def test_an_inclinometer_s_error_is_an_angle():
    scenario = load_scenario(folder("scenarios") / "tumble_inclinometer.toml")
    log = SimulatedLaboratory().record(scenario, 3)
    found = calibrate("six_position", log, scenario)
    rows = pose_rows(found, log, scenario)
    one = indications(found, scenario, rows)[0]
    assert one.unit == "arcsec"
    k = int(np.argmin(np.abs(one.angle)))
    expected = rows[k].uncorrected["x"] * 1e-6 * G0 / scenario.site.gravity / ARCSEC
    assert one.before[k] == pytest.approx(expected / np.cos(np.radians(one.angle[k])), rel=0.02)
    # twice the same sequence: each direction is visited again
    assert "degrees of freedom" in repeatability([one], rows) or "No pose" in repeatability(
        [one], rows
    )


def test_repeated_poses_give_a_repeatability():
    up = [np.array([0, 0, 1.0]), np.array([1.0, 0, 0])]
    poses = [PoseRow(k, k + 1, "", {}, {}, None, None, up[k % 2]) for k in range(4)]
    zero = np.zeros(4)
    one = Indication("x", "µg", zero, zero, np.array([1.0, 5.0, 3.0, 9.0]), zero, zero[None])
    # deviations of 1, 1, 2, 2 about the two means, two degrees of freedom
    assert "x 2.2 µg; 2 directions visited 2 to 2 times, 2 deg" in repeatability([one], poses)
    assert "No pose was repeated" in repeatability([replace(one, after=zero[:2])], poses[:2])


@pytest.mark.parametrize(
    ("noise", "gravity", "text"),
    [
        (1.0, 0.0, "record the sequence 4 times"),
        (4.0, 1.0, "know gravity to 5 ppm (now 10), and record the sequence 4 times"),
        (0.0, 1.0, "know gravity to 5 ppm (now 10)"),
        (1.0, 1.0, "know gravity to 5 ppm (now 10), and record the sequence 4 times"),
    ],
)
def test_what_halves_U_halves_it(noise, gravity, text, plain):
    lines = (
        Line("noise of the record", "A", 0.0, "", "normal", 0.0, {"s.bias_x": noise}),
        Line("gravity", "B", 10.0, "ppm", "normal", 10.0, {"s.bias_x": gravity}),
    )
    (found,) = improvements(UncertaintyBudget(lines, {"s.bias_x": "m_s2"}), plain)
    assert found.next == text


def test_times_and_mountings_in_words():
    assert period(1_763_890_000.0, 1_763_890_754.6) == "from 2025-11-23 09:26:40 UTC, 12 min 34.6 s"
    assert period(3.0, 5.5) == "2.5 s"
    text = "identity; 350.5 s: Rx(90) Rz(180)"
    assert mounting(text, 50.5) == (
        "axes along those of the table; from 5 min 0.0 s on turned by 90° about x and turned by"
        " 180° about z"
    )


# --------------------------------------------------------------------------------------------------
# ---- the page


def test_the_page_has_every_section_and_every_parameter(written, plain):
    page = (written / "out.html").read_text(encoding="utf-8")
    assert re.findall("<h2>(.*?)</h2>", page) == list(SECTIONS)
    assert all(f"<td>{name}</td>" in page for name in plain.parameters)
    assert "Not in this file" not in page
    words = text_of(page)
    assert "serial A-17" in words
    assert "customer not stated" in words
    assert "Traceability of these references to the SI: not stated." in words
    assert "never" not in procedure(plain)
    assert "conform" not in words.lower()


def test_U_of_the_page_is_that_of_the_budget(good, written, capsys):
    capsys.readouterr()
    words = ["calibrate", good / "run.csv", "--scenario", good / "bench.toml", "--budget", "--json"]
    main([str(w) for w in (*words, "--method", "six_position")])
    budget = json.loads(capsys.readouterr().out)["budget"]
    found = quantities((written / "out.xml").read_text(encoding="utf-8"))
    assert set(found) == set(budget["expanded"])
    for name, (_, _, u) in found.items():
        assert u == pytest.approx(budget["expanded"][name], rel=1e-12)
    page = (written / "out.html").read_text(encoding="utf-8")
    name = "accel.scale_x"
    row = re.search(
        rf"<tr><td>{name}</td><td class=\"n\">([^<]+)</td><td class=\"n\">([^<]+)</td>", page
    )
    assert row
    assert float(row[2]) == pytest.approx(budget["expanded"][name] * 1e6, rel=0.05)


def test_the_page_stands_alone(written):
    page = (written / "out.html").read_text(encoding="utf-8")
    assert not re.search(r'https?:|src="(?!data:)|href="(?!#)|@import|url\((?!#)|<script', page)
    for part in ('name="viewport"', "prefers-color-scheme: dark", "@media print", "@page"):
        assert part in page
    assert len(re.findall("<table", page)) == len(re.findall('<div class="wide"><table', page))


@pytest.mark.parametrize("name", ["out.html"])
def test_the_page_prints_on_two_sides(written, name, tmp_path):
    chromium = shutil.which("chromium") or shutil.which("chromium-browser")
    if chromium is None:
        pytest.skip("no Chromium to print with")
    words = ["--headless", "--no-sandbox", "--disable-gpu", f"--user-data-dir={tmp_path}"]
    words += [f"--print-to-pdf={tmp_path / 'out.pdf'}", (written / name).as_uri()]
    subprocess.run([chromium, *words], capture_output=True, check=True, timeout=60)
    pages = re.findall(rb"/Type\s*/Page\b", (tmp_path / "out.pdf").read_bytes())
    assert 1 <= len(pages) <= 2


def test_without_the_recording_the_page_says_what_it_lacks(good, here, plain):
    assert main(["certificate", str(good / "CAL.json"), "-o", "out.html"]) == 0
    words = text_of((here / "out.html").read_text(encoding="utf-8"))
    assert words.count("Not in this file") == 2
    assert "To halve U" not in words
    assert "The measured error at the poses is not in this file." in words
    assert "noise of the record only (type A)" in words
    assert "Temperature during the measurement: not stated." in words
    made = make_certificate(plain)
    assert made.expanded["accel.bias_x"] == 2 * plain.parameters["accel.bias_x"].sigma
    (tilt,) = made.tilts
    assert tilt.after < 0.05 * tilt.before


MEANS = """\
label,accel_x_m_s2,accel_y_m_s2,accel_z_m_s2,accel_sigma_m_s2
+x,9.9,0.01,0.02,0.0001
-x,-9.7,0.011,0.021,0.0001
+y,0.1,9.81,0.02,0.0001
-y,0.1,-9.79,0.02,0.0001
+z,0.1,0.01,9.83,0.0001
-z,0.1,0.01,-9.78,0.0001
"""


def test_where_no_budget_can_be_evaluated_the_page_says_why(good, here, capsys):
    # a table's errors have no meaning for means without its readout
    (here / "means.csv").write_text(MEANS)
    words = ["calibrate", "means.csv", "--scenario", str(good / "bench.toml")]
    words += ["--method", "six_position"]
    assert main([*words, "--report", "o.html"]) in (0, 1)
    page = text_of((here / "o.html").read_text(encoding="utf-8"))
    assert "Not evaluated: a note below states the cause." in page
    assert "could not be evaluated: budget, table_levelling: found a hand-held" in page
    assert "noise of the record only (type A)" in page
    capsys.readouterr()
    assert main([*words, "--budget"]) == 2  # who asks for the budget itself is refused
    assert main([*words, "--method", "nosuch", "--report", "p.html"]) == 2
    assert not (here / "p.html").exists()


def test_sources_that_nobody_stated_are_called_assumed(good, here, written):
    assert "sizes are assumed" in text_of((written / "out.html").read_text(encoding="utf-8"))
    stated = '[[budget]]\nid = "gravity"\ngravity_ppm = 10\n'
    bench = (good / "bench.toml").read_text(encoding="utf-8")
    (here / "b.toml").write_text(bench + stated, encoding="utf-8")
    words = ["calibrate", str(good / "run.csv"), "--scenario", "b.toml", "--report", "o.html"]
    assert main([*words, "--method", "six_position"]) == 0
    page = text_of((here / "o.html").read_text(encoding="utf-8"))
    assert "assumed" not in page
    assert "the stated sources (type B)" in page


def test_the_tilt_error_before_is_the_injected_one(plain):
    (tilt,) = make_certificate(plain).tilts
    # bias 3000 and -1500 ug, scale_z 1200 ppm: rms over the sphere
    rng = np.random.default_rng(1)
    up = rng.normal(size=(100_000, 3))
    up /= np.linalg.norm(up, axis=1)[:, None]
    reading = up * [1, 1, 1.0012] + np.array([3000e-6, -1500e-6, 0]) * G0 / 9.80123
    reading /= np.linalg.norm(reading, axis=1)[:, None]
    angle = np.arccos(np.clip((reading * up).sum(axis=1), -1, 1))
    assert tilt.before == pytest.approx(np.sqrt(np.mean(angle**2)) / ARCSEC, rel=0.01)


@pytest.mark.parametrize("verdict", ["suspect", "cannot_tell"])
def test_a_calibration_that_is_not_good_says_so_first(plain, verdict):
    page = certificate_page(make_certificate(replace(plain, verdict=verdict)))
    word = verdict.replace("_", " ")
    assert f"Verdict {word}: do not apply this result." in page
    assert f"The verdict is {word}" in page
    assert "Verdict" not in certificate_page(make_certificate(plain))


def test_a_simulated_recording_certifies_no_instrument(plain):
    assert "certifies no instrument" in certificate_page(make_certificate(plain))
    real = {k: v for k, v in plain.provenance.items() if k != "seed"}
    page = certificate_page(make_certificate(replace(plain, provenance=real)))
    assert "certifies no instrument" not in page


def test_hostile_words_stay_text(good, here, schema):
    text = (good / "run.csv").read_text(encoding="utf-8")
    label = HOSTILE.replace('"', '""')
    (here / "run.csv").write_text(text.replace(',"+z"', f',"{label}"'), encoding="utf-8")
    words = ["calibrate", "run.csv", "--scenario", str(good / "bench.toml"), "--report", "o.html"]
    words += ["--method", "six_position", "--dcc", "o.xml", "--date", "2026-11-23"]
    for option in ("--instrument", "--laboratory", "--customer", "--person", "--number"):
        words += [option, f"{HOSTILE}\x00\x0b]]> "]
    assert main([*words, "--traceability", HOSTILE]) in (0, 1)
    page = (here / "o.html").read_text(encoding="utf-8")
    assert "<script" not in page
    assert page.count("&lt;script&gt;alert(1)") >= 7
    assert "<td>&lt;script&gt;alert(1)" in page  # the label
    schema.validate(str(here / "o.xml"))
    assert HOSTILE in ET.parse(here / "o.xml").findtext(".//dcc:uniqueIdentifier", "", NS)


def test_what_was_not_tested_follows_from_the_parameters(plain):
    words = " ".join(not_tested(plain))
    assert "Temperature" in words
    assert "second order was tested, not determined" in words
    assert "Cross-axis" not in words
    more = dict(plain.parameters) | {"accel.K2_x": plain.parameters["accel.bias_x"]}
    bigger = replace(plain, parameters=more, covariance=np.eye(len(more)))
    assert "Non-linearity" not in " ".join(not_tested(bigger))
    few = Calibration("norm", "good", {}, np.zeros((0, 0)))
    words = " ".join(not_tested(few))
    assert "Orientation of the axes in the case" in words
    assert "Cross-axis" in words


@pytest.mark.parametrize("method", ["six_position", "thermal", "gyro_rates"])
def test_a_procedure_is_implemented_never_conformed_to(plain, method):
    words = procedure(replace(plain, method=method))
    assert "mplements the procedure of IEEE" in words
    assert "conform" not in words


# --------------------------------------------------------------------------------------------------
# ---- the DCC


def test_the_dcc_is_valid_and_holds_every_parameter_in_SI(written, schema, plain):
    schema.validate(str(written / "out.xml"))
    found = quantities((written / "out.xml").read_text(encoding="utf-8"))
    assert set(found) == set(plain.parameters)
    for name, e in plain.parameters.items():
        value, unit, u = found[name]
        assert value == e.value
        assert unit == (r"\metre\second\tothe{-2}" if "bias" in name else r"\one")
        assert u >= 2 * e.sigma


def test_the_schema_refuses_a_dcc_that_lacks_a_part(written, schema):
    root = ET.parse(written / "out.xml").getroot()
    core = root.find(".//dcc:coreData", NS)
    core.remove(core.find("dcc:beginPerformanceDate", NS))
    assert not schema.is_valid(root)


METHODS = {
    "placing_table_one_axis": "placing_table",
    "thermal_six_faces": "thermal",
    "two_position_level": "two_position",
    "designed_K2_K3": "six_position",
    "gyro_rates_three": "gyro_rates",
}


@pytest.mark.parametrize("name", METHODS)
def test_the_dcc_and_the_page_of_every_kind_of_result(name, schema):
    scenario = load_scenario(folder("scenarios") / f"{name}.toml")
    log = SimulatedLaboratory().record(scenario, 4)
    options = next((dict(m.options) for m in scenario.method if m.name == METHODS[name]), {})
    found = calibrate(METHODS[name], log, scenario, **options)
    made = make_certificate(found, DAY, log)
    text = dcc_text(made)
    schema.validate(text)
    assert set(quantities(text)) == set(found.parameters)
    assert re.findall("<h2>(.*?)</h2>", certificate_page(made)) == list(SECTIONS)
    lists = ET.fromstring(text).findall(".//si:valueXMLList", NS)
    lengths = [len(e) for e in found.bias_tables.values() for _ in range(2)]
    assert [len((v.text or "").split()) for v in lists] == lengths


def test_an_independent_reader_reads_the_dcc_back(written, plain, monkeypatch):
    # pydcc needs it for signatures only, and its library does not know every OpenSSL
    names = ("CertificateValidator", "ValidationContext", "errors")
    stand_in = types.ModuleType("certvalidator")
    vars(stand_in).update(dict.fromkeys(names))
    monkeypatch.setitem(sys.modules, "certvalidator", stand_in)
    dcc = pytest.importorskip("dcc", reason="pydcc is not installed")
    # its own validator fetches schemas from the network
    monkeypatch.setattr("dcc.dcc.DCCXMLValidator", lambda: None)
    read = dcc.DCC(str(written / "out.xml"), signature_verification=False)
    assert read.is_loaded()
    assert read.version() == "3.2.1"
    assert read.mandatory_language() == "en"
    assert read.calibration_laboratory_name() == "not stated"
    assert f"{read.calibration_date():%Y-%m-%d}" == "2026-11-23"
    assert read.item_id()["identifications"]["identification"]["value"] == "A-17"
    results = read.get_calibration_results("name", lang="en")
    found = {entry["real"]["label"]: entry["real"] for _, entry in results}
    assert set(found) == set(plain.parameters)
    for name, e in plain.parameters.items():
        assert float(found[name]["value"]) == e.value
        assert float(found[name]["expandedUnc"]["coverageFactor"]) == 2
        assert float(found[name]["expandedUnc"]["uncertainty"]) >= 2 * e.sigma


def test_a_unit_without_SI_form_is_written_in_words(plain, schema):
    name = "accel.bias_x"
    odd = {**plain.parameters, name: replace(plain.parameters[name], unit="furlong")}
    text = dcc_text(make_certificate(replace(plain, parameters=odd), DAY))
    schema.validate(text)
    assert name not in quantities(text)
    assert "furlong" in text


# --------------------------------------------------------------------------------------------------
# ---- refusals


@pytest.mark.parametrize(
    ("words", "said"),
    [
        ((), "found neither -o nor --dcc"),
        (("--dcc", "o.xml"), "need one: the schema requires it"),
        (("--dcc", "o.xml", "--date", "23.11.2026"), "need a day as YYYY-MM-DD"),
        (("-o", "o.html", "--issued", "20261123"), "need a day as YYYY-MM-DD"),
        (("-o", "o.html", "--country", "Germany"), "need two capital letters"),
    ],
)
def test_refusals_write_nothing(good, here, capsys, words, said):
    assert main(["certificate", str(good / "CAL.json"), *words]) == 2
    assert said in capsys.readouterr().err
    assert list(here.iterdir()) == []


def test_a_dcc_without_a_day_is_refused_before_the_work(good, here, capsys):
    words = ["calibrate", str(good / "run.csv"), "--scenario", str(good / "bench.toml")]
    assert main([*words, "--method", "six_position", "-o", "C.json", "--dcc", "o.xml"]) == 2
    assert "add --date YYYY-MM-DD" in capsys.readouterr().err
    assert list(here.iterdir()) == []


def test_a_calibration_without_its_setup_is_refused(plain):
    bare = replace(plain, provenance={})
    with pytest.raises(TiltcalError, match=r"found no provenance\.setup"):
        make_certificate(bare)


@pytest.mark.usefixtures("here")
def test_the_answer_of_the_command_as_json(good, capsys):
    capsys.readouterr()
    words = ["-o", "o.html", "--dcc", "o.xml", "--date", "2026-11-23", "--number", "N 1", "--json"]
    assert main(["certificate", str(good / "CAL.json"), *words]) == 0
    answer = json.loads(capsys.readouterr().out)
    assert answer == {"number": "N 1", "verdict": "good", "written": ["o.html", "o.xml"]}
