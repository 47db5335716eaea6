"""A slice of the fuzz program; ``python -m tests.fuzz`` runs as many inputs as it is told."""

import json
import math
import time

import numpy as np
import pytest

from tests.fuzz import judging
from tests.fuzz.cases import Case, make_case
from tests.fuzz.judging import SOUND, contents, judge
from tests.fuzz.options import option_cases
from tests.fuzz.originals import make_originals
from tests.fuzz.running import outcomes
from tiltcal.cli import methods

COUNT = 200
QUIET = (SOUND, "warning")


@pytest.fixture(scope="module")
def originals(tmp_path_factory):
    return make_originals(tmp_path_factory.mktemp("originals"))


def test_no_mutated_input_breaks_a_rule(originals):
    found = list(outcomes(range(COUNT), lambda number: make_case(7, number, originals)))
    assert len(found) == COUNT
    assert [o.told for o in found if o.kind not in QUIET] == []


def test_no_odd_value_of_an_option_of_a_method_breaks_a_rule(originals):
    cases = option_cases(originals, methods_only=True)
    found = list(outcomes(range(len(cases)), cases.__getitem__))
    assert len(found) > 200
    assert [o.told for o in found if o.kind not in QUIET] == []


def test_the_same_seed_makes_the_same_inputs(originals):
    for number in range(40):
        one, other = (make_case(3, number, originals) for _ in range(2))
        assert one == other
    assert len({json.dumps(make_case(3, n, originals).arguments) for n in range(40)}) > 10


def case(*arguments, **files):
    return Case(0, arguments, {k: v.encode() for k, v in files.items()}, "nothing")


def breaking(monkeypatch, tmp_path, action):
    """What is said of a command that does something it should not."""

    def run(**_):
        return action()

    monkeypatch.setattr(methods, "methods", run)
    return judge(case("methods", mine="1"), tmp_path).kind


def raised(error):
    raise error


def test_each_broken_rule_is_seen(monkeypatch, tmp_path):
    acts = {
        SOUND: lambda: 0,
        "traceback": lambda: raised(RuntimeError("lost")),
        "memory": lambda: raised(MemoryError()),
        "status": lambda: 7,
        "message": lambda: 2,
        "control characters": lambda: print("\x1b[2J"),
        "partial output": lambda: (tmp_path / ".part-1").write_text("x") and 0,
        "warning": lambda: np.float64(1e300) * np.float64(1e300) * 0 and 0,
    }
    said = {kind: breaking(monkeypatch, tmp_path, act) for kind, act in acts.items()}
    assert said == {kind: kind for kind in acts}


def test_a_refusal_that_changes_a_file_is_seen(monkeypatch, tmp_path):
    def spoil():
        (tmp_path / "mine").write_text("2")
        return 2

    assert breaking(monkeypatch, tmp_path, spoil) == "partial output"
    assert contents(tmp_path)["mine"] == b"2"


def test_a_command_that_hangs_is_seen(monkeypatch, tmp_path):
    monkeypatch.setattr(judging, "LONGEST_S", 0.2)
    monkeypatch.setattr(judging, "QUIET_S", 0.1)
    start = time.monotonic()
    assert breaking(monkeypatch, tmp_path, lambda: time.sleep(5)) == "hang"
    assert math.isclose(time.monotonic() - start, 0.2, abs_tol=1.0)
