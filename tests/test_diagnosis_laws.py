"""Laws of a diagnosis, whatever is inside: what of a recording must not matter, how an answer
follows its input, and what every answer has to satisfy.
"""

from dataclasses import replace

import numpy as np
import pytest
from diagnosis_fixtures import bench, honest, recorded, shorter

from tiltcal.core.units import DEG, G0
from tiltcal.diagnosis.diagnose import diagnose
from tiltcal.laboratory.scenario import parse_scenario
from tiltcal.recordings.recording import Recording

HIDDEN = {"id": "acc_K2", "sensor": "accel", "k2_x_ug_g2": 400.0}
ENCODER = {"id": "table_encoder_2rev", "axis": "outer", "cos_arcsec": 40.0}
ALPHA = 0.01


def same_columns(recording, change):
    """The recording with its columns changed by a function of (name, values) -> (name, values)."""
    columns = dict(change(n, recording.column(n)) for n in recording.column_names)
    return Recording.from_columns(recording.time, columns, source=recording.source)


def in_other_units(name, values):
    """Accelerations in mg, table angles in rad."""
    if name.endswith("_m_s2"):
        return name.removesuffix("_m_s2") + "_mg", values / (1e-3 * G0)
    if name.endswith("_deg"):
        return name.removesuffix("_deg") + "_rad", values * DEG
    return name, values


def shuffled_within_dwells(recording, rng):
    """The readings of each dwell in another order: white noise does not depend on it."""
    angles = np.column_stack([recording.column(f"table_{a}_deg") for a in ("outer", "inner")])
    moving = np.r_[True, np.abs(np.diff(angles, axis=0)).max(axis=1) > 1e-9]
    order = np.arange(len(recording))
    for rows in np.split(order, np.flatnonzero(moving)):
        if len(rows) > 10:
            order[rows[5:-5]] = rng.permutation(rows[5:-5])

    def change(name, values):
        return name, values[order] if name.startswith("accel") else values

    return same_columns(recording, change)


@pytest.fixture(scope="module")
def known():
    """The honest scenario, a recording, and its diagnosis."""
    truth = bench(HIDDEN)
    recording = recorded(truth, 11)
    return honest(truth), recording, diagnose(honest(truth), [recording])


def answer_of(found):
    """Verdict, names and classes."""
    return found.verdict, [(f.effect, sorted(f.names)) for f in found.findings]


def numbers_of(found):
    """Every size with its uncertainty, and the figures of the fit."""
    sizes = [x for f in found.findings for pair in f.parameters.values() for x in pair]
    return [*sizes, found.before.chi2_per_dof, found.after.chi2_per_dof]


def assert_same(found, other, rel):
    assert answer_of(found) == answer_of(other)
    np.testing.assert_allclose(numbers_of(found), numbers_of(other), rtol=rel)


def test_neither_the_order_of_the_columns_nor_an_unrelated_one_matters(known):
    scenario, recording, found = known
    columns = {n: recording.column(n) for n in list(recording.column_names)[::-1]}
    turned = {"pressure_hPa": 1013 + np.sin(recording.time)} | columns
    other = Recording.from_columns(recording.time, turned, source=recording.source)
    assert_same(found, diagnose(scenario, [other]), 1e-9)


def test_neither_the_units_of_the_columns_nor_the_epoch_of_the_stamps_matters(known):
    scenario, recording, found = known
    columns = dict(in_other_units(n, recording.column(n)) for n in recording.column_names)
    other = Recording.from_columns(recording.time + 4096.0, columns, source=recording.source)
    # conversion rounds in the last place, and fits go on from it
    assert_same(found, diagnose(scenario, [other]), 1e-4)


def test_the_order_of_the_rows_of_a_dwell_does_not_matter_beyond_chance(known, rng):
    scenario, recording, found = known
    other = diagnose(scenario, [shuffled_within_dwells(recording, rng)])
    assert answer_of(found) == answer_of(other)
    for one, two in zip(found.findings, other.findings, strict=True):
        for name, (value, sigma) in one.parameters.items():
            assert abs(two.parameters[name][0] - value) < sigma  # the same noise, dealt out anew


def test_the_order_of_the_recordings_does_not_matter():
    truth = bench(HIDDEN)
    recordings = [recorded(truth, seed) for seed in (21, 22)]
    one = diagnose(honest(truth), recordings)
    two = diagnose(honest(truth), recordings[::-1])
    assert "acc_K2" in one.findings[0].names
    assert_same(one, two, 1e-3)  # T0 is that of the first recording


def test_a_size_follows_its_input(known):
    _, _, found = known
    factor = -2.0
    truth = bench(HIDDEN | {"k2_x_ug_g2": 400.0 * factor})
    other = diagnose(honest(truth), [recorded(truth, 11)])
    (one, sigma), (two, _) = (f.findings[0].parameters["k2_x_ug_g2"] for f in (found, other))
    assert two - one == pytest.approx(400.0 * (factor - 1), abs=sigma)  # the noise is the same


def test_a_known_effect_is_no_finding():
    truth = bench(HIDDEN)
    stated = honest(truth).model_dump(exclude_defaults=True, by_alias=True)
    informed = parse_scenario({"schema": 1, **stated, "effect": [HIDDEN]})
    assert diagnose(informed, [recorded(truth, 11)]).verdict == "match"


@pytest.fixture(scope="module")
def turned():
    """The same of an error of the table's readout."""
    truth = bench(ENCODER)
    recording = recorded(truth, 12)
    return honest(truth), recording, diagnose(honest(truth), [recording])


@pytest.mark.parametrize(("case", "hidden"), [("known", HIDDEN), ("turned", ENCODER)])
def test_every_answer_keeps_the_laws_of_an_answer(case, hidden, request):
    _, recording, found = request.getfixturevalue(case)
    for finding in found.findings:
        assert finding.effect is None or finding.effect == finding.names[0]
        assert len(set(finding.names)) == len(finding.names)
        assert 0 <= finding.p_value < ALPHA
        assert finding.delta_bic < 0
        assert all(sigma > 0 for _, sigma in finding.parameters.values())
        assert finding.statement.endswith(".")
    assert found.after.chi2_per_dof <= found.before.chi2_per_dof
    assert hidden["id"] in {name for f in found.findings for name in f.names}
    place = hidden["id"], hidden.get("sensor"), hidden.get("axis")
    assert place not in {(u.effect, u.sensor, u.axis) for u in found.undetectable}
    again = diagnose(parse_scenario(dict(found.amended), "amended.toml"), [recording])
    assert again.verdict == "match"


def test_the_same_input_gives_the_same_answer_whoever_was_diagnosed_before(known):
    scenario, recording, found = known
    other = shorter(bench(ENCODER), 15)
    diagnose(honest(other), [recorded(other, 5)])
    again = diagnose(scenario, [same_columns(recording, lambda *column: column)])
    assert replace(again, views=()).to_json() == replace(found, views=()).to_json()


def test_a_floor_that_comes_to_rest_is_one_number_and_a_time_constant():
    """And not the heat of a drive, which also grows to a level."""
    truth = bench(sensor="incl", table="vertical")
    whole = recorded(truth, 4)
    turned = whole.column("table_outer_deg") * DEG
    tilt = 8e-3 * (1 - np.exp(-(whole.time - whole.time[0]) / 80.0))  # deg, of the base about east
    columns = {name: whole.column(name) for name in whole.column_names}
    columns["incl_x_deg"] = columns["incl_x_deg"] + tilt * np.sin(turned)
    columns["incl_y_deg"] = columns["incl_y_deg"] + tilt * np.cos(turned)
    found = diagnose(honest(truth), [Recording.from_columns(whole.time, columns)])
    (only,) = found.findings
    assert only.effect == "floor_tilt_drift"
    (law,) = [e for e in found.amended["effect"] if e.get("relaxing")]
    assert law["lag_s"] == pytest.approx(80.0, rel=0.2)


def test_a_hysteresis_has_its_name_beside_plays_of_the_force():
    truth = bench({"id": "acc_hysteresis", "sensor": "accel", "hysteresis_x_ug": -90.0})
    (only,) = diagnose(honest(truth), [recorded(truth, 3)]).findings
    assert only.effect == "acc_hysteresis"
