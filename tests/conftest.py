"""Fixtures that all tests share."""

from pathlib import Path

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
