"""What moves at random makes channels vary together as the attitude has it; noise of their own, of
a common supply, of a common gain, or that follows the motion, does not.
"""

from itertools import pairwise

import numpy as np
import pytest
from diagnosis_fixtures import bench, honest, recorded, rewritten
from scipy.integrate import quad
from scipy.signal import butter, sosfilt
from statistics_helpers import mean_band

from tiltcal.core.frames import rotation
from tiltcal.diagnosis.data.observations import Channel
from tiltcal.diagnosis.diagnose import diagnose
from tiltcal.diagnosis.residual_checks.random_motion import (
    CrossPrediction,
    MotionSource,
    Octave,
    _factor,
    log_factor,
)

ROWS, RATE = 6000, 20.0


def stops(rng, count: int = 40) -> np.ndarray:
    """Angle of each row of a table that stops here and there, rad, (ROWS,)."""
    return np.repeat(rng.uniform(-np.pi, np.pi, count), ROWS // count)


def said_of(noise: np.ndarray, columns: np.ndarray) -> list[Octave]:
    """What the octaves of some channels say of what answers with these columns, (k, ROWS) each."""
    time, stop = np.arange(ROWS) / RATE, np.zeros(ROWS, np.intp)
    found = CrossPrediction(
        {
            k: (Channel(0, "accel", "xyz"[k], k, stop, time, left, stop), left, np.ones(ROWS))
            for k, left in enumerate(noise)
        }
    )
    factors = found.evidence(MotionSource("base", "environment", (dict(enumerate(columns)),)))
    ends = [(found.frequency(low), found.frequency(high)) for low, high in found.octaves]
    return [Octave(low, high, each) for (low, high), each in zip(ends, factors, strict=True)]


def slow(rng, low: float, high: float) -> np.ndarray:
    """Noise of variance one between two frequencies, Hz, (ROWS,)."""
    found = sosfilt(
        butter(2, (low, high), "bandpass", fs=RATE, output="sos"), rng.standard_normal(ROWS)
    )
    return found / found.std()


@pytest.mark.parametrize(
    ("cross", "energy"), [(30.0, 40.0), (-20.0, 9.0), (0.3, 0.5), (90.0, 60.0)]
)
def test_the_bayes_factor_is_the_mean_likelihood_ratio(cross, energy):
    """Of every part of what is predicted, by quadrature."""
    ratio, _ = quad(lambda a: np.exp(a * cross - a**2 * energy / 2), 0, 1)
    assert log_factor(cross, energy) == pytest.approx(np.log(ratio), abs=1e-6)


def test_octaves_follow_each_other_down_to_the_slowest(rng):
    octaves = said_of(rng.standard_normal((2, ROWS)), np.ones((2, ROWS)))
    assert octaves[0].high == pytest.approx(RATE / 2)
    assert all(slower.high == faster.low for faster, slower in pairwise(octaves))
    assert all(octave.high == pytest.approx(2 * octave.low) for octave in octaves[:-1])
    # 6016 stamps are 47 x 2^7: one cycle in two recordings of that length
    assert octaves[-1].low == pytest.approx(RATE / (2 * 6016))


@pytest.mark.parametrize(
    "kind",
    ["its own", "of a supply", "of a supply, slow", "of a gain", "with the input", "flicker"],
)
def test_noise_holds_no_motion(kind, rng):
    """A Bayes factor of a thousand comes once in a thousand at most, as of any true one."""
    highest = -np.inf
    for _ in range(40):
        angle = stops(rng)
        noise = rng.standard_normal((2, ROWS))
        if kind == "of a supply":
            noise[1] += 0.8 * noise[0]
        elif kind == "of a supply, slow":
            noise += 0.5 * slow(rng, 0.02, 0.3)
        elif kind == "of a gain":
            noise += 0.5 * rng.standard_normal(ROWS) * np.array([np.sin(angle), np.cos(angle)])
        elif kind == "with the input":
            noise *= 1 + np.abs([np.sin(angle), np.cos(angle)])
        elif kind == "flicker":
            noise += np.array([slow(rng, 0.01, 0.1), slow(rng, 0.02, 0.2)])
        columns = np.array([np.cos(angle), -np.sin(angle)])
        highest = max(highest, _factor(said_of(noise, columns)))
    assert highest < np.log(1000)


def test_a_true_bayes_factor_is_one_on_average_in_noise(rng):
    """Of hypotheses with a free number it is below one in most recordings."""
    factors = []
    for _ in range(150):
        angle = stops(rng)
        columns = np.array([np.cos(angle), -np.sin(angle)])
        factors.append(_factor(said_of(rng.standard_normal((2, ROWS)), columns)))
    each = np.exp(factors)
    assert each.mean() < 1 + mean_band(each)
    assert np.median(factors) < 0


def test_a_sway_is_seen_in_its_octave(rng):
    angle = stops(rng)
    columns = np.array([np.cos(angle), -np.sin(angle)])
    noise = rng.standard_normal((2, ROWS)) + slow(rng, 0.12, 0.3) * columns
    octaves = said_of(noise, columns)
    assert _factor(octaves) > np.log(1e4)
    used = [octave for octave in octaves if octave.probability > 0.9]
    assert min(octave.low for octave in used) < 0.3
    assert max(octave.high for octave in used) > 0.12
    assert max(octave.high for octave in used) < 1.3


@pytest.mark.parametrize("moves", [True, False], ids=["the base", "each channel by itself"])
def test_a_base_that_sways_at_random_is_a_finding_without_a_name(moves, rng):
    """A sway of 12 arcsec about both axes of the room, turned into the body by hand; or as much
    noise of each channel by itself.
    """
    truth = bench()
    whole = recorded(truth, 6)
    rows, rate = len(whole.time), 1 / float(np.median(np.diff(whole.time)))
    band = butter(2, (0.08, 0.4), "bandpass", fs=rate, output="sos")
    sway = sosfilt(band, rng.standard_normal((3, rows)))
    sway *= 12 * np.pi / 648000 * 9.81 / sway.std(axis=1)[:, None]
    outer, inner = (np.radians(whole.column(f"table_{axis}_deg")) for axis in ("outer", "inner"))
    for k in range(rows if moves else 0):
        body = (rotation("x", outer[k]) @ rotation("z", inner[k])).T
        sway[:, k] = body @ np.array([sway[0, k], sway[1, k], 0.0])
    columns = {
        f"accel_{axis}_m_s2": whole.column(f"accel_{axis}_m_s2") + sway[k]
        for k, axis in enumerate("xyz")
    }
    found = diagnose(honest(truth), [rewritten(whole, **columns)])
    moved = [f for f in found.findings if "Random motion" in f.statement]
    assert bool(moved) == moves
    for finding in moved:
        assert found.verdict == "unlisted"
        assert finding.stage in ("environment", "mount")
        assert not finding.parts
