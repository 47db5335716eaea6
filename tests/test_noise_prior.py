"""What is known of the noise of instruments before it is read: grades, and axes that are alike."""

from dataclasses import replace

import numpy as np
import pytest
from diagnosis_fixtures import bench, honest, recorded
from statistics_helpers import rng_of

from tiltcal.diagnosis.data_faults.prepare import prepare
from tiltcal.diagnosis.diagnose import diagnose
from tiltcal.diagnosis.model.channel_noise import noise_under
from tiltcal.diagnosis.model.noise_prior import (
    ALIKE,
    AxisPrior,
    InstrumentPrior,
    instruments,
    unlike_others,
)
from tiltcal.recordings.recording import Recording
from tiltcal.statistics.cosine_transform import cosines
from tiltcal.statistics.noise_spectrum import WhiteFlickerWalk, estimate_noise

# bias instability of x, y and z, gyro and accelerometer, each in a unit of its own, as owners of
# these instruments published what imu_utils and allan_variance_ros made of hours at rest
TRIADS = {
    "Xsens MTi of a camera rig": ((8.736, 7.369, 8.728), (1.371, 1.091, 1.464)),
    "Xsens, another": ((4.753, 8.656, 5.915), (4.140, 3.803, 3.673)),
    "ZR300": ((1.801, 1.664, 1.486), (4.073, 2.147, 7.026)),
    "HI226": ((6.593, 19.832, 5.834), (1.760, 5.820, 3.434)),
    "ADIS16460": ((1.681, 1.647, 1.347), (0.228, 2.812, 4.264)),
    "DJI A3": ((3.377, 3.197, 2.258), (5.304, 6.028, 7.642)),
    "DJI N3": ((6.194, 5.797, 3.971), (4031, 6325, 9599)),
    "DJI M210": ((6.655, 4.592, 6.144), (29.96, 19.38, 3.296)),
    "RealSense D435i": ((2.844, 1.663, 1.325), (2.782, 9.147, 2.438)),
    "RealSense D435i, another": ((1.766, 4.882, 3.154), (7173, 19869, 6702)),
    "RealSense L515": ((5.795, 3.999, 1.337), (3869, 7164, 3869)),
    "uINS": ((2.656, 3.765, 2.573), (11.284, 6.069, 10.044)),
    "IMU of a camera": ((2.712, 3.777, 2.808), (1.006, 1.773, 3.522)),
    "IMU of a lidar": ((5.085, 3.765, 4.179), (1.073, 1.696, 1.245)),
    "IMU in the readme of imu_utils": ((9.852, 10.038, 9.510), (3.267, 3.186, 2.921)),
}
SAMPLES = 6000
WALK = 3e-3  # a sample, beside white noise of 1


def test_axes_of_published_instruments_are_as_far_apart_as_the_prior_says():
    spreads = [np.std(np.log(t), ddof=1) for triads in TRIADS.values() for t in triads]
    assert np.exp(np.sqrt(np.mean(np.square(spreads)))) == pytest.approx(ALIKE, abs=0.05)


def test_axes_that_are_apart_are_as_improbable_as_instruments_are_alike():
    """Two axes of a ratio of 4, their white noise alike: both halves say the same."""
    walks = [WhiteFlickerWalk(1.0, 0.0, walk) for walk in (1.0, 4.0)]
    expected = np.log(4.0) ** 2 / (4 * np.log(ALIKE) ** 2)
    assert priors(2).price(walks) == pytest.approx(expected, rel=1e-3)
    assert priors(3).price([walks[0]] * 3) == pytest.approx(0.0)


def test_slow_noise_may_go_with_the_white_noise_of_each_axis():
    """Then one half of instruments is as probable as can be."""
    models = [WhiteFlickerWalk(size, 0.0, size) for size in (1.0, 4.0)]
    by_size = np.log(4.0) ** 2 / (4 * np.log(ALIKE) ** 2)
    expected = -np.log((1 + np.exp(-by_size)) / 2)
    assert priors(2).price(models) == pytest.approx(expected, rel=1e-3)


def test_whether_slow_noise_goes_with_the_white_one_is_drawn_once_for_all_axes():
    """Three alike, whose walk is far above that of the worst grade beside their white noise, and
    below it by its size: of one half of instruments, not of an eighth.
    """
    axis = AxisPrior(25.0, SAMPLES, ((1e3, 1e-3), (1e3, 1e3)))
    models = [WhiteFlickerWalk(1.0, 0.0, 1.0)] * 3
    assert InstrumentPrior((0, 1, 2), (axis,) * 3).price(models) == pytest.approx(np.log(2))


@pytest.mark.parametrize("walk", [1e-4, 1e-2, 1.0])
def test_the_slope_of_the_prior_is_that_of_its_differences(walk):
    """Of the first of three axes, whose slow noise is below or above the worst grade."""
    axis = AxisPrior(25.0, SAMPLES, ((0.3, 0.1), (0.02, 0.3)))
    one = InstrumentPrior((0, 1, 2), (axis,) * 3)
    others = [WhiteFlickerWalk(1.0, 0.03, 0.01), WhiteFlickerWalk(2.0, 0.01, 0.02)]
    logs, step = np.log([1.3, 0.05**2, walk**2]), 1e-5

    def price(logs):
        return one.price([WhiteFlickerWalk(*np.sqrt(np.exp(logs))), *others])

    ends = [(price(logs + e), price(logs - e)) for e in step * np.eye(3)]
    expected = [(up - down) / (2 * step) for up, down in ends]
    model = WhiteFlickerWalk(*np.sqrt(np.exp(logs)))
    cost, slope, curvature = one.expanded([model, *others])
    assert cost == pytest.approx(price(logs))
    assert slope == pytest.approx(expected, abs=1e-6)
    assert np.linalg.eigvalsh(curvature).min() > -1e-12


def noise_fits(walks, seed):
    rng, found = rng_of(f"axes {seed}"), []
    for walk in walks:
        noise = rng.normal(0, 1, SAMPLES) + np.cumsum(rng.normal(0, walk, SAMPLES))
        found.append(estimate_noise(cosines(noise), np.zeros((SAMPLES, 0)), WhiteFlickerWalk))
    return found


def priors(count):
    worst = ((1e3, 1e3), (1e3, 1e3))  # no grade is below this noise
    axes = tuple(AxisPrior(25.0, SAMPLES, worst) for _ in range(count))
    return InstrumentPrior(tuple(range(count)), axes)


def test_axes_of_one_noise_are_not_unlike():
    """Over 12 instruments none comes near what a finding needs, 8 nats."""
    one, gains = priors(3), []
    for seed in range(12):
        fits = one.most_probable(noise_fits([WALK] * 3, seed))
        gains += [unlike_others(one, [k], fits)[0] for k in range(3)]
    assert max(gains) < 4.0


def test_an_axis_of_far_more_slow_noise_is_unlike_the_others():
    one = priors(3)
    fits = one.most_probable(noise_fits([WALK, 30 * WALK, WALK], 1))
    gain, times = unlike_others(one, [1], fits)
    assert gain > 8.0
    assert 10 < times < 60
    assert unlike_others(one, [0], fits)[1] < 1.0


def test_an_axis_alone_has_no_others():
    fits = noise_fits([WALK], 2)
    assert unlike_others(priors(1), [0], priors(1).most_probable(fits)) == (0.0, 1.0)


def test_the_most_probable_noise_of_the_axes_is_no_dearer_than_the_most_likely_one():
    one, fits = priors(3), noise_fits([WALK, 8 * WALK, WALK], 3)
    probable = one.most_probable(fits)
    assert one.cost(probable) <= one.cost(fits) + 1e-3
    levels = [
        [a.level(f.model) for a, f in zip(one.axes, x, strict=True)] for x in (fits, probable)
    ]
    assert np.ptp(levels[1]) < np.ptp(levels[0])


def test_an_axis_with_a_nameless_curve_is_not_compared():
    truth = bench()
    found = prepare(honest(truth), [recorded(truth, 1)])
    whitened = found.whitened.as_fitted(noise_under(found.start, found.whitened.columns))
    assert [one.which for one in instruments(whitened)] == [(0, 1, 2)]
    curved = replace(whitened, curved=frozenset({1}))
    assert sorted(one.which for one in instruments(curved)) == [(0, 2), (1,)]


def test_slow_variation_of_one_axis_is_a_finding():
    """Of a size that an instrument of a poor grade may have on all its axes."""
    truth = bench()
    whole = recorded(truth, 5)
    wander = np.cumsum(rng_of("one axis wanders").normal(0, 1.0, len(whole)))
    wander *= 4e-3 / np.std(wander)  # m/s2
    columns = {name: whole.column(name) for name in whole.column_names}
    columns["accel_y_m_s2"] = columns["accel_y_m_s2"] + wander
    found = diagnose(honest(truth), [Recording.from_columns(whole.time, columns)])
    assert found.verdict == "unlisted"
    (finding,) = (f for f in found.findings if "Slow variation of accel y" in f.statement)
    assert "times the slow noise of the other axes of accel" in finding.statement


def test_an_instrument_in_two_recordings_has_one_noise():
    truth = bench()
    found = prepare(honest(truth), [recorded(truth, 1), recorded(truth, 2)])
    whitened = found.whitened.as_fitted(noise_under(found.start, found.whitened.columns))
    (one,) = instruments(whitened)
    assert one.which == (0, 1, 2, 3, 4, 5)
    assert len({axis.count for axis in one.axes}) == 1


def test_slow_variation_in_one_of_two_recordings_is_a_finding():
    """On all axes, and of a size that an instrument of a poor grade may have."""
    truth, rng = bench(), rng_of("one recording wanders")
    first, second = recorded(truth, 5), recorded(truth, 6)
    columns = {name: second.column(name) for name in second.column_names}
    for axis in "xyz":
        wander = np.cumsum(rng.normal(0, 1.0, len(second)))
        columns[f"accel_{axis}_m_s2"] = columns[f"accel_{axis}_m_s2"] + 2e-3 * wander / wander.std()
    other = Recording.from_columns(second.time, columns, source="recording of Tuesday")
    found = diagnose(honest(truth), [first, other])
    assert found.verdict == "unlisted"
    slow = [f for f in found.findings if "Slow variation of accel" in f.statement]
    assert slow
    for finding in slow:
        assert finding.where.recording == "in recording of Tuesday"
        assert finding.next_measurement.startswith("diagnose recording of Tuesday apart")
