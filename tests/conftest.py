"""Fixtures that all tests share."""

import numpy as np
import pytest
from statistics_helpers import rng_of


@pytest.fixture
def rng(request: pytest.FixtureRequest) -> np.random.Generator:
    """A random stream fixed by the test's own name."""
    return rng_of(request.node.name)
