"""Campaigns whose processes are killed, hang, or eat memory: nothing that was recorded is lost, and
the results have the same bytes however they were made.
"""

import io
import json
import os
import re
import resource
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager, redirect_stderr, redirect_stdout
from pathlib import Path

import pyarrow.parquet as pq
import pytest
from scenario_files import BENCH_SCENARIO, EFFECTS, HEAD, SEQUENCE

from tiltcal.cli import main

METHOD = '''
"""Six faces, slowly; or a method that its own option loses."""
import os
import time
from pathlib import Path

from tiltcal.calibration.methods.registry import calibrate


def held():
    try:
        return Path("made").stat().st_size >= int(Path("hold").read_text())
    except FileNotFoundError:
        return False


def slow(recording, setup, *, seconds=0.0, ends=-1, hangs=-1, eats=-1):
    time.sleep(seconds)
    while held():
        time.sleep(0.01)
    with open("made", "a") as file:
        file.write(".")
    seed = int(recording.metadata["seed"])
    if seed == ends:
        os.kill(os.getpid(), 9)
    if seed == hangs:
        time.sleep(600)
    if seed == eats:
        hold = [bytearray(1 << 24) for _ in range(1000)]
    return calibrate("six_position", recording, setup)
'''
CAMPAIGN = """\
schema = 1
scenario = "bench.toml"
runs = {runs}
[[factor]]
field = "effect.acc_bias.bias_y_ug"
values = [{values}]
"""
PROGRAM = [sys.executable, "-m", "tiltcal"]
COMMAND = [*PROGRAM, "campaign", "c.toml", "--progress"]
SLOW = "seconds = 0.15"


def write(folder: Path, runs: int, options: str = "", values: str = "-1500, 0") -> None:
    """A campaign of two points, or of others, with this many runs each."""
    (folder / "lab.py").write_text(METHOD)
    method = f'[[method]]\nname = "lab:slow"\noptions = {{ {options} }}\n'
    (folder / "bench.toml").write_text(HEAD + EFFECTS + SEQUENCE + method)
    (folder / "c.toml").write_text(CAMPAIGN.format(runs=runs, values=values))


def run(*words: str, status: int = 0) -> str:
    """What the campaign prints."""
    return _said([*COMMAND, *words], status)


def called(*words: str, status: int = 0) -> str:
    """What a command prints that is called in this process; its runs have processes anyway."""
    said = io.StringIO()
    with redirect_stdout(said), redirect_stderr(said):
        assert main([*words]) == status
    return said.getvalue()


def _said(command: list[str], status: int) -> str:
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == status, done.stdout + done.stderr
    return done.stdout + done.stderr


@contextmanager
def started(*words: str, after: int) -> Iterator[subprocess.Popen]:
    """A campaign of which about so many runs are made, one of them in its journal: the others wait
    until the file ``hold`` is gone. It is ended with the block.
    """
    made, hold = Path("made"), Path("hold")
    made.unlink(missing_ok=True)
    hold.write_text(f"{after}")
    with subprocess.Popen(
        [*COMMAND, *words], stderr=subprocess.PIPE, text=True, preexec_fn=_interruptible
    ) as process:
        try:
            until = time.monotonic() + 60
            while not made.exists() or made.stat().st_size < after:
                assert process.poll() is None
                assert time.monotonic() < until
                time.sleep(0.01)
            assert any(" runs, " in line for line in process.stderr)
            yield process
        finally:
            hold.unlink(missing_ok=True)
            process.kill()


def _interruptible() -> None:
    """Take an interrupt also where the tests themselves run in the background of a shell."""
    signal.signal(signal.SIGINT, signal.SIG_DFL)


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """The results of a campaign of ten runs that nothing happened to."""
    folder = tmp_path_factory.mktemp("whole")
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        write(folder, 5, SLOW)
        run("-o", "out", "-j", "2")
    return (folder / "out" / "results.parquet").read_bytes()


@pytest.fixture
def ten(here):
    """An empty folder with that campaign."""
    write(here, 5, SLOW)
    return here


@pytest.mark.usefixtures("ten")
def test_shards_and_a_cluster_give_the_same_bytes(whole):
    run("-o", "dask", "-j", "2", "--engine", "dask")
    assert Path("dask/results.parquet").read_bytes() == whole
    for k in (1, 2):
        called("campaign", "c.toml", "-o", f"part{k}", "--shard", f"{k}/2")
    assert pq.read_table("part1/results.parquet").num_rows == 5
    assert "10 of 10 runs" in called("merge", "part1", "part2", "-o", "merged")
    assert Path("merged/results.parquet").read_bytes() == whole
    Path("part2/results.campaign.json").write_text(
        Path("part2/results.campaign.json").read_text().replace('"runs": 5', '"runs": 4')
    )
    assert "found another campaign" in called("merge", "part1", "part2", "-o", "other", status=2)


@pytest.mark.usefixtures("ten")
def test_a_shard_is_a_part_of_a_whole():
    words = ("campaign", "c.toml", "-o", "out", "--shard", "3/2")
    assert "need i/n with i from 1 to n" in called(*words, status=2)


@pytest.mark.usefixtures("ten")
def test_after_kill_9_of_the_main_process_only_what_is_missing_is_made(whole):
    with started("-o", "out", "-j", "2", after=3) as process:
        children = _children(process.pid)
        assert len(children) == 2
        process.kill()
        process.wait()
    _wait_for_the_end_of(children)
    assert not Path("out/results.parquet").exists()
    said = run("-o", "out", "-j", "2")
    assert int(re.search(r"^(\d+) of 10 runs, ", said, re.MULTILINE)[1]) >= 2
    # each of two processes was making one, and may have made one that was not recorded yet
    assert Path("made").stat().st_size <= 10 + 2 * 2
    assert "10 of 10 runs" in said
    assert Path("out/results.parquet").read_bytes() == whole


def test_an_interrupt_leaves_a_journal_and_no_processes(here):
    write(here, 200, SLOW)
    with started("-o", "out", "-j", "2", after=2) as process:
        children = _children(process.pid)
        process.send_signal(signal.SIGINT)
        Path("hold").unlink()
        assert process.wait(20) == 130
    _wait_for_the_end_of(children)
    assert Path("out/results.journal").exists()


@pytest.mark.usefixtures("ten")
def test_a_process_that_is_killed_from_outside_costs_nothing(whole):
    with started("-o", "out", "-j", "2", after=2) as process:
        os.kill(_children(process.pid)[0], signal.SIGKILL)
        Path("hold").unlink()
        process.stderr.read()
        assert process.wait() == 0
    assert Path("out/results.parquet").read_bytes() == whole


def test_poison_is_a_recorded_result_and_can_be_tried_again(here):
    write(here, 4, "ends = 6, hangs = 7, eats = 8", values="0")
    limits = ("-o", "out", "-j", "2", "--time-limit", "8", "--memory-limit", "700")
    said = run(*limits)
    table = pq.read_table("out/results.parquet")
    assert table.column("verdict").to_pylist() == ["good", "error", "error", "error"]
    reasons = [
        "its process ended by signal SIGKILL",
        "it took more than 8 s",
        "it took more than 700 MiB",
    ]
    assert table.column("error").to_pylist() == [None, *reasons]
    page = Path("out/results.html").read_text()
    assert all(said.count(words) == 1 and page.count(words) == 1 for words in reasons)
    summary = json.loads(Path("out/results.summary.json").read_text())
    assert summary["faults"] == {"ended": 1, "time": 1, "memory": 1}
    assert [f["seed"] for f in summary["failed"]] == [6, 7, 8]
    # a finished campaign is not made again, unless it is asked for
    assert not re.search(r"runs, .* a second", run(*limits))
    assert re.search(r"of 4 runs, .* a second", run(*limits, "--again"))


@pytest.mark.usefixtures("ten")
def test_a_dask_worker_and_the_scheduler_may_be_killed(whole):
    """A task whose worker is lost is made by another one; without a scheduler the work ends with a
    message, and goes on with another engine.
    """
    with cluster("8907") as (address, scheduler, workers):
        with started("-o", "out", "--engine", f"dask://{address}", after=2) as process:
            workers[0].kill()
            Path("hold").unlink()
            process.stderr.read()
            assert process.wait() == 0
        assert Path("out/results.parquet").read_bytes() == whole
        with started("-o", "more", "--engine", f"dask://{address}", after=2) as process:
            scheduler.kill()
            Path("hold").unlink()
            said = process.stderr.read()
            assert process.wait() == 2
        assert "lost with its workers or its scheduler" in said
    run("-o", "more", "-j", "2")
    assert Path("more/results.parquet").read_bytes() == whole


@contextmanager
def cluster(port: str) -> Iterator[tuple[str, subprocess.Popen, list[subprocess.Popen]]]:
    """A scheduler with two workers on this machine, each a process."""
    dask, address = [sys.executable, "-m", "dask"], f"127.0.0.1:{port}"
    quiet = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
    serve = ["scheduler", "--host", "127.0.0.1", "--port", port, "--no-dashboard"]
    work = ["worker", f"tcp://{address}", "--nthreads", "1", "--no-dashboard", "--no-nanny"]
    scheduler = subprocess.Popen([*dask, *serve], **quiet)
    workers = [subprocess.Popen([*dask, *work], **quiet) for _ in range(2)]
    script = (
        "from distributed import Client\n"
        f"Client('tcp://{address}', timeout=30).wait_for_workers(2, timeout=60)"
    )
    try:
        subprocess.run([sys.executable, "-c", script], check=True)
        yield address, scheduler, workers
    finally:
        for p in (scheduler, *workers):
            p.kill()
            p.wait()


def _children(pid: int) -> list[int]:
    """Processes that a process started and that serve tasks."""
    found = subprocess.run(["pgrep", "-P", f"{pid}"], capture_output=True, text=True, check=False)
    return [int(word) for word in found.stdout.split()]


def _wait_for_the_end_of(pids: list[int]) -> None:
    until = time.monotonic() + 15
    while any(_runs(pid) for pid in pids):
        assert time.monotonic() < until, "a process was left"
        time.sleep(0.05)


def _runs(pid: int) -> bool:
    try:
        return "Z" not in Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0]
    except OSError:
        return False


def test_a_damaged_part_leaves_no_half_merged_campaign(here, capsys):
    (here / "bench.toml").write_text(BENCH_SCENARIO)
    words = ["sweep", "bench.toml", "--effect", "acc_bias.bias_x_ug=0:1:2", "--seeds", "1"]
    assert main([*words, "-o", "part"]) == 0
    whole = (here / "part" / "results.journal").read_bytes()
    for content in (whole[:100], whole[: len(whole) // 2], b"nothing at all"):
        (here / "part" / "results.journal").write_bytes(content)
        assert main(["merge", "part", "-o", "whole"]) == 2
        assert "journal" in capsys.readouterr().err
        assert list((here / "whole").iterdir()) == []


@pytest.mark.usefixtures("ten")
def test_a_full_disk_loses_nothing_that_was_recorded(whole):
    """A limit of the size of files stands for the end of the disk."""

    def little_room():
        resource.setrlimit(resource.RLIMIT_FSIZE, (40_000, 40_000))

    command = [*COMMAND, "-o", "out", "-j", "2"]
    done = subprocess.run(
        command, capture_output=True, text=True, check=False, preexec_fn=little_room
    )
    assert done.returncode == 2
    assert "free some space and run the same command again" in done.stderr
    assert not Path("out/results.parquet").exists()
    made = Path("made").stat().st_size
    assert 3 <= made < 10
    run("-o", "out", "-j", "2")
    assert Path("out/results.parquet").read_bytes() == whole
    # two were being made, and the one that there was no room for; the queue may have gone on
    assert Path("made").stat().st_size <= 10 + 4
