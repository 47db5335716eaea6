"""Unusable input: exit status 2, one message of what was found, what is needed and what to do, and
nothing left behind.
"""

import json
from pathlib import Path

import pytest
from scenario_files import BENCH_SCENARIO, EFFECTS, HEAD, SEQUENCE, refusal


def put(folder: Path, name: str, text: str) -> Path:
    (folder / name).write_text(text)
    return folder / name


def commands_on(rec, good):
    """Every command that reads a recording, reading ``rec``."""
    toml, cal = good / "bench.toml", good / "CAL.json"
    return {
        "calibrate": [
            "calibrate",
            rec,
            "--scenario",
            toml,
            "--method",
            "six_position",
            "-o",
            "new.json",
        ],
        "correct": ["correct", cal, rec, "-o", "new.csv"],
        "check": ["check", cal, rec, "--scenario", toml],
        "segments": ["segments", rec, "-o", "new.csv"],
        "simulate": ["simulate", toml, "--motion", rec, "-o", "new.csv", "--truth", "new.json"],
        "init": ["init", "--from", rec, "-o", "new.toml"],
    }


def rows_of(good):
    lines = (good / "run.csv").read_text().splitlines()
    top = next(i for i, line in enumerate(lines) if not line.startswith("#"))
    return lines, top


def broken(good, how):
    """The text of a recording that is broken in one way."""
    lines, top = rows_of(good)
    columns = lines[top].split(",")
    if how == "text":
        cells = lines[top + 7].split(",")
        cells[columns.index("accel_y_m_s2")] = "oops"
        lines[top + 7] = ",".join(cells)
    elif how in ("back", "repeated"):
        lines[top + 9 : top + 11] = [lines[top + 10], lines[top + 9 if how == "back" else top + 10]]
    elif how == "empty":
        lines = []
    elif how == "no rows":
        lines = lines[: top + 1]
    elif how == "no time":
        lines[top] = lines[top].replace("time_s", "clock_s")
    elif how == "short row":
        lines[top + 3] = lines[top + 3].rsplit(",", 3)[0]
    return "".join(f"{line}\n" for line in lines)


READING = ("calibrate", "correct", "check", "segments", "simulate", "init")
UNREADABLE = {
    "text": r"line 11, column accel_y_m_s2: found the text 'oops', need a number",
    "short row": "found 5 cells, need 8",
    "empty": "found an empty file",
    "no rows": "found a header and no rows",
    "no time": "need a column time_s",
}


@pytest.mark.parametrize("command", READING)
@pytest.mark.parametrize("how", UNREADABLE)
def test_a_recording_that_does_not_read_is_refused_by_every_command(
    command, how, good, here, capsys
):
    rec = put(here, "bad.csv", broken(good, how))
    assert UNREADABLE[how] in refusal(commands_on(rec, good)[command], here, capsys)


@pytest.mark.parametrize("command", [c for c in READING if c != "init"])
@pytest.mark.parametrize(
    ("how", "words"), [("back", "time goes back, once"), ("repeated", "a stamp is repeated")]
)
def test_time_that_does_not_increase_is_refused_with_its_row(
    command, how, words, good, here, capsys
):
    rec = put(here, "bad.csv", broken(good, how))
    message = refusal(commands_on(rec, good)[command], here, capsys)
    assert words in message
    assert "data row 10" in message


@pytest.mark.parametrize("command", READING)
def test_a_missing_recording_and_a_folder_are_refused(command, good, here, capsys):
    assert "no such file" in refusal(commands_on(here / "none.csv", good)[command], here, capsys)
    assert "found a folder" in refusal(commands_on(here, good)[command], here, capsys)


@pytest.mark.parametrize("command", ["calibrate", "correct", "check"])
def test_a_missing_sensor_column_is_named_with_the_nearest(command, good, here, capsys):
    rec = put(
        here, "bad.csv", (good / "run.csv").read_text().replace("accel_y_m_s2", "acel_y_m_s2")
    )
    message = refusal(commands_on(rec, good)[command], here, capsys)
    assert "no column accel_y_<unit>" in message
    assert "did you mean 'acel_y_m_s2'?" in message


def test_a_missing_table_column_leaves_a_prediction_without_a_path(good, here, capsys):
    rec = put(
        here, "bad.csv", (good / "run.csv").read_text().replace("table_inner_deg", "head_inner_deg")
    )
    assert "no column table_inner_<unit>" in refusal(
        commands_on(rec, good)["simulate"], here, capsys
    )


@pytest.mark.parametrize("command", [c for c in READING if c != "check"])
def test_an_output_that_cannot_be_written_is_refused(command, good, here, capsys):
    words = commands_on(good / "run.csv", good)[command]
    words[words.index("-o") + 1] = here / "none" / "new.csv"
    assert "no such file or directory" in refusal(words, here, capsys)
    words[words.index("-o") + 1] = here
    records = command in ("simulate", "correct")
    refused = "the ending ''" if records else "found a folder, need a file name"
    assert refused in refusal(words, here, capsys)


def commands_with(toml, good):
    """Every command that reads a scenario, reading ``toml``."""
    run = good / "run.csv"
    return {
        "simulate": ["simulate", toml, "-o", "new.csv", "--truth", "new.json"],
        "calibrate": [
            "calibrate",
            run,
            "--scenario",
            toml,
            "--method",
            "six_position",
            "-o",
            "new.json",
        ],
        "check": ["check", good / "CAL.json", run, "--scenario", toml],
        "run": ["run", toml, "-o", "out"],
        "verify": ["verify", toml, "-o", "out"],
    }


WRONG = {
    "a wrong key": (
        BENCH_SCENARIO.replace("gravity_m_s2", "gravty_m_s2"),
        ["site.gravty_m_s2: unknown key; did you mean 'gravity_m_s2'?"],
    ),
    "an effect's key": (
        BENCH_SCENARIO.replace("bias_x_ug", "bais_x_ug"),
        ["bais_x", "did you mean 'bias_x"],
    ),
    "several at once": (
        BENCH_SCENARIO.replace("rate_hz = 50", "rate_hz = -1")
        .replace('table = "dual"', 'table = "duel"')
        .replace("seed", "sed"),
        [
            "3 errors",
            "sensor.1.rate_hz",
            "rig.table: found 'duel'",
            "sed: unknown key; did you mean 'seed'?",
        ],
    ),
    "no TOML": ("schema = = 1", ["valid TOML", "line 1"]),
    "nothing": ("", ["schema: missing", "site: missing", "rig: missing"]),
}


@pytest.mark.parametrize("command", ["simulate", "calibrate", "check", "run", "verify"])
@pytest.mark.parametrize("wrong", WRONG)
def test_a_wrong_scenario_is_refused_with_every_key_named(command, wrong, good, here, capsys):
    text, words = WRONG[wrong]
    message = refusal(commands_with(put(here, "wrong.toml", text), good)[command], here, capsys)
    for word in words:
        assert word in message
    assert not (here / "out").exists()


@pytest.mark.parametrize("command", ["simulate", "calibrate", "check", "run", "verify"])
def test_a_missing_scenario_is_refused(command, good, here, capsys):
    assert "no such file" in refusal(commands_with(here / "none.toml", good)[command], here, capsys)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (HEAD + EFFECTS + SEQUENCE, "[[method]]"),
        (BENCH_SCENARIO + '[[method]]\ncommand = ["rm", "-rf"]\n', "--allow-commands"),
    ],
)
@pytest.mark.parametrize("command", ["run", "verify"])
def test_nothing_to_judge_and_commands_without_leave_are_refused(
    command, text, words, good, here, capsys
):
    message = refusal(commands_with(put(here, "a.toml", text), good)[command], here, capsys)
    assert words in message
    assert not (here / "out").exists()


def test_verify_refuses_an_empty_folder_and_a_file_where_the_report_should_go(good, here, capsys):
    (here / "empty").mkdir()
    assert "no *.toml" in refusal(["verify", here / "empty"], here, capsys)
    put(here, "out", "")
    for command in ("run", "verify"):
        assert "found the file" in refusal(
            [command, good / "bench.toml", "-o", here / "out" / "deep"], here, capsys
        )


@pytest.mark.parametrize("command", ["correct", "check"])
@pytest.mark.parametrize(
    ("edit", "words"),
    [
        (lambda _: "{", "Expecting"),
        (lambda _: "[]", "need a CAL.json"),
        (
            lambda c: json.dumps({k: v for k, v in c.items() if k != "parameters"}),
            "no key 'parameters'",
        ),
        (
            lambda c: json.dumps(c | {"verdict": "fine"}),
            "found verdict 'fine', need one of good, suspect, cannot_tell",
        ),
        (lambda c: json.dumps(c | {"parameters": {"accel.bias_x": {"value": "much"}}}), "much"),
    ],
)
def test_a_bad_calibration_is_refused(command, edit, words, good, here, capsys):
    cal = put(here, "CAL.json", edit(json.loads((good / "CAL.json").read_text())))
    arguments = commands_on(good / "run.csv", good)[command]
    arguments[1] = cal
    assert words in refusal(arguments, here, capsys)


@pytest.mark.parametrize(
    ("setup", "words"),
    [
        (None, "found no provenance.setup, need the set-up it belongs to"),
        ({"rig": {"table": "dual"}}, "provenance.setup.site: found field required"),
    ],
)
def test_correct_needs_the_set_up_of_the_calibration(setup, words, good, here, capsys):
    table = json.loads((good / "CAL.json").read_text())
    table["provenance"] = {} if setup is None else {"setup": setup}
    cal = put(here, "CAL.json", json.dumps(table))
    assert words in refusal(["correct", cal, good / "run.csv", "-o", "new.csv"], here, capsys)


def test_check_refuses_a_calibration_of_nothing(good, here, capsys):
    table = json.loads((good / "CAL.json").read_text()) | {"parameters": {}, "covariance": None}
    words = [
        "check",
        put(here, "CAL.json", json.dumps(table)),
        good / "run.csv",
        "--scenario",
        good / "bench.toml",
    ]
    assert "found no parameter of a sensor" in refusal(words, here, capsys)


@pytest.mark.parametrize(
    ("more", "words"),
    [
        (["--method", "six_positon"], "did you mean 'six_position'?"),
        (["--method", "nowhere:f"], "No module named 'nowhere'"),
        (["--method", "json:nothing"], "has no attribute 'nothing'"),
        (["--method", "json:__doc__"], "found str, need a function"),
        (["--method", "norm", "--option", "terms"], "found no KEY=VALUE"),
        (["--method", "norm", "--option", "term=9"], "option 'term'"),
        (["--method", "norm", "--option", "terms=7"], "found 7, need 6 or 9"),
        (["--method", "norm", "--option", "segments=3"], "use --segments SEG.csv"),
        (
            ["--method", "six_position", "--option", "sensor=acel"],
            "sensor 'acel': found no such sensor",
        ),
        (["--method", "two_position"], "found table dual, need table vertical"),
    ],
)
def test_a_wrong_method_or_option_is_refused(more, words, good, here, capsys):
    start = ["calibrate", good / "run.csv", "--scenario", good / "bench.toml", "-o", "new.json"]
    assert words in refusal([*start, *more], here, capsys)


@pytest.mark.parametrize("command", ["calibrate", "check"])
@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", "no column end_s, start_s"),
        ("start_s,kind\n1,dwell\n", "no column end_s"),
        ("start_s,end_s\n1,2\n3,x\n", "line 3: found could not convert string to float: 'x'"),
        ("start_s,end_s\n3,2\n", "line 2: found dwell from 3 to 2 s"),
        ("start_s,end_s\nnan,2\n", "line 2"),
        ("start_s,end_s,kind\n1,2,rest\n", "found rest from 1 to 2 s, need dwell or move"),
        (
            "start_s,end_s\n1,2\n900,910\n",
            "line 3: found no sample from 900 to 910 s, need times within the recording",
        ),
        ("start_s,end_s\n1,2\n1.5,3\n", "dwells that overlap from 1.5 to 2 s"),
    ],
)
def test_wrong_segments_are_refused(command, text, words, good, here, capsys):
    arguments = [
        *commands_on(good / "run.csv", good)[command],
        "--segments",
        put(here, "SEG.csv", text),
    ]
    assert words in refusal(arguments, here, capsys)
