"""Fixtures that all tests share."""

import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from diagnosis_fixtures import bench, recorded
from scenario_files import make_files
from statistics_helpers import rng_of


@pytest.fixture(autouse=True)
def wide(monkeypatch: pytest.MonkeyPatch) -> None:
    """Tables are as wide as on a wide terminal, so that tests see each row in one line."""
    monkeypatch.setenv("COLUMNS", "160")


@pytest.fixture
def rng(request: pytest.FixtureRequest) -> np.random.Generator:
    """A random stream fixed by the test's own name."""
    return rng_of(request.node.name)


@pytest.fixture(scope="session")
def good(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a scenario and all that the commands make of it; nobody writes there."""
    return make_files(tmp_path_factory.mktemp("good"))


@pytest.fixture
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """An empty working directory."""
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.fixture(scope="module")
def truth():
    """The instrument of the diagnosis tests, as it is."""
    return bench()


@pytest.fixture(scope="module")
def sound(truth):
    """A recording of it without any fault."""
    return recorded(truth, 5)


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    """Debian's Chromium; nothing is downloaded."""
    found = shutil.which("chromium") or shutil.which("chromium-browser")
    if found is None:
        pytest.skip("no Chromium on this machine: no page is looked at")
    sync_api = pytest.importorskip("playwright.sync_api", reason="playwright is not installed")
    with sync_api.sync_playwright() as play:
        started = play.chromium.launch(executable_path=found, args=["--no-sandbox"])
        yield started
        started.close()
