"""Work that is over the budget is refused before anything is allocated; more has to be allowed."""

import io
import zipfile

import numpy as np
import pytest
from scenario_files import BENCH_SCENARIO, EFFECTS, HEAD, refusal

from tiltcal.cli import main
from tiltcal.core.budget import WorkBudget, allow, require_within, restoring
from tiltcal.core.errors import TiltcalError
from tiltcal.recordings.recording import Recording
from tiltcal.recordings.saving import write_recording

LONG = '[[sequence]]\naction = "rest"\ndwell_s = {}\n'


def scenario(dwell: float, more: str = "") -> str:
    return HEAD + EFFECTS + more + LONG.format(dwell)


@pytest.mark.parametrize(
    ("dwell", "words"),
    [
        ("1e10", "5e+11 rows"),
        ("1e300", "rows"),
        ("3e6", "1.5e+08 rows"),
    ],
)
def test_a_recording_of_too_many_rows_is_refused(dwell, words, here, capsys):
    (here / "s.toml").write_text(scenario(dwell))
    message = refusal(["simulate", "s.toml", "-o", "r.csv"], here, capsys)
    assert words in message
    assert "need at most 1e+08 rows" in message


def test_a_recording_that_is_made_in_one_go_is_refused_by_its_bytes(here, capsys):
    (here / "s.toml").write_text(scenario(1e6) + '[[method]]\nname = "norm"\n')
    message = refusal(["run", "s.toml"], here, capsys)
    assert "5e+07 rows, 2.56e+10 bytes (23.8 GiB)" in message
    assert "need at most 2048 MiB" in message
    assert "--allow-memory 24414" in message


def test_the_option_allows_more_and_less_and_only_for_its_command(here, capsys):
    (here / "s.toml").write_text(BENCH_SCENARIO)
    words = ["simulate", "s.toml", "-o", "r.csv"]
    assert "need at most 10 rows" in refusal([*words, "--allow-rows", "10"], here, capsys)
    assert main(words) == 0
    assert "--allow-rows: found nan" in refusal([*words, "--allow-rows", "nan"], here, capsys)


def test_more_is_within_a_budget_that_allows_it():
    with restoring():
        allow(rows=3e8, memory_mib=4096, hours=1)
        require_within("work", rows=2e8, size=3 * 2**30, seconds=3000, less="ask for less")
        with pytest.raises(TiltcalError, match="need at most 1 h"):
            require_within("work", seconds=4000, less="ask for less")
    assert WorkBudget.allowed() == WorkBudget()


def test_what_the_environment_allows_has_to_be_a_number(monkeypatch):
    monkeypatch.setenv("TILTCAL_ALLOW_ROWS", "many")
    with pytest.raises(TiltcalError, match="TILTCAL_ALLOW_ROWS: found 'many'"):
        WorkBudget.allowed()


def test_runs_without_number_are_refused_with_their_bytes_and_hours(here, capsys):
    text = BENCH_SCENARIO.replace('name = "six_position"', 'name = "six_position"\nruns = 1000000')
    (here / "s.toml").write_text(text)
    message = refusal(["run", "s.toml"], here, capsys)
    assert "1000000 runs: found work of 2e+10 bytes (18.6 GiB), about 5.56 h" in message


def test_a_sequence_of_too_many_stops_is_refused(here, capsys):
    sweep = '[[sequence]]\naction = "sweep"\nouter_deg = 90\nstep_deg = 1e-9\n'
    (here / "s.toml").write_text(HEAD + sweep)
    assert "9e+10 stops, need at most 100000 legs" in refusal(["simulate", "s.toml"], here, capsys)


def test_a_campaign_of_too_many_runs_is_refused_before_its_levels_are_made(here, capsys):
    (here / "s.toml").write_text(BENCH_SCENARIO)
    words = ["sweep", "s.toml", "--effect", "acc_bias.bias_x_ug=0:1:1000000000", "-o", "out"]
    assert "20000000000 runs" in refusal(words, here, capsys)


def npz(here, members):
    with zipfile.ZipFile(here / "r.npz", "w", zipfile.ZIP_DEFLATED) as archive:
        for name, content in members.items():
            archive.writestr(f"{name}.npy", content)
    return here / "r.npz"


def saved(values) -> bytes:
    out = io.BytesIO()
    np.save(out, values)
    return out.getvalue()


@pytest.mark.parametrize("ending", ["csv", "parquet", "npz"])
def test_a_file_of_thousands_of_columns_is_refused(ending, here, capsys):
    columns = {f"c{k}_g": np.zeros(2) for k in range(5000)}
    write_recording(Recording.from_columns(np.arange(2.0), columns), here / f"r.{ending}")
    message = refusal(["segments", f"r.{ending}"], here, capsys)
    assert "columns, need at most 4096" in message


def test_an_array_that_claims_more_than_its_archive_holds_is_not_allocated(here, capsys):
    whole = saved(np.zeros(2))
    lying = whole.replace(b"(2,), }" + b" " * 10, b"(90000000000,), }")
    assert len(lying) == len(whole)
    npz(here, {"time_s": saved(np.arange(2.0)), "accel_x_g": lying})
    assert "claims 90000000000 values" in refusal(["segments", "r.npz"], here, capsys)


def test_an_archive_that_unpacks_to_more_than_the_budget_is_not_unpacked(here, capsys):
    npz(here, {"time_s": saved(np.arange(2.0)), "accel_x_g": saved(np.zeros(1 << 17))})
    with restoring():
        allow(memory_mib=1)
        message = refusal(["segments", "r.npz"], here, capsys)
    assert "need at most 1 MiB" in message


def test_a_parquet_file_of_more_rows_than_the_budget_is_not_read(good, here, capsys):
    words = ["simulate", good / "bench.toml", "-o", "r.parquet"]
    assert main([str(w) for w in words]) == 0
    with restoring():
        allow(rows=100)
        assert "need at most 100 rows" in refusal(["segments", "r.parquet"], here, capsys)
        words = ["correct", good / "CAL.json", "r.parquet", "-o", "o.csv"]
        assert "need at most 100 rows" in refusal(words, here, capsys)
