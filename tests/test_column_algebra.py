"""Inner products instead of projected columns: the same energies, with less at hand."""

import numpy as np
import pytest

from tiltcal.diagnosis.model import column_store
from tiltcal.diagnosis.model.block_matrix import (
    BlockDesignMatrix,
    basis_of,
    columns_of,
    project,
    projected,
)
from tiltcal.diagnosis.model.column_store import TriedShapes
from tiltcal.diagnosis.model.normal_equations import explained_beside, left_beside

LENGTHS = (60, 45)


@pytest.fixture
def model():
    """Columns of one channel and of both, a basis that couples the channels, and a target free of
    it.
    """
    rng = np.random.default_rng(5)
    own = [{i: rng.normal(size=n)} for i, n in enumerate(LENGTHS) for _ in range(3)]
    shared = [{i: rng.normal(size=n) for i, n in enumerate(LENGTHS)} for _ in range(2)]
    fitted = [{0: rng.normal(size=60)}, {i: rng.normal(size=n) for i, n in enumerate(LENGTHS)}]
    basis = basis_of(fitted, LENGTHS)
    target = project(basis, [rng.normal(size=n) for n in LENGTHS])
    return [*own, *shared], basis, target


def energy(columns, basis, target):
    """By columns that are projected one by one."""
    mine = basis_of([projected(basis, c, LENGTHS) for c in columns], LENGTHS)
    along = sum(U.T @ r for U, r in zip(mine, target, strict=True))
    return float(along @ along)


def test_what_columns_explain_beside_a_basis(model):
    columns, basis, target = model
    expected = energy(columns, basis, target)
    assert 0 < expected < sum(float(r @ r) for r in target)
    assert explained_beside(columns, basis, target) == pytest.approx(expected)
    together = BlockDesignMatrix([*columns_of(basis), *columns], LENGTHS)
    assert together.explained(target) == pytest.approx(expected)


def test_what_columns_leave_beside_a_basis_is_the_rest_of_the_energy(model):
    columns, basis, target = model
    left = left_beside(columns, basis, target)
    mine = basis_of([projected(basis, c, LENGTHS) for c in columns], LENGTHS)
    for i, expected in enumerate(project(mine, target)):
        np.testing.assert_allclose(left[i], expected, atol=1e-12)
    only = left_beside([{1: columns[-1][1]}], basis, target)
    assert list(only) == [1]


def test_a_column_within_the_basis_explains_nothing(model):
    _, basis, target = model
    inside = {i: 3 * B[:, 1] for i, B in enumerate(basis)}
    assert explained_beside([inside], basis, target) == 0


def test_shapes_are_kept_as_far_as_memory_goes(monkeypatch):
    waves = np.zeros((1, 100), np.float32)
    monkeypatch.setattr(column_store, "MOST", 2 * waves.nbytes)
    asked, known = [], TriedShapes()
    for key in "abacab":
        known.of(key, lambda key=key: asked.append(key) or {0: ([0], waves)})
    assert asked == ["a", "b", "c", "b"]
