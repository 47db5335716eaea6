"""The user's own algorithm, as a function, an installed entry point or a program, judged like a
built-in one.
"""

import json
import sys
from importlib.metadata import EntryPoint

import pytest
from scenario_files import BENCH_SCENARIO, EFFECTS, HEAD, SEQUENCE

from tiltcal.calibration.methods import registry
from tiltcal.calibration.methods.six_position import six_position
from tiltcal.cli import main
from tiltcal.setup.setup import Setup

MODULE = '''
from dataclasses import replace

from tiltcal.calibration.methods.six_position import six_position

seen = []


def own(recording, setup, *, gain=1.0):
    """Six positions, and what it was handed."""
    seen.append((recording, setup, gain))
    return replace(six_position(recording, setup), method="own")


def wrong(recording, setup):
    """Off by ten sigma and sure of itself."""
    found = own(recording, setup)
    moved = {n: replace(e, value=e.value + 10 * e.sigma) for n, e in found.parameters.items()}
    return replace(found, parameters=moved)


def rubbish(recording, setup):
    return {"accel.bias_x": 0.0}


def elsewhere(recording, setup):
    found = own(recording, setup)
    names = {n.replace("accel", "acel"): e for n, e in found.parameters.items()}
    return replace(found, parameters=names)
'''


@pytest.fixture
def module(here, monkeypatch):
    """A module of the user's, in the folder they stand in."""
    (here / "lab_methods.py").write_text(MODULE)
    monkeypatch.setattr(sys, "path", list(sys.path))
    yield "lab_methods"
    sys.modules.pop("lab_methods", None)


def judged(folder, capsys, method, *words, status):
    """The one method of a scenario, judged by `run`."""
    (folder / "claim.toml").write_text(HEAD + EFFECTS + SEQUENCE + f"[[method]]\n{method}\n")
    capsys.readouterr()
    assert main(["run", "claim.toml", "--json", *words]) == status
    return json.loads(capsys.readouterr().out)["scenarios"][0]["methods"][0]


def test_a_function_of_the_user_s_is_accepted_and_never_sees_a_truth(module, here, capsys):
    found = judged(
        here, capsys, f'name = "{module}:own"\noptions = {{ gain = 2.5 }}\nruns = 3', status=0
    )
    assert (found["method"], found["runs"], found["accepted"]) == ("lab_methods:own", 3, True)
    seen = sys.modules[module].seen
    assert [gain for _, _, gain in seen] == [2.5] * 3
    for recording, setup, _ in seen:
        assert type(setup) is Setup
        assert not {"effect", "effects", "seed", "sequence"} & set(dir(setup))
        assert set(recording.metadata) <= {"scenario", "seed", "made by"}
        assert not any("bias" in text or "3000" in text for text in recording.metadata.values())


def test_a_function_that_is_wrong_is_not_accepted(module, here, capsys):
    found = judged(here, capsys, f'name = "{module}:wrong"', status=1)
    assert not found["accepted"]
    broken = [limit["name"] for limit in found["limits"] if not limit["passed"]]
    assert broken == [
        "parameters, NEES per degree of freedom",
        "parameters, largest error, sigma",
    ]


@pytest.mark.parametrize(
    ("function", "words"),
    [
        ("rubbish", "found a dict, need a tiltcal.calibration.result.Calibration"),
        ("missing", "has no attribute 'missing'"),
        ("elsewhere", "sensor 'acel': found no such sensor, need one of accel"),
        (
            'own"\noptions = { gian = 2 }\n#',
            "found option 'gian', need an option of it; did you mean 'gain'?",
        ),
    ],
)
def test_a_function_that_does_not_keep_to_the_contract_is_told_so(
    function, words, module, here, capsys
):
    found = judged(here, capsys, f'name = "{module}:{function}"', status=1)
    assert words in found["error"]
    assert main(["run", "claim.toml"]) == 1
    assert words in capsys.readouterr().out


def test_a_function_calibrates_from_the_command_line(module, good, capsys):
    words = [
        "calibrate",
        str(good / "run.csv"),
        "--scenario",
        str(good / "bench.toml"),
        "--method",
        f"{module}:own",
    ]
    assert main([*words, "--option", "gain=4", "--json"]) == 0
    own = json.loads(capsys.readouterr().out)
    built_in = json.loads((good / "CAL.json").read_text())
    assert own["method"] == "own"
    assert own["parameters"] == built_in["parameters"]
    assert own["provenance"]["setup"] == built_in["provenance"]["setup"]
    assert sys.modules[module].seen[-1][2] == 4


def test_an_installed_entry_point_stands_wherever_a_name_does(here, monkeypatch, capsys):
    entry = EntryPoint(
        "lab_six", "tiltcal.calibration.methods.six_position:six_position", registry.GROUP
    )
    for place in ("tiltcal.calibration.methods.registry", "tiltcal.cli.methods"):
        monkeypatch.setattr(
            f"{place}.entry_points", lambda group: (entry,) if group == registry.GROUP else ()
        )
    assert registry.find_method("lab_six") is six_position
    assert judged(here, capsys, 'name = "lab_six"', status=0)["accepted"]
    assert main(["methods"]) == 0
    assert "lab_six" in capsys.readouterr().out
    # the recording comes first
    assert main(["calibrate", "x.csv", "--scenario", "claim.toml", "--method", "lab_sic"]) == 2
    (here / "x.csv").write_text("time_s\n1\n")
    assert main(["calibrate", "x.csv", "--scenario", "claim.toml", "--method", "lab_sic"]) == 2
    assert "did you mean 'lab_six'?" in capsys.readouterr().err


# --------------------------------------------------------------------------------------------------
# ---------- a program

PROGRAM = """
import json, sys, tomllib
import numpy as np

recording, scenario, cal, *more = sys.argv[1:]
with open("said.json", "w") as out:
    json.dump(more, out)
with open(scenario, "rb") as file:
    table = tomllib.load(file)
lines = [line for line in open(recording) if not line.startswith("#")]
names = [name.strip('"') for name in lines[0].strip().split(",")]
cells = [line.strip().replace('"', "").split(",") for line in lines[1:]]
column = lambda name: np.array([row[names.index(name)] for row in cells])
f = np.column_stack([column(f"accel_{a}_m_s2").astype(float) for a in "xyz"])
turn = sum(np.abs(np.gradient(column(f"table_{a}_deg").astype(float))) for a in ("outer", "inner"))
still, label, g = turn == 0, column("label"), table["site"]["gravity_m_s2"]
parameters = {}
for i, a in enumerate("xyz"):
    up, down = (f[still & (label == sign + a), i] for sign in "+-")
    sigma = np.hypot(up.std() / len(up) ** 0.5, down.std() / len(down) ** 0.5) / 2
    bias, scale = (up.mean() + down.mean()) / 2, (up.mean() - down.mean()) / 2 / g - 1
    parameters[f"accel.bias_{a}"] = {"value": bias, "sigma": sigma, "unit": "m_s2"}
    parameters[f"accel.scale_{a}"] = {"value": scale, "sigma": sigma / g, "unit": "1"}
with open(cal, "w") as out:
    found = {"schema": 1, "method": "six by hand", "verdict": "good", "parameters": parameters}
    json.dump(found, out)
"""
PAIRS = ("xy", "xz", "yx", "yz", "zx", "zy")
FILES = '"{recording}", "{scenario}", "{cal}"'


@pytest.fixture
def program(here):
    (here / "own.py").write_text(PROGRAM)
    return f'command = ["{sys.executable}", "own.py", {FILES}'


def test_a_program_is_judged_and_its_words_pass_no_shell(program, here, capsys):
    method = program + ', "; touch hacked", "$HOME", "*"]'
    found = judged(here, capsys, method, "--allow-commands", status=1)
    missing = next(limit for limit in found["limits"] if not limit["passed"])
    assert missing["where"].split(", ") == [f"accel.cross_{p}" for p in PAIRS]
    required = '\n[method.accept]\nrequired = ["accel.bias", "accel.scale"]'
    found = judged(here, capsys, method + required, "--allow-commands", status=0)
    assert found["accepted"], found
    assert (found["verdict"], found["verdicts"]) == ("good", "untested")
    assert len(found["parameters"]) == 6
    assert json.loads((here / "said.json").read_text()) == ["; touch hacked", "$HOME", "*"]
    assert not (here / "hacked").exists()


def test_a_program_runs_only_with_leave(program, here, capsys):
    (here / "claim.toml").write_text(BENCH_SCENARIO + f"[[method]]\n{program}]\n")
    assert main(["run", "claim.toml"]) == 2
    assert "found the command" in capsys.readouterr().err
    assert not (here / "said.json").exists()


@pytest.mark.parametrize(
    ("source", "words"),
    [
        ("import sys; sys.exit('no light')", "found exit status 1 (no light), need 0"),
        ("", "found no such file, need an existing file"),
        (
            "import sys; open(sys.argv[3], 'w').write('{}')",
            "calibration CAL.json: found no key 'parameters'",
        ),
        ("import sys; sys.stderr.write('\\x1b[31mred\\n'); sys.exit(3)", "exit status 3"),
    ],
)
def test_a_program_that_fails_or_writes_no_calibration_is_named(
    source, words, program, here, capsys
):
    (here / "own.py").write_text(source)
    found = judged(here, capsys, program + "]", "--allow-commands", "-o", "out", status=1)
    assert words in found["error"]
    assert "<failure" in (here / "out" / "junit.xml").read_text()
    assert "\x1b" not in (here / "out" / "junit.xml").read_text()


def test_a_program_that_is_not_there_is_named(here, capsys):
    found = judged(
        here, capsys, f'command = ["./no-such-program", {FILES}]', "--allow-commands", status=1
    )
    assert "command ./no-such-program: found" in found["error"]
