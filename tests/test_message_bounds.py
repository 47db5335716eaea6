"""Inputs that ask for endless work or that no library takes end at once, with one short message."""

import pytest
from scenario_files import BENCH_SCENARIO

from tiltcal.cli import _unexpected, main
from tiltcal.core.errors import TiltcalError
from tiltcal.core.safe_text import shortened
from tiltcal.setup.chain import Link
from tiltcal.validation.campaign.factors import Factor
from tiltsim.model_reader import MOST_BODIES, check_files

ARM = """<mujoco><worldbody><body><joint name="lift"/><geom size="1"/>
<replicate count="{outer}" offset="1 0 0"><replicate count="{inner}" offset="0 1 0">
<geom size="1"/></replicate></replicate></body></worldbody></mujoco>"""


@pytest.mark.parametrize(("outer", "inner"), [(10**9, 1), (1000, 1000)])
def test_copies_without_end_are_refused_before_mujoco_makes_them(outer, inner, tmp_path):
    (tmp_path / "arm.xml").write_text(ARM.format(outer=outer, inner=inner))
    with pytest.raises(TiltcalError, match=rf"copies, need at most {MOST_BODIES}"):
        check_files(tmp_path / "arm.xml", tmp_path)


def test_a_few_copies_are_taken(tmp_path):
    (tmp_path / "arm.xml").write_text(ARM.format(outer=20, inner=20))
    check_files(tmp_path / "arm.xml", tmp_path)


def test_a_level_that_stands_twice_is_named():
    with pytest.raises(ValueError, match="the value 0 stands twice"):
        Factor(field="effect.acc_bias.bias_x_ug", values=[0, 5, 0])


def test_a_value_that_no_model_takes_is_named_without_a_library_s_own_words():
    with pytest.raises(ValueError, match="axis") as caught:
        Link(axis="\u00e9", slides=False)
    told = _unexpected(caught.value)
    assert told.startswith("input, axis: found a wrong value")
    assert "pydantic" not in told


def test_a_giant_value_is_not_echoed_whole():
    told = shortened(f"option --host: found {'h' * 100_000}, need a name of a machine")
    assert len(told) < 300
    assert told.endswith("need a name of a machine")
    assert shortened(f"lab {'a' * 5000}: found no file").endswith("...: found no file")


def test_a_giant_option_ends_in_one_short_message(tmp_path, capsys):
    (tmp_path / "bench.toml").write_text(BENCH_SCENARIO)
    words = ["simulate", str(tmp_path / "bench.toml"), "--seed", "1", "-o", "x" * 90_000]
    assert main(words) == 2
    assert len(capsys.readouterr().err) < 1000
