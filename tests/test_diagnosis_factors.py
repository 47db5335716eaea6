"""Curves that act at many places are kept as factors: what is said of them is what their columns
say.
"""

import numpy as np
import pytest
from builders import ACCEL, GYRO, setup_of

from tiltcal.diagnosis.data.block_grid import BlockGrid, Sampling
from tiltcal.diagnosis.data.observations import Observations
from tiltcal.diagnosis.data.table_channels import TableObservations
from tiltcal.diagnosis.hypotheses.curve_forms import curve_over
from tiltcal.diagnosis.model.column_store import Weighed
from tiltcal.diagnosis.model.hypothesis_columns import HypothesisColumns
from tiltcal.effects.learned import LearnedReading, LearnedReadout, LearnedTilt
from tiltcal.laboratory.laboratory import SimulatedLaboratory
from tiltcal.laboratory.scenario import parse_scenario
from tiltcal.statistics.cosine_transform import cosines

STEPS = [
    {
        "action": "move",
        "outer_deg": 100.0 * k % 360,
        "inner_deg": 70.0 * k % 360,
        "rate_deg_s": 40,
        "dwell_s": 2,
    }
    for k in range(4)
]
BOTH = {"coordinate": "table_outer", "beside": "table_inner"}
PLACES = {
    "reading": (LearnedReading, {"sensor": "accel", "axis": "y"}),
    "readout": (LearnedReadout, {"axis": "outer", "place": "table"}),
    "mount": (LearnedTilt, {"slot": "mount", "turn": "x", "place": "mount"}),
    "base": (LearnedTilt, {"slot": "base", "turn": "y", "place": "environment"}),
}


@pytest.fixture(scope="module", params=[1, 4], ids=["samples", "blocks"])
def observations(request):
    """Sensors with a lever arm, which tell the rate and the acceleration of a turn."""
    sensors = (s.model_copy(update={"rate_hz": 20}) for s in (ACCEL, GYRO))
    stated = setup_of("dual", *sensors).model_dump(exclude_none=True)
    stated["rig"]["lever_arm_m"] = [0.1, -0.2, 0.3]
    scenario = parse_scenario({"schema": 1, **stated, "sequence": STEPS})
    recording = SimulatedLaboratory().record(scenario, 3)
    return TableObservations(scenario, [recording], ()).averaged(request.param)


def product(place):
    """A product of two angles at a place."""
    cls, where = PLACES[place]
    return curve_over(cls, BOTH["coordinate"], 36, beside=BOTH["beside"], **where)


def dense(observations, hypothesis):
    """Its columns, their rows weighed, worked out one by one: (36, n) by channel."""
    one_by_one = Observations.columns(observations, hypothesis.effect, hypothesis.names, ())
    found = {}
    for i, (which, block) in one_by_one.items():
        found[i] = np.zeros((36, block.shape[1]))
        found[i][which] = observations.channels[i].weighed(block)
    return found


def of_single_curve(place):
    cls, where = PLACES[place]
    return curve_over(cls, "table_inner", (-1.0, 0.5, 2.0, 5.0), **where)


@pytest.mark.parametrize("place", PLACES)
@pytest.mark.parametrize("curve", [product, of_single_curve], ids=["product", "spline"])
def test_all_columns_of_a_curve_are_the_changes_one_by_one(observations, place, curve):
    hypothesis = curve(place)
    names = hypothesis.names
    found = observations.columns(hypothesis.effect, names, ())
    expected = Observations.columns(observations, hypothesis.effect, names, ())
    assert found.keys() == expected.keys()
    for i, (which, block) in expected.items():
        assert found[i][0] == which
        np.testing.assert_allclose(found[i][1], block, atol=1e-9 * np.abs(block).max())


@pytest.mark.parametrize("place", PLACES)
def test_factors_say_what_the_columns_say(observations, place):
    hypothesis, expected = product(place), dense(observations, product(place))
    factors = observations.factors(hypothesis.effect, hypothesis.names, ())
    assert factors.keys() == expected.keys()
    for i, columns in expected.items():
        scale = np.abs(columns).max()
        np.testing.assert_allclose(factors[i].columns(), columns, atol=1e-6 * scale)
        vectors = np.random.default_rng(i).normal(size=(columns.shape[1], 3))
        at = factors[i].adjoint(vectors.astype(np.float32))
        answered = zip(factors[i].answers, factors[i].curve.parts, strict=True)
        along = sum(part @ (a[:, None] * at) for a, part in answered if a is not None)
        size = scale * np.sqrt(columns.shape[1])
        np.testing.assert_allclose(along, columns @ vectors, atol=1e-5 * size)


def test_only_a_whole_product_of_two_angles_is_kept_as_factors(observations):
    whole, single = product("mount"), of_single_curve("mount")
    assert observations.factors(whole.effect, whole.names[:5], ()) is None
    assert observations.factors(single.effect, single.names, ()) is None


def test_a_product_is_kept_once_for_all_places(observations):
    curves = {
        id(f.curve)
        for place in PLACES
        for f in observations.factors(product(place).effect, product(place).names, ()).values()
    }
    assert len(curves) == 1


@pytest.mark.parametrize("vectors", [2, 30], ids=["few", "many"])
@pytest.mark.parametrize("white", [True, False], ids=["white", "coloured"])
def test_blocks_of_factors_weigh_as_blocks_of_columns(observations, vectors, white):
    rng = np.random.default_rng(4)
    hypotheses = [product(place) for place in PLACES]
    columns = HypothesisColumns(observations)
    for hypothesis in hypotheses:
        columns.add(hypothesis, ())
    blocks = columns.blocks(np.ones(len(hypotheses), bool))
    assert {b.channel for b in blocks} == set(range(len(observations.channels)))
    for block in blocks:
        n = len(observations.channels[block.channel].values)
        weight = (np.ones(n) if white else rng.uniform(0.5, 2.0, n)).astype(np.float32)
        waves = rng.normal(size=(n, vectors)).astype(np.float32)
        kept = {k: dense(observations, hypotheses[k]) for k in set(block.owners.tolist())}
        U = np.vstack([cosines(kept[k][block.channel]) for k in dict.fromkeys(block.owners)])
        size = np.abs(U).max() * np.sqrt(n)
        np.testing.assert_allclose(block.along(Weighed(waves)), U @ waves, atol=1e-4 * size)
        np.testing.assert_allclose(block.waves_of(slice(3, 9)), U[3:9], atol=1e-5 * size)
        ((numbers, grams),) = block.grams(weight)
        for k, (own, gram) in enumerate(zip(numbers, grams, strict=True)):
            mine = U[36 * k : 36 * k + 36] * weight
            first = columns.starts[block.owners[36 * k]]
            assert own.tolist() == list(range(first, first + 36))
            np.testing.assert_allclose(gram, mine @ mine.T, atol=1e-4 * np.abs(gram).max())


@pytest.mark.parametrize("place", PLACES)
def test_the_columns_of_some_sizes_are_those_of_each_alone(observations, place):
    columns, hypothesis = HypothesisColumns(observations), product(place)
    names = ("c30", "c2", "c7")
    together = columns.all_waves(hypothesis, names, ())
    for found, name in zip(together, names, strict=True):
        expected = columns.waves(hypothesis, name, ())
        assert found.keys() == expected.keys()
        for i, wave in expected.items():
            np.testing.assert_allclose(found[i], wave, atol=1e-9 * np.abs(wave).max())


@pytest.mark.parametrize("rows", [slice(None), np.array([0, 2, 2])], ids=["all", "some"])
def test_inner_products_with_samples_are_those_with_the_adjoint(rows, rng):
    grid = BlockGrid(
        np.arange(7.0), np.array([0, 3, 5]), np.array([0.2, 0.3, 0.5, 0.4, 0.6, 0.1, 0.9])
    )
    sampling = Sampling(grid, rows)
    values, vectors = rng.normal(size=(7, 2)), rng.normal(size=(3, 4))
    np.testing.assert_allclose(
        sampling.of(values).T @ vectors, values.T @ sampling.adjoint(vectors), atol=1e-12
    )
