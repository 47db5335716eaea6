"""Arguments in every form that the documentation and shells allow."""

import pytest

from tiltcal.cli import app, main
from tiltcal.cli.calibrate import parse_options
from tiltcal.cli.commands import COMMANDS
from tiltcal.cli.design_options import axis_limits
from tiltcal.cli.options import DEFAULT_BUDGET
from tiltcal.core.errors import TiltcalError


def parsed(line):
    """Keyword arguments and positional arguments of a command line."""
    words = [word.replace("~", " ") for word in line.split()]
    _, bound, _ = app.make_app().parse_args(words, exit_on_error=False, print_error=False)
    bound.apply_defaults()
    return {
        name: [str(v) for v in value] if name == "recordings" else value
        for name, value in bound.arguments.items()
    }


DIAGNOSE = {
    "options last": "diagnose a.csv b.csv --scenario s.toml -o out --check --static c.csv",
    "options first": "diagnose --scenario s.toml --check --static c.csv -o out a.csv b.csv",
    "around": "diagnose --check --scenario s.toml a.csv b.csv --static=c.csv --output out",
    "equals": "diagnose a.csv b.csv --scenario=s.toml --output=out --check --static=c.csv",
}


@pytest.mark.parametrize("form", DIAGNOSE)
def test_options_stand_before_or_after_the_recordings(form):
    found = parsed(DIAGNOSE[form])
    assert found.pop("recordings") == ["a.csv", "b.csv"]
    assert found.pop("allowed") == DEFAULT_BUDGET
    assert {name: str(value) for name, value in found.items()} == {
        "scenario": "s.toml",
        "static": "c.csv",
        "check": "True",
        "output": "out",
        "as_json": "False",
    }


def test_two_positionals_may_have_an_option_between_them():
    found = parsed("correct CAL.json -o out.csv run.csv")
    assert [str(found[name]) for name in ("calibration_file", "recording", "output")] == [
        "CAL.json",
        "run.csv",
        "out.csv",
    ]


def test_an_option_of_a_method_may_be_repeated_and_hold_any_text():
    found = parsed(
        "calibrate r --scenario s --method m --option terms=['bias',~'K2'] --option x=-1"
    )
    assert found["option"] == ("terms=['bias', 'K2']", "x=-1")


def test_the_last_of_a_repeated_single_value_counts():
    assert parsed("simulate s.toml --seed 1 --seed 2")["seed"] == 2


@pytest.mark.parametrize("words", ["--latitude -33.5", "--latitude=-33.5", "--latitude -3.35e1"])
def test_a_negative_number_is_a_value(words):
    assert parsed(f"init {words}")["latitude"] == -33.5


def test_options_with_several_values_take_all_that_follow():
    found = parsed(
        "design b.toml --terms bias scale --terms K2 --dwell-s 4 9 --angles outer=-90:90"
        " --angles inner=0:45 --nuisance none"
    )
    assert found["aim"].terms == ("bias", "scale", "K2")
    assert found["aim"].nuisance == ("none",)
    assert found["table"].dwell_s == (4, 9)
    assert found["table"].angles == ("outer=-90:90", "inner=0:45")
    assert found["aim"].grade == "mid_mems"


def test_the_second_scenario_of_a_design_is_the_diagnosed_one():
    found = parsed("design --split out/diagnosis.json --scenario s.toml --recordings a b")
    assert str(found["separation"].diagnosed) == "s.toml"
    assert found["scenario_file"] is None
    assert [str(p) for p in found["separation"].recordings] == ["a", "b"]


@pytest.mark.parametrize("words", ["-j 4", "-j4", "--jobs 4", "--jobs=4"])
def test_short_and_long_options_are_the_same(words):
    assert parsed(f"prove {words}")["jobs"] == 4


@pytest.mark.parametrize("name", ["[1].csv", '["a"]', "@run.csv", "a=b.csv", "{}", "7"])
def test_any_file_name_is_a_recording(name):
    assert parsed(f"diagnose {name} --scenario s")["recordings"] == [name]


def test_two_dashes_end_the_options():
    assert parsed("segments -- --odd.csv")["recording"].name == "--odd.csv"


def test_commands_without_recordings_have_their_defaults():
    found = parsed("investigate --scenario s --lab ./record~--table~2")
    assert (found["lab"], found["blocks"], found["budget_min"]) == ("./record --table 2", 2, 10)
    assert (found["recordings"], str(found["output"])) == ([], "investigation")
    assert (found["limits"].block_min, found["limits"].rate_deg_s) == (3, 60)


@pytest.mark.parametrize(
    ("line", "found"),
    [
        ("diagnose --scenario s", "no REC"),
        ("diagnose", "no REC, --scenario"),
        ("calibrate r --method=m", "no --scenario"),
        ("diagnose a --scenario", "too few values for --scenario"),
        ("design b --dwell-s 1", "too few values for --dwell-s"),
        ("design b --terms --json", "too few values for --terms"),
        ("correct a b c", "arguments that are not used: c"),
        ("simulate s --noise maybe", '"on", "off"'),
        ("simulate s --seed 1.5", "'1.5' is not a whole number"),
        ("check c r --scenario s --limit-arcsec x", 'unable to convert "x" into float'),
        ("--quick", "the unknown command '--quick'"),
    ],
)
def test_a_wrong_argument_is_named(line, found, capsys):
    assert main(line.split()) == 2
    said = capsys.readouterr()
    assert said.out == ""
    assert said.err.startswith("tiltcal: command line of `tiltcal")
    assert said.err.count("\n") == 1
    assert found in said.err


def test_the_version_is_printed(capsys):
    assert main(["--version"]) == 0
    assert capsys.readouterr().out.startswith("tiltcal 0.")


@pytest.mark.parametrize("name", COMMANDS)
def test_every_command_has_json(name):
    arguments = app.make_app()[name].assemble_argument_collection()
    assert "--json" in {n for a in arguments for n in a.names}


def test_values_of_method_options_are_read_as_toml_and_otherwise_as_text():
    given = ("terms=['bias', 'K2']", "count=9", "estimator=median", "text=a=b")
    assert parse_options(given) == {
        "terms": ["bias", "K2"],
        "count": 9,
        "estimator": "median",
        "text": "a=b",
    }


@pytest.mark.parametrize(
    ("text", "found"),
    [
        ("outer", "no AXIS=LOW:HIGH"),
        ("outer=90:-90", "no AXIS=LOW:HIGH"),
        ("=0:90", "no AXIS=LOW:HIGH"),
        ("middle=0:90", "no axis middle"),
    ],
)
def test_wrong_axis_limits_are_refused(text, found):
    with pytest.raises(TiltcalError, match=f"--angles {text}: found {found}"):
        axis_limits([text], ("outer", "inner"))


def test_axis_limits_are_pairs_of_degrees():
    assert axis_limits(["outer=-90:90", "inner=0:0"]) == {"outer": (-90, 90), "inner": (0, 0)}
