"""Noise of a record at standstill: coefficients, and whether white noise, flicker and a random walk
are all of it. Records are drawn here, without the noise of the laboratory.
"""

import json
from math import sqrt

import numpy as np
import pytest
from outside_files import RECORDINGS, needs
from scenario_files import refusal
from scipy.signal import lfilter
from scipy.stats import binom
from statistics_helpers import FALSE_ALARM, rng_of
from test_real_recordings import imported

from tiltcal.cli import main
from tiltcal.recordings.recording import Recording
from tiltcal.recordings.saving import write_recording
from tiltcal.statistics import standstill_spectrum
from tiltcal.statistics.allan import allan_deviation, slopes
from tiltcal.statistics.goodness_of_fit import LEVEL, NeighbourCounts
from tiltcal.statistics.standstill_noise import fit_noise
from tiltcal.statistics.standstill_spectrum import POWERS, RunningSpectrum, StandstillSpectrum

RATE = 100.0
N, B, K = 1e-3, 5e-4, 1e-4  # per root hertz, and per root second
SAMPLE = N * sqrt(RATE)  # standard deviation of white noise


def flicker(n, rng):
    """Gaussian noise of density B^2/s, a quarter of a periodic record."""
    m = 4 * n
    s = 2 * np.sin(np.pi * np.arange(m // 2 + 1) / m)
    s[0] = np.inf
    waves = rng.normal(size=(2, len(s))) * np.sqrt(m / 2 / s)
    return np.fft.irfft(waves[0] + 1j * waves[1], m)[:n]


def drawn(n, rng, white=N, pink=B, walk=K):
    steps = rng.normal(size=n) * walk / sqrt(RATE)
    return SAMPLE * white / N * rng.normal(size=n) + pink * flicker(n, rng) + np.cumsum(steps)


def fitted(values, rate=RATE):
    curve = allan_deviation(values, rate)
    return fit_noise(StandstillSpectrum.of(values, rate), curve, NeighbourCounts.of(values))


def most_of(draws, p):
    """The most that so many draws have of what has probability p."""
    return binom.isf(FALSE_ALARM, draws, p)


# --------------------------------------------------------------------------------------------------
# ---- the level of the test


@pytest.mark.parametrize(
    ("white", "pink", "walk"), [(N, 0, 0), (N, B, K), (N, 10 * N, 0), (N, 5 * N, 3 * N), (N, 0, N)]
)
def test_the_model_fails_as_often_as_the_test_says(white, pink, walk):
    rng, draws = rng_of(f"level {white} {pink} {walk}"), 120
    p = np.array([fitted(drawn(4096, rng, white, pink, walk)).test.p for _ in range(draws)])
    for level in (LEVEL, 0.01, 0.05, 0.2):
        assert np.sum(p < level) <= most_of(draws, level), level


@pytest.mark.parametrize("step", [1e-6, 0.1, 0.5, 1.0, 1.5])
def test_rounding_finer_than_twice_the_noise_is_no_misfit(step):
    rng, draws = rng_of(f"rounded {step}"), 30
    step *= SAMPLE
    records = (drawn(4096, rng) for _ in range(draws))
    bad = sum(not fitted(np.round(x / step) * step).fits for x in records)
    assert bad <= most_of(draws, 2 * LEVEL)


def test_heavy_tails_and_a_warm_up_are_no_misfit_of_the_samples():
    rng = rng_of("tails")
    for noise in (rng.laplace(size=20_000), rng.standard_t(4, size=20_000)):
        assert not NeighbourCounts.of(np.round(noise / 0.5) * 0.5).notes()
    ramp = np.round((rng.normal(size=20_000) + 1e-2 * np.arange(20_000)) / 0.5) * 0.5
    assert not NeighbourCounts.of(ramp).notes()


# --------------------------------------------------------------------------------------------------
# ---- coefficients


def test_coefficients_of_an_exact_spectrum_come_back():
    n, truth = 1 << 17, {"Q": 2e-4, "N": 2e-3, "B": 5e-3, "K": 5e-3}
    s = 2 * np.sin(np.pi * np.arange(1, n) / (2 * n))
    size = np.array([1 / RATE, RATE**-0.5, 1.0, RATE**0.5])
    variances = (np.array(list(truth.values())) / size) ** 2
    density = np.column_stack([s**p for p in POWERS]) @ variances
    line = np.zeros(n - 1)
    line[0] = 1.0  # all of the first coefficient
    spectrum = StandstillSpectrum(np.sqrt(density), line, s, n, RATE)
    white = rng_of("any").normal(size=64)
    found = fit_noise(spectrum, allan_deviation(white, RATE), NeighbourCounts.of(white))
    for term, value in truth.items():
        assert found.values[term] == pytest.approx(value, rel=1e-4), term


@pytest.mark.parametrize("truth", [{"N": N, "B": 5 * N, "K": 0}, {"N": N, "B": 0, "K": 10 * N}])
def test_sigmas_are_those_of_repeated_records(truth):
    rng, pulls = rng_of(f"pulls {truth}"), []
    for _ in range(120):
        found = fitted(drawn(8192, rng, *truth.values()))
        assert all(found.held[t] for t, x in truth.items() if x)
        pulls.append([(found.values[t] - x) / found.sigmas[t] for t, x in truth.items() if x])
    assert np.std(pulls, axis=0) == pytest.approx(1.0, abs=0.3)
    assert np.mean(pulls, axis=0) == pytest.approx(0.0, abs=3.9 / sqrt(120))


def test_a_ramp_is_found_with_its_sigma_and_only_where_there_is_one():
    rng, t = rng_of("ramp"), np.arange(20_000) / RATE
    for slope in (2e-5, -2e-5):
        found = fitted(drawn(len(t), rng, pink=0, walk=0) + slope * t)
        sigma = N * sqrt(12 / t[-1] ** 3)  # of a line in white noise
        # and of what slow noise the record may have
        assert 0.95 * sigma < found.sigmas["R"] < 4 * sigma
        assert found.values["R"] == pytest.approx(abs(slope), abs=4 * sigma)
        assert found.fits
    assert not fitted(drawn(len(t), rng, pink=0)).held["R"]


# --------------------------------------------------------------------------------------------------
# ---- what does not fit


def correlated(rng):
    return 0.7 * lfilter([1], [1, -0.3], SAMPLE * rng.normal(size=20_000)) + drawn(20_000, rng, 0)


def dead_zone(rng):
    x = drawn(20_000, rng)
    return np.where(np.abs(x) < SAMPLE / 2, 0.0, x)


def held(rng):
    """A value goes out only where it differs by more than half the noise."""
    x = drawn(20_000, rng).tolist()
    for i in range(1, len(x)):
        if abs(x[i] - x[i - 1]) < SAMPLE / 2:
            x[i] = x[i - 1]
    return np.array(x)


MISFITS = {
    "coarse": lambda rng: np.round(drawn(20_000, rng) / SAMPLE / 3) * SAMPLE * 3,
    "correlated": correlated,
    "dead zone": dead_zone,
    "held": held,
    "resonance": lambda rng: (
        drawn(20_000, rng) + lfilter([0.1 * SAMPLE], [1, -1.2, 0.9], rng.normal(size=20_000))
    ),
    "each sample twice": lambda rng: np.repeat(drawn(10_000, rng), 2),
    "cycle of temperature": lambda rng: (
        drawn(20_000, rng) + SAMPLE * np.sin(2 * np.pi * np.arange(20_000) / 7000)
    ),
}


@pytest.mark.parametrize("kind", MISFITS)
def test_other_noise_is_found_out_every_time(kind):
    rng = rng_of(kind)
    for _ in range(8):
        found = fitted(MISFITS[kind](rng))
        assert not found.fits
        assert found.test.reasons


def test_a_line_of_the_mains_is_named_at_its_alias():
    rng, t = rng_of("mains"), np.arange(20_000) / RATE
    for phase in np.linspace(0, np.pi, 8):
        line = 0.3 * SAMPLE * np.sin(2 * np.pi * 150.3 * t + phase)  # 50.3 Hz past 100: 49.7
        found = fitted(drawn(len(t), rng) + line)
        assert not found.fits
        assert found.test.line.frequency_hz == pytest.approx(49.7, abs=0.01)
        assert 0.5 < found.test.line.amplitude / (0.3 * SAMPLE) < 1.05


def test_a_band_says_where_and_by_how_much():
    rng = rng_of("band")
    x = drawn(40_000, rng, pink=0, walk=0)
    waves = np.fft.rfft(x)
    f = np.fft.rfftfreq(len(x), 1 / RATE)
    waves[(f > 6.0) & (f < 7.8)] *= 1.3
    found = fitted(np.fft.irfft(waves))
    (band,) = found.test.wrong_bands
    assert (band.low_hz, band.high_hz) == pytest.approx((5.66, 8.04), abs=0.01)
    expected = sqrt(1 + 0.69 * 1.8 / (band.high_hz - band.low_hz))
    assert band.ratio == pytest.approx(expected, rel=0.1)
    assert found.test.reasons[0].startswith("5.66 to 8.04 Hz (tau 0.046 to 0.066 s): up to 1.")


def test_limits_are_those_of_the_curve_where_the_fit_fails():
    """Correlated noise pulls the flicker of the fit far above the least Allan deviation."""
    found = fitted(correlated(rng_of("limits")))
    least = found.curve.interval(0.95)[1].min() / sqrt(2 * np.log(2) / np.pi)
    assert found.limits["B"] == pytest.approx(least)
    assert found.values["B"] > 2 * least
    assert found.effective["B"] == pytest.approx(least)


@pytest.mark.parametrize(("white", "pink", "walk"), [(N, 0, 0), (0, N, 0), (0, 0, N)])
def test_the_interval_of_the_curve_covers_the_truth_for_each_noise(white, pink, walk):
    rng, draws = rng_of(f"covers {white} {pink} {walk}"), 200
    hits = np.zeros(3)
    for _ in range(draws):
        found = fitted(drawn(2048, rng, white, pink, walk))
        low, high = (end[[3, 5, 8]] for end in found.curve.interval(0.95))
        tau = found.curve.tau[[3, 5, 8]]
        truth = np.sqrt(slopes(tau) @ np.array([0, white, pink, walk, 0]) ** 2)
        hits += (low <= truth) & (truth <= high)
    # equivalent degrees of freedom: the distribution is nearly chi-square
    assert np.all(hits >= binom.isf(1 - FALSE_ALARM, draws, 0.93)), hits


# --------------------------------------------------------------------------------------------------
# ---- in pieces


def test_a_long_record_in_pieces_has_the_noise_and_level_of_the_whole(monkeypatch):
    monkeypatch.setattr(standstill_spectrum, "LONGEST", 1 << 12)
    monkeypatch.setattr(standstill_spectrum, "BLOCK", 1 << 12)
    rng, draws, bad = rng_of("pieces"), 20, 0
    for _ in range(draws):
        x = drawn(30_000, rng, N, 3 * N, 3 * N)
        running = RunningSpectrum(len(x), RATE)
        for piece in np.split(x, np.sort(rng.integers(1, len(x), 9))):
            running.add(piece)
        curve, counts = allan_deviation(x, RATE), NeighbourCounts.of(x)
        found, whole = fit_noise(running.spectrum(), curve, counts), fitted(x)
        bad += found.test.p < 0.01
        for term in "NB":
            assert abs(found.values[term] - whole.values[term]) < 2 * whole.sigmas[term]
    assert bad <= most_of(draws, 0.01)


# --------------------------------------------------------------------------------------------------
# ---- the command


def at_rest(path):
    rng, n = rng_of("noise command"), 30_000
    columns = {f"accel_{a}_mg": 25 * drawn(n, rng) + 1e3 * i for i, a in enumerate("xyz")}
    columns["accel_y_mg"] = np.full(n, 3.5)
    columns["gyro_x_deg_s"] = 5 * drawn(n, rng, pink=0, walk=0)
    columns["turn_x_deg_s"] = correlated(rng)[:n].repeat(2)[:n]
    write_recording(Recording.from_columns(np.arange(n) / RATE, columns), path)
    return path


@pytest.fixture(scope="module")
def rest(tmp_path_factory):
    return at_rest(tmp_path_factory.mktemp("noise") / "rest.csv")


def test_the_command_prints_verdicts_curves_and_tables(rest, capsys, monkeypatch):
    monkeypatch.setenv("COLUMNS", "200")
    assert main(["noise", str(rest)]) == 0
    shown = capsys.readouterr().out
    assert "accel_y_mg is left out: its reading never changes: dead or frozen." in shown
    assert shown.count("DOES NOT FIT") == 1
    assert "turn_x_deg_s: the model does not fit:" in shown
    accel, gyro, turn = shown.split("[[effect]]")[1:]
    white = float(accel.split("white_ug_rthz = ")[1].split()[0])
    assert white == pytest.approx(25.0, rel=0.03)
    walk = float(gyro.split("white_deg_rth = ")[1].split()[0])
    assert walk == pytest.approx(5e-3 * 60, rel=0.03)
    assert "# the model does not fit turn_x_deg_s" in gyro  # the comment is above its table
    assert 'sensor = "turn"' in turn
    assert len([line for line in shown.splitlines() if line.strip().startswith("40.96 ")]) == 4


def test_json_has_the_test_and_no_sigmas_where_it_fails(rest, capsys):
    assert main(["noise", str(rest), "--json"]) == 0
    found = json.loads(capsys.readouterr().out, parse_constant=pytest.fail)
    assert list(found["left_out"]) == ["accel_y_mg"]
    assert list(found["channels"]) == ["accel_x_mg", "accel_z_mg", "gyro_x_deg_s", "turn_x_deg_s"]
    good, bad = found["channels"]["gyro_x_deg_s"], found["channels"]["turn_x_deg_s"]
    assert good["fits"]
    assert good["p"] >= LEVEL
    assert good["sigmas"]["N"] == pytest.approx(5e-3 / sqrt(2 * 30_000), rel=0.05)
    assert not bad["fits"]
    assert bad["reasons"]
    assert set(bad["sigmas"].values()) == set(bad["values"].values()) == {None}
    assert min(band["ratio"] for band in bad["bands"]) < 0.5
    n = len(good["tau_s"])
    assert n == len(good["deviation"]) == len(good["fitted_deviation"])
    assert good["fitted_deviation"][0] == pytest.approx(5e-3 * sqrt(RATE), rel=0.03)


def test_a_recording_without_any_noise_is_refused_with_the_reason_of_each(tmp_path, capsys):
    columns = {f"accel_{a}_mg": np.full(5000, 1.0) for a in "xy"}
    run = Recording.from_columns(np.arange(5000) / RATE, columns)
    write_recording(run, path := tmp_path / "dead.csv")
    said = refusal(["noise", path], tmp_path, capsys)
    assert "accel_x_mg: its reading never changes" in said


@needs(RECORDINGS)
def test_real_gyros_with_a_filter_do_not_fit_and_their_accelerometer_does(tmp_path, capsys):
    path = imported("mpu9150/imu0.log", "mpu9150", tmp_path / "run.csv")
    capsys.readouterr()
    assert main(["noise", str(path), "--json"]) == 0
    channels = json.loads(capsys.readouterr().out)["channels"]
    fits = {name: each["fits"] for name, each in channels.items()}
    assert fits == {name: name.startswith("accel") for name in fits}
    assert all(
        any("8.04 to 11.5 Hz" in r for r in channels[n]["reasons"]) for n in fits if not fits[n]
    )
