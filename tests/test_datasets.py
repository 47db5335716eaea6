"""Published recordings are fetched from a server as their owners keep them, or refused."""

import hashlib
import json
import threading
from functools import partial
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer

import pytest
from outside_files import RECORDINGS, needs
from scenario_files import refusal

from tiltcal.cli import main
from tiltcal.core.assets import folder
from tiltcal.core.errors import TiltcalError
from tiltcal.laboratory.scenario import load_scenario
from tiltcal.recordings import datasets as room
from tiltcal.recordings.datasets import Dataset, PublishedFile, datasets, fetch, find_dataset
from tiltcal.recordings.mapping import load_mapping

TEXT = b"".join(b"%d,%d,9.8\n" % (k % 3, k % 5) for k in range(200))


class Quiet(SimpleHTTPRequestHandler):
    asked: list[str] = []

    def do_GET(self):
        self.asked.append(self.path)
        super().do_GET()

    def log_message(self, *_):
        pass


@pytest.fixture
def server(tmp_path):
    """The address of a server and the folder that it serves."""
    served = tmp_path / "served"
    served.mkdir()
    Quiet.asked.clear()
    with ThreadingHTTPServer(("127.0.0.1", 0), partial(Quiet, directory=served)) as running:
        thread = threading.Thread(target=running.serve_forever)
        thread.start()
        yield f"http://127.0.0.1:{running.server_port}", served
        running.shutdown()
        thread.join()


@pytest.fixture
def tumble(monkeypatch):
    """A data set of one small file."""
    made = Dataset(
        name="tumble",
        title="a small one",
        repository="someone/logs",
        commit="0123456789",
        folder="data",
        licence="MIT",
        import_file="log.csv",
        mapping="mpu9150_map.toml",
        scenario="mpu9150.toml",
        file=(
            PublishedFile(name="log.csv", bytes=len(TEXT), sha256=hashlib.sha256(TEXT).hexdigest()),
        ),
    )
    monkeypatch.setattr(room, "datasets", lambda: {"tumble": made})
    return made


@pytest.mark.usefixtures("tumble")
def test_a_file_is_fetched_once_and_checked(server, tmp_path, capsys):
    address, served = server
    (served / "log.csv").write_bytes(TEXT)
    words = ["datasets", "get", "tumble", "--from", address, "-o", str(tmp_path / "got"), "--json"]
    for _ in range(2):
        assert main(words) == 0
        found = json.loads(capsys.readouterr().out)
        assert found["files"] == [str(tmp_path / "got" / "log.csv")]
    assert (tmp_path / "got" / "log.csv").read_bytes() == TEXT
    assert Quiet.asked == ["/log.csv"]


def test_a_spoilt_file_in_place_is_fetched_again(server, tumble, tmp_path):
    address, served = server
    (served / "log.csv").write_bytes(TEXT)
    (tmp_path / "log.csv").write_bytes(TEXT[:-1])
    assert fetch(tumble, tmp_path, address)[0].read_bytes() == TEXT


def test_another_content_is_refused_and_leaves_nothing(server, tumble, tmp_path, capsys):
    address, served = server
    (served / "log.csv").write_bytes(TEXT + b"x")
    words = ["datasets", "get", "tumble", "-o", tmp_path / "got"]
    for place in (address, served):
        message = refusal([*words, "--from", place], tmp_path, capsys)
        assert "found another content at" in message
        assert f"need SHA-256 {tumble.file[0].sha256}" in message


@pytest.mark.usefixtures("tumble")
def test_a_file_that_is_not_there_is_refused(server, tmp_path, capsys):
    address, served = server
    words = ["datasets", "get", "tumble", "-o", tmp_path / "got"]
    message = refusal([*words, "--from", address], tmp_path, capsys)
    assert "does not answer with the file (HTTPError)" in message
    message = refusal([*words, "--from", "http://127.0.0.1:9"], tmp_path, capsys)
    assert "does not answer with the file (ConnectionError)" in message
    assert "no file" in refusal([*words, "--from", served], tmp_path, capsys)


def test_a_folder_serves_as_well(tumble, tmp_path):
    (tmp_path / "log.csv").write_bytes(TEXT)
    (path,) = fetch(tumble, tmp_path / "got", str(tmp_path))
    assert path.read_bytes() == TEXT


def test_the_list_states_source_commit_licence_and_size(capsys):
    assert main(["datasets", "list"]) == 0
    said = capsys.readouterr().out
    for words in ("xsens_mti", "Kyle-ak/imu_tk @ 7780270fb9", "BSD-3-Clause", "6.7 MB"):
        assert words in said
    assert main(["datasets", "list", "--json"]) == 0
    listed = json.loads(capsys.readouterr().out)
    assert {d["name"] for d in listed} == set(datasets())
    assert all(len(f["sha256"]) == 64 for d in listed for f in d["file"])


def test_an_unknown_name_or_place_is_said(tmp_path, capsys):
    with pytest.raises(TiltcalError, match="did you mean 'mpu9150'"):
        find_dataset("mpu9151")
    message = refusal(["datasets", "get", "thermal_cycle"], tmp_path, capsys)
    assert "no known address in tofupilot/examples at fc190f7cd5" in message
    assert "9e715f32362f76783678862bbfa60ce2d6b668dafb9fc104d69aaafcb2f301d0" in message
    assert "found no name" in refusal(["datasets", "get"], tmp_path, capsys)


@pytest.mark.parametrize("name", datasets())
def test_each_has_a_mapping_and_a_scenario(name):
    dataset, real = datasets()[name], folder("scenarios") / "real"
    mapping = load_mapping(real / dataset.mapping)
    scenario = load_scenario(real / dataset.scenario)
    sensors = {c.to.partition("_")[0] for c in mapping.column} - {"temperature"}
    assert {s.name for s in scenario.sensor} <= sensors


@needs(RECORDINGS)
@pytest.mark.parametrize("name", datasets())
def test_the_digests_are_those_of_the_published_files(name, tmp_path):
    paths = fetch(datasets()[name], tmp_path, str(RECORDINGS / name))
    sizes = {f.name: f.bytes for f in datasets()[name].file}
    assert {p.name: p.stat().st_size for p in paths} == sizes
