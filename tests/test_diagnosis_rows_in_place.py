"""What may stand in a cause's place: curves of any form with and without a name, and nothing whose
size cannot be.
"""

import numpy as np
from diagnosis_fixtures import bench, honest, recorded
from test_diagnosis_stamps import late_by

from tiltcal.diagnosis.diagnose import diagnose
from tiltcal.diagnosis.hypotheses.priors import UNLISTED

STICTION = {
    "id": "learned",
    "on": "reading",
    "coordinate": "input",
    "sensor": "accel",
    "axis": "x",
    "knots": [-9.81, -2.0, -1.0, 1.0, 2.0, 9.81],
    "coefficients": [0.0, 0.0, -3e-3, 3e-3, 0.0, 0.0],
}
"""About nothing only, where no textbook form of the converter has anything."""


def test_a_curve_of_any_form_over_the_input_may_be_of_the_converter_or_of_no_list():
    truth = bench(STICTION)
    (finding,) = diagnose(honest(truth), [recorded(truth, 5)]).findings
    assert set(finding.names) == {"adc_inl", UNLISTED}
    assert finding.where.coordinate == "input" or finding.effect == "adc_inl"
    assert 0.1 < finding.name_probability["adc_inl"] < 0.9
    assert "this recording cannot tell" in finding.statement


def test_what_comes_in_whole_samples_is_no_rival_of_a_delay_of_a_part_of_one():
    """Stamps that are 2 ms later from an instant on: a twentieth of a sample is not lost."""
    scenario, recording = late_by(lambda time: 2e-3 * np.clip((time - 60.0) / 8.0, 0, 1))
    found = diagnose(honest(scenario), [recording])
    assert found.verdict in ("unlisted", "ambiguous")
    assert found.findings
    assert not any("data_drop" in f.name_probability for f in found.findings)


def slowly(period):
    """The base tilts to and fro, besides a vibration, by 4 arcsec and, differently, an overtone."""
    tilt = {"id": "learned", "on": "tilt", "slot": "base", "turn": "y", "coordinate": "time"}
    return tilt | {"period": period, "coefficients": [2e-5, 6e-6]}


def test_a_law_of_which_a_name_explains_four_fifths_has_none_for_certain():
    """A vibration and, for the rest, tilts of other periods."""
    shake = {"id": "base_vibration", "ec_ug": 60.0, "frequency_hz": 1.7}
    truth = bench(shake, slowly(5.7), slowly(13.4))
    (finding,) = diagnose(honest(truth), [recorded(truth, 8)]).findings
    assert {"base_vibration", UNLISTED} <= set(finding.names)
    assert 0.1 < finding.name_probability["base_vibration"] < 0.9
    assert {part.effect for part in finding.parts} == {"base_vibration", "learned"}
