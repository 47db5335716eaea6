"""The grid of codes that a column lies on."""

import numpy as np
import pytest

from tiltcal.core.quantisation import lsb_grid


def coded(rng, width, digits, n=2000):
    return np.round(
        width * np.rint(rng.normal(0, 200, n) + 300 * np.sin(np.arange(n) / 90)), digits
    )


@pytest.mark.parametrize("width", [0.001923606, 0.05, 3.05e-3])
def test_the_code_behind_rounded_text_is_found(width, rng):
    assert lsb_grid(coded(rng, width, 5)) == pytest.approx(width, rel=1e-4)


def test_free_values_have_no_grid(rng):
    assert lsb_grid(rng.normal(size=2000)) is None


def test_too_few_steps_say_nothing():
    assert lsb_grid(np.repeat([0.0, 1.0, 2.0], 50)) is None
