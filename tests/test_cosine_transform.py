"""Cosine transforms against their defining sum, and lengths that are quick to transform."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from tiltcal.statistics.cosine_transform import SHORT, cosines, inverse_cosines, quick_length


def test_coefficients_are_the_defining_sum_and_invert() -> None:
    column = np.array([0.3, -1.2, 0.5, 2.0, -0.7])
    k, t = np.arange(5)[:, None], np.arange(5)
    by_hand = np.sqrt(2 / 5) * np.cos(np.pi * k * (2 * t + 1) / 10) @ column
    by_hand[0] /= np.sqrt(2)
    assert_allclose(cosines(column), by_hand, atol=1e-15)
    assert_allclose(inverse_cosines(by_hand), column, atol=1e-15)


@pytest.mark.parametrize(
    ("n", "length"),
    [
        (1009, 2**4 * 3**2 * 7),
        (8761, 2 * 5**4 * 7),  # 8751 to 8761 have the factors 2917, 547, 8753, 1459, 103, 199, ...
        (60000, 60000),
    ],
)
def test_a_quick_length_is_the_next_one_below_with_small_factors(n: int, length: int) -> None:
    assert quick_length(n) == length


def test_little_is_left_out_and_nothing_of_a_short_record() -> None:
    lost = [1 - quick_length(n) / n for n in range(3000, 12000)]
    assert max(lost) < 0.01
    assert np.mean(lost) < 1e-3
    assert [quick_length(n) for n in (0, 1, 97, SHORT - 1)] == [0, 1, 97, SHORT - 1]
