"""Random settings that the scenario states: part of the covariance of the readings."""

from dataclasses import replace

import numpy as np
import pytest
from diagnosis_fixtures import bench, honest, recorded, shorter, stating, tumble
from scipy.fft import idct
from statistics_helpers import mean_band

from tiltcal.diagnosis.conclusions.concluding import amended_of
from tiltcal.diagnosis.conclusions.fit_figures import log_likelihood
from tiltcal.diagnosis.data.observe import observe
from tiltcal.diagnosis.data.stop_rotations import stop_rotations
from tiltcal.diagnosis.data_faults.prepare import averaged_blocks, prepare
from tiltcal.diagnosis.data_faults.setting_errors import find_setting_error
from tiltcal.diagnosis.diagnose import diagnose
from tiltcal.diagnosis.model.channel_noise import noise_under
from tiltcal.diagnosis.model.fitted_model import whitened_of
from tiltcal.diagnosis.model.setting_covariance import SettingWaves
from tiltcal.diagnosis.search.state import State
from tiltcal.laboratory.scenario import Scenario, fresh, parse_scenario
from tiltcal.statistics.cosine_transform import cosines
from tiltcal.statistics.noise_spectrum import WhiteFlickerWalk, estimate_noise

ARCSEC = np.radians(1 / 3600)


def scatter(sigma: float, axis: str = "outer") -> dict:
    """Settings of an axis that are this random, arcsec."""
    return {"id": "table_index_error", "axis": axis, "sigma_arcsec": sigma}


def prepared(truth: Scenario, *effects: dict, seed: int = 4):
    return prepare(stating(truth, *effects), [recorded(truth, seed)])


def log_density(values: np.ndarray, covariance: np.ndarray) -> float:
    """Of a normal distribution about zero."""
    _, volume = np.linalg.slogdet(2 * np.pi * covariance)
    return -0.5 * float(volume + values @ np.linalg.solve(covariance, values))


def test_whitening_is_that_of_the_dense_covariance_and_of_one_more_observation_a_stop(rng):
    """Two of three channels change: 14 readings, 4 stops. Extended by an observation "0 +- 1" of
    each size, ordinary least squares leaves the same sum of squares.
    """
    roots = [rng.uniform(0.5, 2.0, n) for n in (6, 5, 3)]
    Z = [rng.normal(size=(n, 4)) for n in (6, 5)]
    read = [rng.normal(size=len(root)) for root in roots]
    settings = SettingWaves((0, 1), tuple(Z)).under(roots)
    scaled = {i: r / root for i, (r, root) in enumerate(zip(read, roots, strict=True))}
    white = settings.independent(scaled)

    noise, together = np.concatenate(roots[:2]), np.concatenate(Z)
    dense = np.diag(noise**2) + together @ together.T
    marginal = log_density(np.concatenate(read[:2]), dense)
    squares = sum(float(white[i] @ white[i]) for i in (0, 1))
    volume = 2 * np.log(noise).sum() + settings.errors.log_det
    assert -0.5 * (squares + volume + 11 * np.log(2 * np.pi)) == pytest.approx(marginal, abs=1e-9)
    alone = log_density(np.concatenate(read[:2]), np.diag(noise**2))
    assert settings.log_ratio(scaled) == pytest.approx(marginal - alone, abs=1e-9)
    assert np.array_equal(white[2], scaled[2])

    design = np.vstack([together / noise[:, None], np.eye(4)])
    target = np.concatenate([scaled[0], scaled[1], np.zeros(4)])
    sizes = np.linalg.lstsq(design, target, rcond=None)[0]
    assert squares == pytest.approx(np.sum((target - design @ sizes) ** 2), abs=1e-9)
    # twice: what is expected of the settings is taken off
    less = settings.independent(white)
    assert np.concatenate([less[0], less[1]]) == pytest.approx((target - design @ sizes)[:-4])

    one, other = (rng.normal(size=14) for _ in range(2))
    parts = [dict(enumerate(np.split(v, [6, 11]))) for v in (one, other)]
    inner = [settings.independent(p) for p in parts]
    whole = sum(float(inner[0][i] @ inner[1][i]) for i in range(3))
    along = [sum(p[i] @ settings.lost[i] for i in (0, 1)) for p in parts]
    assert whole == pytest.approx(one @ other - along[0] @ along[1], abs=1e-9)


def test_the_cost_and_the_sigmas_of_a_model_are_those_of_the_dense_covariance():
    """With calibration fitted at the same time, of a whole recording of 6 stops."""
    truth = shorter(bench(scatter(60.0)), 5)
    found = prepared(truth, scatter(60.0))
    start, white = found.start, found.whitened
    channels, roots = white.observations.channels, np.concatenate(white.roots)
    stops = [c for part in white.observations.settings(start.known) for c in part]
    assert len(stops) == 6
    Z = np.concatenate(
        [
            np.column_stack([c.waves(s.get(i, np.zeros(len(c.values)))) for s in stops])
            for i, c in enumerate(channels)
        ]
    )
    dense = np.diag(roots**2) + Z @ Z.T
    read = np.concatenate(white.observations.residual_waves(start.effects))
    assert log_likelihood(start.effects, white) == pytest.approx(log_density(read, dense), rel=1e-9)

    unsettled = white.under(white.noise)  # about the model that the columns are about
    plain = [
        np.concatenate([w.get(i, np.zeros(len(c.values))) for i, c in enumerate(channels)])
        for t in start.nuisance
        for w in white.columns.all_waves(t.hypothesis, t.names, start.effects)
    ]
    A = np.column_stack(plain)
    information = A.T @ np.linalg.solve(dense, A)
    gram = [
        np.concatenate([w.get(i, np.zeros(len(c.values))) for i, c in enumerate(channels)])
        for w in whitened_of(unsettled, start.nuisance, start.effects)
    ]
    assert np.array(gram) @ np.array(gram).T == pytest.approx(
        information, rel=1e-8, abs=1e-8 * information.max()
    )
    state = State(start, white)
    assert np.isfinite(state.cost)
    assert white.log_volume == pytest.approx(0.5 * np.linalg.slogdet(dense)[1], abs=1e-8)


def test_noise_is_estimated_beside_settings_as_far_as_they_hold_it(rng):
    """40 stops of 50 samples: those of 20 units of noise hide nothing of it and are no slow noise;
    of those of a thousandth none takes any of the slow noise that there is.
    """
    stops = np.kron(np.eye(40), np.ones(50)).T
    walk = 0.05 * np.cumsum(rng.normal(size=2000))
    none = np.zeros((2000, 0))
    noise = rng.normal(size=2000)
    level = cosines(np.ones(2000))[:, None]

    def fitted(read, sigma):
        random = none if sigma == 0 else cosines(sigma * stops.T).T
        return estimate_noise(cosines(read), level, WhiteFlickerWalk, random=random).model

    scattered = noise + stops @ rng.normal(0.0, 20.0, 40)
    unknown, known = fitted(scattered, 0.0), fitted(scattered, 20.0)
    assert unknown.walk > 1.0
    # of 2000 samples white noise is known to 1.6 %; what a walk takes of it is less sure
    assert known.white == pytest.approx(1.0, rel=0.06)
    assert known.walk < 0.03
    slow, beside = fitted(noise + walk, 0.0), fitted(noise + walk, 1e-3)
    assert slow.walk > 0.02
    assert beside.walk == pytest.approx(slow.walk, rel=1e-2)


@pytest.mark.parametrize("seed", [1, 2])
def test_settings_as_random_as_stated_are_no_finding(seed):
    truth = bench(scatter(10.0))
    answer = diagnose(stating(truth, scatter(10.0)), [recorded(truth, seed)])
    assert answer.findings == ()
    assert answer.verdict in ("match", "cannot_tell")
    assert answer.after.chi2_per_dof == pytest.approx(1.0, abs=0.1)


def test_settings_less_random_than_stated_are_no_finding():
    truth = bench(scatter(2.0))
    answer = diagnose(stating(truth, scatter(20.0)), [recorded(truth, 3)])
    assert answer.findings == ()


def test_several_recordings_of_a_placing_table_with_stated_settings_match():
    truth = bench(scatter(10.0), table="placing")
    answer = diagnose(stating(truth, scatter(10.0)), [recorded(truth, k) for k in (5, 6)])
    assert answer.findings == ()


def test_mountings_as_random_as_stated_are_no_finding_and_in_the_uncertainties():
    """Of four mountings of 30 arcsec an antisymmetric pair of cross-axis terms is known to about
    15 arcsec, 73 ppm, whatever the noise.
    """
    seats = {"id": "remount_repeatability", "sigma_arcsec": 30.0}
    table = bench(seats).model_dump(exclude_defaults=True, by_alias=True)
    steps = tumble(12)
    for angle in (90, 180, 270):
        steps += [{"action": "remount", "mount": f"Rz({angle})"}, *tumble(12)]
    truth = parse_scenario({**table, "schema": 1, "sequence": steps})
    read = [recorded(truth, 5)]
    assert diagnose(stating(truth, seats), read).findings == ()
    stated, unstated = (prepare(stating(truth, *known), read) for known in ((seats,), ()))
    (own,) = stated.observations.settings(stated.start.known)
    assert len(own) == 3 * 4
    with_it, without = (
        next(e.sigmas["cross_xy"] for e in one.start.calibration() if "cross_xy" in e.sigmas)
        for one in (stated, unstated)
    )
    assert without < 10e-6
    assert 40e-6 < with_it < 150e-6


@pytest.mark.parametrize(
    ("cause", "size", "least"),
    [
        ({"id": "acc_K2", "sensor": "accel", "k2_y_ug_g2": 300.0}, 300.0, 0.0),
        # noise of 12 arcsec in each of 1200 readings at rest alone would tell it to 0.5 arcsec, 31
        # settings alone to 2.5 arcsec; moves hold a cosine and settings that are interpolated
        (
            {"id": "table_encoder_eccentricity", "axis": "outer", "cos_arcsec": 60.0},
            60.0,
            1.0,
        ),
    ],
)
def test_a_cause_beside_stated_settings_is_found_with_their_share_of_its_sigma(cause, size, least):
    truth, off = bench(scatter(10.0), cause), []
    for seed in (1, 2):
        answer = diagnose(stating(truth, scatter(10.0)), [recorded(truth, seed)])
        assert len(answer.findings) == 1, answer.statement
        (finding,) = answer.findings
        assert cause["id"] in finding.names
        (value, sigma), *_ = finding.parameters.values()
        off.append((value - size) / sigma)
        assert sigma > least
    assert np.abs(off).max() < 3  # of four, 1 % by chance


@pytest.mark.parametrize("axis", ["outer", None])
def test_settings_more_random_than_stated_are_a_fault_in_the_place_of_what_is_stated(axis):
    truth, stated = bench(scatter(30.0)), {**scatter(3.0), "axis": axis}
    found = prepared(truth, {k: v for k, v in stated.items() if v is not None})
    setting = find_setting_error(found.start, found.start, found.whitened, 300, 0.01)
    assert setting is not None
    fault = setting.fault
    value, sigma = fault.effect.value("sigma") / ARCSEC, fault.sigma["sigma"] / ARCSEC
    assert abs(value - 30.0) < 3 * sigma
    assert sigma < 6.0  # 31 draws: 13 %
    assert "where the scenario states 3 arcsec" in fault.words
    amended = amended_of(found.start, found.observations, [fault], {})
    sizes = [e["sigma_arcsec"] for e in amended["effect"] if e["id"] == "table_index_error"]
    assert sizes == [pytest.approx(value)]


def test_settings_as_random_as_stated_are_no_fault():
    found = prepared(bench(scatter(30.0)), scatter(30.0))
    assert find_setting_error(found.start, found.start, found.whitened, 300, 0.01) is None


@pytest.mark.long
def test_a_diagnosis_says_that_settings_are_more_random_than_stated():
    truth = bench(scatter(30.0))
    answer = diagnose(stating(truth, scatter(3.0)), [recorded(truth, 1)])
    (finding,) = answer.findings
    assert finding.effect == "table_index_error"
    value, sigma = finding.parameters["sigma_arcsec"]
    assert abs(value - 30.0) < 3 * sigma


def test_rotations_of_stops_are_no_part_of_the_calibration_nor_of_the_readings():
    truth = bench(scatter(10.0))
    plain, known = prepared(truth), prepared(truth, scatter(10.0))
    names = [[e.address for e in p.start.calibration()] for p in (plain, known)]
    assert names[0] == names[1]
    assert plain.start.rank == known.start.rank
    channels = [[c.name for c in p.observations.channels] for p in (plain, known)]
    assert channels[0] == channels[1]


def test_each_axis_and_each_recording_has_settings_of_its_own():
    truth = shorter(bench(), 5)
    records = [recorded(truth, k) for k in (1, 2)]
    scenario = stating(truth, scatter(10.0), scatter(20.0, "inner"))
    found = prepare(scenario, records)
    counts = [len(part) for part in found.observations.settings(found.start.known)]
    axes = [len(list(stop_rotations(found.observations, a, ()))) for a in ("outer", "inner")]
    assert sum(counts) == sum(axes)
    assert [len(one.channels) for one in found.whitened.settings] == [3, 3]
    first, second = (set(one.channels) for one in found.whitened.settings)
    assert not first & second


def test_averaged_blocks_have_the_settings_of_their_samples():
    truth = bench(scatter(10.0))
    whole = prepared(truth, scatter(10.0))
    blocks = averaged_blocks(whole, 4)
    energies = [
        sum(float(np.mean(c**2)) for stops in o.settings(()) for one in stops for c in one.values())
        for o in (whole.observations, blocks.observations)
    ]
    # between two stops the middle of a block stands for it
    assert energies[1] == pytest.approx(energies[0], rel=0.02)
    assert len(blocks.whitened.settings) == 1


def test_a_stop_in_which_the_instrument_was_mounted_anew_is_two_settings():
    truth = shorter(bench(), 5)
    recording = recorded(truth, 1)
    scenario = stating(truth, scatter(10.0))
    (course,) = observe(scenario, [recording], []).courses
    rows = np.flatnonzero(course.stop == 2)
    middle = float(recording.time[rows[len(rows) // 2]])
    recording = replace(recording, metadata={**recording.metadata, "mount": "Rz(0)"})
    anew = {**recording.metadata, "mount": f"Rz(0); {middle} s: Rz(90)"}
    again = replace(recording, metadata=anew)
    counts = [
        len(list(stop_rotations(observe(scenario, [r], []), "outer", ())))
        for r in (recording, again)
    ]
    assert counts[1] == counts[0] + 1


def test_what_a_model_leaves_less_its_settings_is_its_noise():
    truth = bench(scatter(60.0))
    found = prepared(truth, scatter(60.0))
    effects = found.start.effects
    fits = noise_under(found.start, found.whitened.columns)
    whitened = found.whitened.as_fitted(fits)
    raw, less = whitened.observations.residuals(effects), whitened.less_settings(effects)
    channels = whitened.observations.channels
    for channel, model, before, after in zip(channels, whitened.noise, raw, less, strict=True):
        white = model.white
        # of 2200 samples 1.5 %
        assert after.std() == pytest.approx(white, rel=0.06), channel.name
        assert before.std() > 1.2 * white, channel.name
    squares = np.concatenate([idct(r, norm="ortho") ** 2 for r in whitened.residual(effects)])
    assert abs(squares.mean() - 1) < mean_band(squares) + 0.02  # the calibration takes some


def test_scenarios_without_settings_have_no_covariance():
    assert prepared(bench()).whitened.settings == ()
    still = fresh(honest(bench()))
    assert prepare(still, [recorded(bench(), 1)]).whitened.settings == ()
