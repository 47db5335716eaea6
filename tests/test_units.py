"""One policy of units: what a number is shown in."""

from pathlib import Path

import pytest

from tiltcal.cli import main
from tiltcal.core.units import ARCSEC, DEG_H, G0, readable_unit, signs_in, unit_sign


@pytest.mark.parametrize(
    ("unit", "column", "factor", "shown"),
    [
        ("m_s2", None, 1e6 / G0, "ug"),
        ("m_s2", "g", 1e6 / G0, "ug"),
        ("m_s2", "mg", 1e3 / G0, "mg"),
        ("m_s2_degC2", "mg", 1e3 / G0, "mg_degC2"),
        ("m_s2", "LSB", 1e6 / G0, "ug"),
        ("rad", "arcsec", 1 / ARCSEC, "arcsec"),
        ("rad_s", "deg_s", 1 / DEG_H, "deg_h"),
        ("1", "mg", 1e6, "ppm"),
        ("ug_g2", "mg", 1.0, "ug_g2"),
        ("degC", None, 1.0, "degC"),
    ],
)
def test_the_column_decides_where_it_is_fine_enough(unit, column, factor, shown):
    found, name = readable_unit(unit, column)
    assert name == shown
    assert found == pytest.approx(factor, rel=1e-12)


def test_signs_in_reports():
    texts = [unit_sign(u) for u in ("ug", "deg_h", "mg_degC1", "ppm_degC2", "arcsec_degC")]
    assert texts == ["µg", "°/h", "mg/°C", "ppm/°C²", "arcsec/°C"]
    assert [unit_sign(u) for u in ("ug_g3", "deg_h_g", "furlong_x")] == [
        "µg/g³",
        "°/h/g",
        "furlong_x",
    ]
    assert signs_in("K2_x 3 ug/g2, 4 deg/h off") == "K2_x 3 µg/g², 4 °/h off"


@pytest.mark.parametrize(("column", "unit"), [("mg", "mg"), ("g", "ug"), ("m_s2", "ug")])
@pytest.mark.usefixtures("here")
def test_calibrate_prints_biases_in_the_unit_of_the_file(column, unit, good, capsys):
    text = (good / "bench.toml").read_text()
    kind = 'kind = "accelerometer"'
    Path("bench.toml").write_text(text.replace(kind, f'{kind}\nunit = "{column}"'))
    assert main(["simulate", "bench.toml", "-o", "run.csv"]) == 0
    assert f"accel_x_{column}" in Path("run.csv").read_text()
    capsys.readouterr()
    main(["calibrate", "run.csv", "--scenario", "bench.toml", "--method", "six_position"])
    found = capsys.readouterr().out
    row = next(line for line in found.splitlines() if "accel.bias_x" in line)
    assert f" {unit} " in row
    assert f" {unit} (whole directions held out)" in found
