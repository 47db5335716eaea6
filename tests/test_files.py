"""Files are read or refused with a reason, and written whole or not at all."""

import json
import os
import stat

import numpy as np
import pytest

from tiltcal.core import assets
from tiltcal.core.errors import TiltcalError
from tiltcal.core.files import make_folder, replacing, require_file, write_json, write_text
from tiltcal.recordings.recording import Recording
from tiltcal.recordings.saving import write_recording


def names(folder):
    return sorted(p.name for p in folder.iterdir())


def test_a_file_that_is_there_is_taken(tmp_path):
    (tmp_path / "a.csv").touch()
    assert require_file(tmp_path / "a.csv", "recording") == tmp_path / "a.csv"


def test_a_folder_or_a_missing_file_is_refused(tmp_path):
    with pytest.raises(
        TiltcalError, match=r"recording .*: found a folder, need a file; name the file itself"
    ):
        require_file(tmp_path, "recording")
    with pytest.raises(
        TiltcalError,
        match=r"scenario .*a\.toml: found no such file, need an existing file; check the path",
    ):
        require_file(tmp_path / "a.toml", "scenario")


def test_a_file_that_may_not_be_read_is_refused(tmp_path, monkeypatch):
    (tmp_path / "a.csv").touch()
    monkeypatch.setattr(os, "access", lambda *_: False)  # root may read everything
    with pytest.raises(
        TiltcalError, match="found no permission to read, need a readable file; change its mode"
    ):
        require_file(tmp_path / "a.csv", "recording")


def test_what_is_written_takes_its_name_at_the_end_with_ordinary_permissions(tmp_path):
    path = tmp_path / "out.json"
    mask = os.umask(0o022)
    try:
        with replacing(path) as temporary:
            temporary.write_text("{}")
            assert not path.exists()
    finally:
        os.umask(mask)
    assert names(tmp_path) == ["out.json"]
    assert stat.S_IMODE(path.stat().st_mode) == 0o644


def fail_half_way(path):
    with replacing(path) as temporary:
        temporary.write_text("new")
        raise RuntimeError("half way")


def test_a_failure_on_the_way_leaves_the_old_file_and_nothing_else(tmp_path):
    path = tmp_path / "out.txt"
    path.write_text("old")
    with pytest.raises(RuntimeError, match="half way"):
        fail_half_way(path)
    assert names(tmp_path) == ["out.txt"]
    assert path.read_text() == "old"


def test_a_full_disk_is_reported_and_leaves_nothing(tmp_path):
    with (
        pytest.raises(
            TiltcalError,
            match="found no space left on device, need free space and permission to write",
        ),
        replacing(tmp_path / "a.csv"),
    ):
        raise OSError(28, "No space left on device")
    assert names(tmp_path) == []


def test_a_place_that_cannot_be_written_is_refused(tmp_path):
    (tmp_path / "file").touch()
    with pytest.raises(TiltcalError, match="found a folder, need a file name"):
        write_text(tmp_path, "x")
    with pytest.raises(
        TiltcalError,
        match=(
            "found no such file or directory, need a folder that can be written; choose another"
            " location"
        ),
    ):
        write_text(tmp_path / "nowhere" / "a.txt", "x")
    with pytest.raises(TiltcalError, match="found not a directory"):
        write_recording(Recording(np.zeros(1)), tmp_path / "file" / "a.csv")
    assert names(tmp_path) == ["file"]


@pytest.mark.parametrize("suffix", [".csv", ".parquet", ".npz"])
def test_a_recording_that_cannot_be_written_leaves_nothing(suffix, tmp_path, monkeypatch):
    broken = Recording(np.zeros(2), labels=np.array([object(), object()], object))
    monkeypatch.setattr(Recording, "column_names", property(lambda _: ["absent_g"]))
    with pytest.raises(TiltcalError, match="column absent_g"):
        write_recording(broken, tmp_path / f"a{suffix}")
    assert names(tmp_path) == []


def test_json_is_json_to_the_end_of_the_line(tmp_path):
    write_json(tmp_path / "a.json", {"a": [1.5, None]})
    text = (tmp_path / "a.json").read_text()
    assert json.loads(text) == {"a": [1.5, None]}
    assert text.endswith("}\n")
    with pytest.raises(ValueError, match="not JSON compliant"):
        write_json(tmp_path / "b.json", {"a": float("nan")})
    assert names(tmp_path) == ["a.json"]


def test_folders_are_made_with_their_parents_unless_a_file_is_in_the_way(tmp_path):
    assert make_folder(tmp_path / "a" / "b").is_dir()
    assert make_folder(tmp_path / "a" / "b").is_dir()
    (tmp_path / "file").touch()
    with pytest.raises(
        TiltcalError, match="found file exists, need a folder; choose another location"
    ):
        make_folder(tmp_path / "file")


def test_the_models_are_found_and_a_missing_folder_is_named():
    assert (assets.folder("models") / "three.xml").exists()
    with pytest.raises(
        TiltcalError, match="found no folder 'marbles', need the packaged data; reinstall tiltcal"
    ):
        assets.folder("marbles")
