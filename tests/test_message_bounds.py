"""Inputs that ask for endless work or that no library takes end at once, with one short message."""

import pytest
from scenario_files import BENCH_SCENARIO

from tiltcal.cli import _unexpected, main
from tiltcal.core.errors import MOST_FOUND, TiltcalError
from tiltcal.core.safe_text import shortened
from tiltcal.laboratory.own_model import ModelAxis, ModelReference
from tiltcal.recordings.proposal.rests import windows_of
from tiltcal.setup.chain import Link
from tiltcal.validation.campaign.factors import Factor
from tiltcal.validation.campaign.folder import Shard
from tiltsim.model_reader import MOST_BODIES, check_files, read_model, require_inside

ARM = """<mujoco><worldbody><body><joint name="lift"/><geom size="1"/>
<replicate count="{outer}" offset="1 0 0"><replicate count="{inner}" offset="0 1 0">
<geom size="1"/></replicate></replicate></body></worldbody></mujoco>"""


@pytest.mark.parametrize(("outer", "inner"), [(10**9, 1), (1000, 1000), (" +999999 ", 1)])
def test_copies_without_end_are_refused_before_mujoco_makes_them(outer, inner, tmp_path):
    (tmp_path / "arm.xml").write_text(ARM.format(outer=outer, inner=inner))
    with pytest.raises(TiltcalError, match=rf"copies, need at most {MOST_BODIES}"):
        check_files(tmp_path / "arm.xml", tmp_path)


def test_a_few_copies_are_taken(tmp_path):
    (tmp_path / "arm.xml").write_text(ARM.format(outer=20, inner=20))
    check_files(tmp_path / "arm.xml", tmp_path)
    (tmp_path / "arm.xml").write_text(ARM.format(outer="\u00b2", inner="9" * 5000))
    check_files(tmp_path / "arm.xml", tmp_path)  # no numbers: MuJoCo says so
    deep = "<body>" * 5000 + "</body>" * 5000
    (tmp_path / "arm.xml").write_text(f"<mujoco><worldbody>{deep}</worldbody></mujoco>")
    check_files(tmp_path / "arm.xml", tmp_path)


LARGE = {
    '<asset><hfield name="h" nrow="20000" ncol="20000" size="1 1 1 1"/></asset>': "nrow x ncol",
    '<asset><texture name="t" builtin="flat" width="30000" height="30000"/></asset>': "width",
    '<size nkey="100000000"/>': "nkey",
    '<size nuserdata="1000000000"/>': "nuserdata",
    '<worldbody><flexcomp name="f" type="grid" count="200 200 10"/></worldbody>': "copies",
    "<worldbody>" + "<geom size='.1'/>" * 25000 + "</worldbody>": "elements",
}


@pytest.mark.parametrize("text", LARGE, ids=LARGE.values())
def test_sizes_without_end_are_refused_before_mujoco_makes_them(text, tmp_path):
    (tmp_path / "arm.xml").write_text(f"<mujoco>{text}</mujoco>")
    with pytest.raises(TiltcalError, match=rf"more than \d+ {LARGE[text]}.*leave out"):
        check_files(tmp_path / "arm.xml", tmp_path)


def test_ordinary_sizes_are_taken(tmp_path):
    text = """<size nkey="100" memory="100M" nuser_geom="3"/><asset>
    <hfield name="h" nrow="500" ncol="500" size="1 1 1 1"/>
    <texture name="t" builtin="flat" width="4096" height="4096"/></asset>
    <worldbody><flexcomp name="f" type="grid" count="8 8 2"/></worldbody>"""
    (tmp_path / "arm.xml").write_text(f"<mujoco>{text}</mujoco>")
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


def test_a_cell_that_never_ends_leaves_what_to_do_in_sight(tmp_path, capsys):
    """A quote that is not closed takes the rest of the file into its cell."""
    rows = "".join(f"{k / 10},0.1,9.8\n" for k in range(1000))
    (tmp_path / "still.csv").write_text(f'time_s,accel_x_g,accel_z_g\n0,0.1,"{rows}')
    assert main(["noise", str(tmp_path / "still.csv")]) == 2
    told = capsys.readouterr().err
    assert told.count("\n") == 1
    assert told.endswith("need a number or an empty cell; correct or empty that cell\n")


def test_of_all_that_was_found_a_message_tells_as_much_as_leaves_the_rest_in_sight():
    told = str(TiltcalError("map", found="word " * 10_000, need="less", do="cut it"))
    assert len(told) < 2 * MOST_FOUND
    assert told.endswith("..., need less; cut it")


@pytest.mark.parametrize(
    "words",
    [
        ["serve", "bench.toml", "--host", "h" * 300],
        ["serve", "bench.toml", "--udp", "a..b:5"],
        ["serve", "bench.toml", "--udp", "127.0.0.1:\u00b2"],
        ["record", "127.0.0.1:" + "9" * 5000, "sequence.csv", "out.csv"],
    ],
)
def test_names_and_numbers_that_none_can_be_are_refused(words, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "bench.toml").write_text(BENCH_SCENARIO)
    (tmp_path / "sequence.csv").write_text("step,action,outer_deg,dwell_s\n1,move,15,1\n")
    assert main(words) == 2
    told = capsys.readouterr().err
    assert "internal" not in told
    assert len(told) < 400


@pytest.mark.parametrize("text", ["1/" + "9" * 5000, "\u00b2/\u00b2", "1/2/3", "3/2", "0/1", ""])
def test_a_part_of_a_campaign_is_a_whole_number_of_them(text):
    with pytest.raises(TiltcalError, match="need i/n with i from 1 to n"):
        Shard.of(text)


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("size", [1e-202, 1e-160])
def test_readings_whose_powers_vanish_have_no_noise(size, tmp_path, capsys, rng):
    rows = "".join(f"{k / 10},{x}\n" for k, x in enumerate(size * rng.standard_normal(200)))
    (tmp_path / "still.csv").write_text(f"time_s,accel_x_g\n{rows}")
    assert main(["noise", str(tmp_path / "still.csv")]) == 2
    assert "its reading never changes" in capsys.readouterr().err


@pytest.mark.filterwarnings("error")
def test_readings_whose_powers_are_no_numbers_do_not_count_at_rest(rng):
    values = rng.standard_normal((200, 3))
    values[::50] = 1e308
    assert windows_of(values, 10.0).noise < 2


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("rate_deg_s = 90", "rate_deg_s = 1e-308", "found work of inf rows"),
        ("gravity_m_s2 = 9.80123", "gravity_m_s2 = 1e300", "site.gravity_m_s2"),
    ],
)
def test_a_scenario_that_no_recording_can_be_of_is_refused(old, new, said, tmp_path, capsys):
    assert old in BENCH_SCENARIO
    (tmp_path / "bench.toml").write_text(BENCH_SCENARIO.replace(old, new))
    assert main(["simulate", str(tmp_path / "bench.toml"), "-o", str(tmp_path / "out.csv")]) == 2
    told = capsys.readouterr().err
    assert said in told
    assert "TRACEBACK" not in told


@pytest.mark.parametrize(
    "words",
    [
        ["noise", "long.csv"],
        ["simulate", "long.toml", "-o", "out.csv"],
        ["campaign", "long.toml", "-o", "out"],
        ["compare", "long.json", "long.json"],
        ["import", "log.csv", "--map", "long.toml", "-o", "out.csv"],
    ],
)
def test_what_is_longer_than_any_memory_is_refused_at_once(words, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "log.csv").write_text("a\n1\n")
    for word in words:
        if word.startswith("long"):
            with (tmp_path / word).open("wb") as file:
                file.truncate(1 << 36)
    assert main(words) == 2
    told = capsys.readouterr().err
    assert "68719476736 bytes" in told or "characters and more" in told


def test_links_in_a_circle_are_no_model(tmp_path):
    (tmp_path / "arm.xml").symlink_to("arm.xml")
    with pytest.raises(TiltcalError, match="no such file"):
        require_inside(tmp_path, tmp_path / "arm.xml", "arm.xml")


def test_what_mujoco_refuses_leaves_no_file_of_its_own(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    part = '<worldbody><geom size="nan"/></worldbody>'
    (tmp_path / "arm.xml").write_text(f"<mujoco>{part}</mujoco>")
    text = ModelReference(mjcf="arm.xml", site="tool", axes={"pan": ModelAxis(joint="pan")})
    with pytest.raises(TiltcalError, match="nan size in geom"):
        read_model(text, tmp_path, ())
    assert [p.name for p in tmp_path.iterdir()] == ["arm.xml"]
