"""A gyro triad from rest-turn-rest by hand."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import chi2
from test_real_recordings import FOLDER

from tiltcal.accuracy import normalised_error, true_parameters
from tiltcal.assets import folder
from tiltcal.calibration import Calibration, Estimate
from tiltcal.correcting import corrected_columns
from tiltcal.errors import TiltcalError
from tiltcal.importing import import_recording, load_mapping
from tiltcal.laboratory import SimulatedLaboratory
from tiltcal.methods.registry import calibrate
from tiltcal.scenario import load_scenario
from tiltcal.segments import find_segments
from tiltcal.units import DEG, G0

SCENARIO = load_scenario(folder("scenarios") / "gyro_turns_by_hand.toml")


@pytest.mark.slow
def test_its_uncertainty_is_consistent_over_seeds():
    total, dof = 0.0, 0
    for seed in range(12):
        found = calibrate("gyro_turns", SimulatedLaboratory().record(SCENARIO, 700 + seed), SCENARIO)
        value, n = normalised_error(found, true_parameters(SCENARIO, SCENARIO.effects, found))
        total, dof = total + value, dof + n
    assert dof == 12 * 12
    assert chi2.ppf(5e-4, dof) < total < chi2.isf(5e-4, dof), total / dof


def test_a_noiseless_record_gives_back_what_was_injected():
    found = calibrate("gyro_turns", SimulatedLaboratory().record(SCENARIO), SCENARIO)
    for name, value in true_parameters(SCENARIO, SCENARIO.effects, found).items():
        assert found.value(name) == pytest.approx(value, abs=3e-5), name  # sums of 100 Hz samples stand for the integral


def test_a_hand_that_still_turns_at_the_edges_of_a_rest_does_no_harm():
    """The edges of the rests are moved into the turns: the gyro carries each sample of the force to the instant."""
    quiet = SimulatedLaboratory().record(SCENARIO)
    dwells = [s for s in find_segments(quiet) if s.kind == "dwell"]
    wider = [replace(s, start=s.start - 0.3, end=s.end + 0.3, first=max(s.first - 30, 0), last=s.last + 30) for s in dwells]
    found = calibrate("gyro_turns", quiet, SCENARIO, segments=wider)
    for name, value in true_parameters(SCENARIO, SCENARIO.effects, found).items():
        if ".bias_" not in name:  # the rests' means are those of moves by now
            assert found.value(name) == pytest.approx(value, abs=2e-4), name


def test_correction_takes_off_g_sensitivity_by_the_accelerometer_beside_it():
    names = [f"gyro.gsens_{a}{b}" for a in "xyz" for b in "xyz"]
    parameters = {n: Estimate(10.0 * (i + 1), 1.0, "deg_h_g") for i, n in enumerate(names)}
    calibration = Calibration("mine", "good", parameters, np.eye(9))
    still = SimulatedLaboratory().record(SCENARIO.model_copy(update={"effect": (), "sequence": SCENARIO.sequence[:4]}))
    columns = corrected_columns(still, calibration, SCENARIO)
    f = still.sensor(SCENARIO.named("accel")).values / G0
    pulled = f @ (10.0 * np.arange(1, 10).reshape(3, 3)).T / 3600  # deg/s
    read = np.column_stack([still.column(f"gyro_{a}_deg_s") for a in "xyz"])
    for i, a in enumerate("xyz"):
        assert columns[f"gyro_{a}_corrected_deg_s"] == pytest.approx(read[:, i] - pulled[:, i], abs=1e-12)
    bare = SCENARIO.model_copy(update={"sensor": (SCENARIO.named("gyro"),)})
    with pytest.raises(TiltcalError, match="no accelerometer triad beside gyro"):
        corrected_columns(still, calibration, bare)


def test_wrong_terms_and_too_few_turns_are_refused_in_words():
    recording = SimulatedLaboratory().record(SCENARIO)
    with pytest.raises(TiltcalError, match="need some of bias, scale, cross_axis, gsens"):
        calibrate("gyro_turns", recording, SCENARIO, terms=["bias", "wobble"])
    short = SCENARIO.model_copy(update={"sequence": SCENARIO.sequence[:11]})
    few = SimulatedLaboratory().record(short)
    dwells = [s for s in find_segments(few) if s.kind == "dwell"]
    with pytest.raises(TiltcalError, match=r"dwells|turns"):
        calibrate("gyro_turns", few, SCENARIO, segments=dwells[:5])


@pytest.mark.skipif(not FOLDER.is_dir(), reason=f"the real recordings are not at {FOLDER.name}")
@pytest.mark.slow
def test_on_a_real_log_cross_axis_terms_and_then_g_sensitivity_lower_the_held_out_error():
    here = folder("models").parent / "tests" / "real"
    recording = import_recording(FOLDER / "xsens_mti" / "xsens_acc.mat", load_mapping(here / "xsens_gyro_map.toml"))
    setup = load_scenario(here / "xsens_gyro.toml")
    terms = (["bias", "scale"], ["bias", "scale", "cross_axis"], ["bias", "scale", "cross_axis", "gsens"])
    plain, cross, gsens = (calibrate("gyro_turns", recording, setup, terms=t).heldout_rms["gyro"] / DEG for t in terms)
    assert plain > 3.0
    assert cross <= 0.55
    assert gsens <= 0.20
