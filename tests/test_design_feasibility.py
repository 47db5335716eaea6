"""Wishes that no sequence can grant: exit status 2, in words, the parameter named."""

from pathlib import Path

import numpy as np
import pytest
from scenario_files import BENCH_SCENARIO, refusal

from tiltcal.core.errors import TiltcalError
from tiltcal.design.gradient_search import Problem
from tiltcal.design.polynomial import textbook_model
from tiltcal.design.time_budget import Clock


@pytest.fixture
def bench(tmp_path: Path) -> Path:
    (tmp_path / "bench.toml").write_text(BENCH_SCENARIO)
    (tmp_path / "vertical.toml").write_text(
        BENCH_SCENARIO.replace('table = "dual"', 'table = "vertical"').split("[[sequence]]")[0]
    )
    (tmp_path / "gyro.toml").write_text(
        'schema = 1\n[site]\ngravity_m_s2 = 9.8\nlatitude_deg = 40.0\n[rig]\ntable = "dual"\n'
        '[[sensor]]\nname = "gyro"\nkind = "gyro"\n'
    )
    return tmp_path


WISHES = {
    "a budget shorter than one pose": (
        ["--budget-s", "9"],
        ("9 s", "10 s for one pose", "accel.bias_x"),
    ),
    "an effect that shows in motion only": (
        ["--terms", "bias", "acc_bandwidth"],
        ("acc_bandwidth", "no pose can see"),
    ),
    "an effect of approach": (["--terms", "table_backlash"], ("table_backlash", "no pose can see")),
    "temperature where there is none": (
        ["--terms", "bias", "temp_bias"],
        ("acc_temp_bias", "temperature change"),
    ),
    "mount and cross-axis at once": (
        ["--terms", "cross_axis", "mount_misalignment"],
        ("mount_misalignment", "no set of poses"),
    ),
    "a forbidden angle needed": (
        ["--terms", "scale", "cross_axis", "--angles", "inner=0:0"],
        ("accel.", "within the allowed angles", "inner"),
    ),
    "no angle at all": (
        ["--terms", "scale", "bias", "--angles", "outer=0:0"],
        ("within the allowed angles", "outer"),
    ),
    "an unknown term": (["--terms", "acc_k2"], ("acc_k2", "acc_K2")),
    "another unknown term": (["--terms", "skale"], ("skale",)),
    "an unknown criterion": (["--criterion", "E"], ("criterion: found 'E'", "both, tilt, D, A, I")),
    "an unknown sensor": (["--sensor", "incl"], ("named incl",)),
    "angles that do not read": (["--angles", "outer=90"], ("--angles outer=90",)),
    "angles of an axis that is not there": (
        ["--angles", "middle=0:90"],
        ("--angles middle=0:90", "outer, inner"),
    ),
    "a start beyond the angles": (
        ["--angles", "outer=10:90", "--from", "outer=5"],
        ("axis outer", "found 5 deg", "10 to 90 deg"),
    ),
    "a start that does not read": (["--from", "outer"], ("--from outer",)),
    "no step within the angles": (
        ["--angles", "outer=11:14", "--step-deg", "5"],
        ("axis outer", "no multiple of 5 deg from 11 to 14 deg"),
    ),
    "a negative rate": (["--rate-deg-s", "-1"], ("rate",)),
    "a negative settling": (["--settle-s", "-1"], ("settling",)),
    "dwells exchanged": (["--dwell-s", "60", "5"], ("longest 5 s, shortest 60 s",)),
    "few poses with all effects observable": (
        ["--all-effects-observable", "4"],
        ("4 poses", "scale and cross-axis terms absorb all"),
    ),
    "all effects observable, of what nobody knows": (
        ["--all-effects-observable", "24", "--terms", "acc_K9"],
        ("effect: found 'acc_K9'",),
    ),
    "all effects observable, where all is ordinary": (
        ["--all-effects-observable", "24", "--terms", "mount_misalignment"],
        ("no effect that these poses show in addition to bias",),
    ),
    "all effects observable, in no time": (
        ["--all-effects-observable", "24", "--budget-s", "200"],
        ("200 s", "24 poses"),
    ),
    "only nuisances": (["--terms", "drift"], ("acc_drift",)),
}


@pytest.mark.parametrize("wish", WISHES)
def test_what_cannot_be_had_is_said_with_its_name(wish, bench, capsys):
    options, words = WISHES[wish]
    message = refusal(["design", bench / "bench.toml", *options], bench, capsys)
    for word in words:
        assert word in message, message


def test_a_table_about_the_vertical_tells_nothing_of_an_accelerometer(bench, capsys):
    assert "table vertical" in refusal(["design", bench / "vertical.toml"], bench, capsys)


def test_a_gyro_is_calibrated_by_turns(bench, capsys):
    assert "no accelerometer or inclinometer" in refusal(
        ["design", bench / "gyro.toml"], bench, capsys
    )


def test_a_design_needs_something_to_design_for(bench, capsys):
    assert "neither SCENARIO nor --textbook" in refusal(["design"], bench, capsys)
    assert (
        "textbook model: found 'kubic', need one of linear, K2, K2K3, quadratic, cubic; did you"
        " mean 'cubic'?" in refusal(["design", "--textbook", "kubic"], bench, capsys)
    )


def test_the_library_refuses_in_the_same_words():
    with pytest.raises(TiltcalError, match="textbook model: found 'quartic'"):
        textbook_model("quartic", True, 300)
    with pytest.raises(
        TiltcalError, match="criterion: found 'G', need one of both, tilt, D, A, I; correct it"
    ):
        Problem(textbook_model("linear", True, 300), Clock(300), "G")
    with pytest.raises(TiltcalError, match="budget"):
        Clock(np.nan)


def test_a_classic_sequence_that_is_none_is_named():
    from tiltcal.design.classic import classic

    with pytest.raises(TiltcalError, match="sequence: found 'seven'"):
        classic("seven")


def test_rounding_takes_no_sequence_beyond_its_budget():
    """The sums of some dwells that fill a budget are rounded up."""
    rng, clock = np.random.default_rng(3), Clock(120.0)
    beyond = 0
    for _ in range(300):
        angles = rng.uniform(-1.0, 1.0, (int(rng.integers(3, 9)), 2))
        share = rng.dirichlet(np.ones(len(angles)))
        dwell = clock.shortest + clock.spare(angles) * share
        beyond += clock.total(angles, dwell) > clock.budget
        kept = clock.shortened(angles, dwell)
        assert clock.total(angles, kept) <= clock.budget
        np.testing.assert_allclose(kept, dwell, rtol=1e-11)
    assert beyond > 10
