"""Noise that follows an angle or a cycle is noted; bursts, and noise that follows motion, time or
what the sensor feels, are not.
"""

import numpy as np
import pytest
from diagnosis_fixtures import bench, honest, recorded, rewritten
from scipy.stats import norm

from tiltcal.diagnosis.diagnose import diagnose
from tiltcal.diagnosis.residual_checks.varying_noise import (
    SECTORS,
    SIZES,
    likeliest_cycle,
    log_agreement,
    noisy_sectors,
    parts_agree,
)
from tiltcal.diagnosis.search.explained import DOUBTED
from tiltcal.laboratory.scenario import parse_scenario
from tiltcal.recordings.recording import Recording

WHITE = float(np.degrees(25e-6 * np.sqrt(10.0)))  # of a sample, deg
TOLD = np.log(DOUBTED / (1 - DOUBTED) / 0.125 * 2)
"""Least Bayes factor of one of two candidates that is told as a doubt."""
TIME = np.arange(6000) / 20.0


def test_the_noisy_sectors_may_lie_on_both_sides_of_nothing():
    sums = np.full(SECTORS, -1.0)
    sums[[22, 23, 0, 1]] = 5.0
    assert noisy_sectors(sums).tolist() == [22, 23, 24, 25]


def notes_of(found) -> list[str]:
    """Those that tell of noise in a sector or a cycle."""
    return [n for n in found.notes if "of the outer angle" in n or "of each cycle" in n]


def centred(size):
    return (size - size.mean()) / size.std()


@pytest.mark.parametrize("z", [-2.0, 0.5, 6.0])
def test_the_bayes_factor_of_agreement_is_that_of_a_positive_mean(z):
    """Half normal about zero, of one of several widths."""
    mean = np.linspace(0, 400, 400001)
    priors = [2 * norm.pdf(mean, 0, width) for width in SIZES]
    likelihood = np.exp(-((z - mean) ** 2) / 2 + z**2 / 2)
    expected = np.mean([np.trapezoid(p * likelihood, mean) for p in priors])
    assert np.exp(log_agreement(z)) == pytest.approx(expected, rel=1e-3)


def noise_of(kind, rng):
    noise = rng.standard_normal(len(TIME))
    if kind == "bursts":
        for first in rng.integers(0, 5700, 5):
            noise[first : first + 200] *= 4
    if kind == "heavy tails":
        noise = np.clip(rng.standard_t(2.5, len(TIME)) / 2, -4, 4)
    if kind == "wandering level":
        level = np.convolve(rng.standard_normal(len(TIME)), np.ones(600) / np.sqrt(600))
        noise = np.clip(noise * np.exp(0.5 * level[: len(TIME)]), -4, 4)
    return noise


@pytest.mark.parametrize("kind", ["white", "bursts", "heavy tails", "wandering level"])
def test_noise_of_any_kind_has_no_cycle(kind, rng):
    factors = [likeliest_cycle(TIME, centred(noise_of(kind, rng) ** 2))[1] for _ in range(60)]
    assert max(factors) < TOLD + np.log(60)  # of so many trials
    assert sum(factor > TOLD for factor in factors) <= 3


@pytest.mark.parametrize("kind", ["white", "bursts", "heavy tails"])
def test_parts_of_noise_agree_by_chance_only(kind, rng):
    """A burst in one part makes no other one noisy. One in a thousand normal scores is beyond
    3.3.
    """
    turn = TIME / 50.0  # six turns
    scores = [parts_agree(centred(noise_of(kind, rng) ** 2), turn) for _ in range(200)]
    assert np.mean(np.square(scores)) < 1 + 4 * np.sqrt(2 / 200)
    assert max(scores) < 4.0


def with_noise(whole: Recording, factor, rng) -> Recording:
    """The recording with noise of other sizes beside its own, the same on all channels. factor: of
    the standard deviation, at least 1, (n,).
    """
    more = WHITE * np.sqrt(factor**2 - 1)
    columns = [n for n in whole.column_names if n.startswith("incl")]
    return rewritten(
        whole, **{n: whole.column(n) + more * rng.standard_normal(len(more)) for n in columns}
    )


@pytest.fixture(scope="module")
def turned():
    """Two turns of a vertical table by steps, there and back."""
    truth = bench(table="vertical", sensor="incl")
    return honest(truth), recorded(truth, 4)


def test_noise_of_a_sector_is_noted(rng):
    """Of eight turns, each at another rate: what follows the angle is no cycle."""
    turns = [
        {"action": "move", "outer_deg": 360.0 * (k + 1), "rate_deg_s": 17.0 + 7.0 * (k % 5)}
        for k in range(8)
    ]
    truth = bench(table="vertical", sensor="incl")
    truth = parse_scenario(truth.model_dump(by_alias=True, exclude_none=True) | {"sequence": turns})
    scenario, whole = honest(truth), recorded(truth, 4)
    angle = whole.column("table_outer_deg") % 360
    noisy = np.where((angle > 100) & (angle < 200), 1.8, 1.0)
    found = diagnose(scenario, [with_noise(whole, noisy, rng)])
    assert found.verdict == "match"
    assert "the noise of incl x, y is" in " ".join(notes_of(found))
    assert "deg of the outer angle as elsewhere" in " ".join(notes_of(found))


def test_noise_of_a_cycle_is_noted(turned, rng):
    scenario, whole = turned
    noisy = np.where(whole.time % 9.1 < 3.0, 1.8, 1.0)
    found = diagnose(scenario, [with_noise(whole, noisy, rng)])
    assert found.verdict == "match"
    (note,) = notes_of(found)
    period = note.partition("in one part of each cycle of ")[2].split()[0]
    assert float(period) == pytest.approx(9.1, rel=0.01)


@pytest.mark.parametrize("kind", ["moving", "settling", "bursts"])
def test_noise_of_motion_and_bursts_is_none(turned, kind, rng):
    scenario, whole = turned
    angle = whole.column("table_outer_deg")
    moving = np.abs(np.gradient(angle)) > 0.01
    since = whole.time - np.maximum.accumulate(np.where(moving, whole.time, 0.0))
    noisy = {
        "moving": np.where(moving, 1.8, 1.0),
        "settling": 1 + 1.5 * np.exp(-since / 0.8),
        "bursts": np.where(np.abs(whole.time[:, None] - [20.0, 77.0, 130.0]).min(1) < 4, 3.0, 1.0),
    }[kind]
    found = diagnose(scenario, [with_noise(whole, noisy, rng)])
    assert found.verdict == "match", found.statement
    assert not notes_of(found)


def test_fewer_rows_than_parts_say_nothing():
    assert parts_agree(np.ones(12), 2.3 * np.arange(12.0)) == 0.0
    assert likeliest_cycle(np.arange(12.0), np.ones(12)) == (0.0, -np.inf)


def test_noise_of_a_temperature_that_swings_is_no_cycle(rng):
    """It grows sixfold with the temperature: the swing and its harmonics are in the noise."""
    truth = bench(table="vertical", sensor="incl", swing_degC=3.0, period_s=21.0)
    whole = recorded(truth, 4)
    warm = whole.column("temperature_degC")
    noisy = np.exp(0.3 * (warm - warm.min()))
    found = diagnose(honest(truth), [with_noise(whole, noisy, rng)])
    assert found.verdict == "match", found.statement
    assert not notes_of(found)


def test_four_turns_that_agree_score_the_root_of_six():
    """Six pairs of equal turns: their sum over the root of the sum of their squares."""
    phase = np.arange(4 * 240) / 240.0
    assert parts_agree(np.sin(2 * np.pi * phase), phase) == pytest.approx(np.sqrt(6))
