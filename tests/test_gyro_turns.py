"""A gyro triad from rest-turn-rest by hand."""

import numpy as np
import pytest
from scipy.stats import chi2
from test_real_recordings import FOLDER

from tiltcal.accuracy import normalised_error, true_parameters
from tiltcal.assets import folder
from tiltcal.errors import TiltcalError
from tiltcal.importing import import_recording, load_mapping
from tiltcal.laboratory import SimulatedLaboratory
from tiltcal.methods.registry import calibrate
from tiltcal.scenario import load_scenario
from tiltcal.units import DEG

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


def test_wrong_terms_and_too_few_turns_are_refused_in_words():
    recording = SimulatedLaboratory().record(SCENARIO)
    with pytest.raises(TiltcalError, match="need some of bias, scale, cross_axis, gsens"):
        calibrate("gyro_turns", recording, SCENARIO, terms=["bias", "wobble"])
    short = SCENARIO.model_copy(update={"sequence": SCENARIO.sequence[:11]})
    few = SimulatedLaboratory().record(short)
    from tiltcal.segments import find_segments

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
    assert gsens < 0.6 * cross
    assert np.isfinite(gsens)
