"""Figures of reports as files: the same plots as in the page."""

import numpy as np
import pytest

from tiltcal.cli import main
from tiltcal.core.assets import folder
from tiltcal.report.figures import drawn, inline_svg
from tiltcal.report.plots import LOGARITHMIC, Plot, axes, line, points

SCENARIO = str(folder("scenarios") / "six_faces_dual.toml")


def plot(**layout):
    x = np.linspace(1, 10, 20)
    traces = [
        line(x, x**2, "$law$ <b>", 0),
        points(x, x**2 + 1, "measured", 1, sigma=np.full(20, 3.0)),
    ]
    return Plot(traces, "A law.", "y over x", axes("x, s", "y, µg") | layout)


def test_a_plot_is_drawn_with_its_names_as_text():
    text = drawn(plot(), "svg").decode()
    assert "$law$ &lt;b&gt;" in text
    assert "y, µg" in text
    assert drawn(plot(), "pdf").startswith(b"%PDF")
    assert drawn(plot(), "svg") == drawn(plot(), "svg")  # the same file again


def test_a_logarithmic_axis_has_plain_numbers():
    made = plot()
    made.layout["yaxis"].update(LOGARITHMIC)
    text = drawn(made, "svg").decode()
    assert "mathdefault" not in text
    assert ">50<" in text


def test_in_a_page_it_has_the_colours_of_the_page():
    text = inline_svg(plot(), 80, 3)
    assert text.startswith("<svg")
    assert "var(--c0)" in text
    assert "#2b6cb0" not in text
    assert 'id="still3-figure_1"' in text
    assert "http" not in text


@pytest.mark.parametrize("words", [["--figures", "figures"], ["--figures=figures"]])
def test_every_report_of_a_command_gives_its_figures(words, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert main([*words, "design", SCENARIO, "--budget-s", "100", "-o", "out"]) == 0
    names = sorted(p.name for p in (tmp_path / "figures").iterdir())
    assert names[:2] == ["design-01.pdf", "design-01.svg"]
    assert len(names) % 2 == 0
    assert f"figures: {len(names)} files of figures" in capsys.readouterr().err


def test_a_command_without_a_report_says_so(capsys):
    assert main(["methods", "--figures", "f"]) == 2
    assert "found no report with a figure" in capsys.readouterr().err
    assert main(["methods", "--figures"]) == 2
    assert "--figures: found no folder" in capsys.readouterr().err
