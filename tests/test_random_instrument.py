"""A plausible instrument of a grade."""

import numpy as np
import pytest
from builders import INSTRUMENT, setup_of

from tiltcal.effects import CATALOGUE
from tiltcal.effects.parameter import GRADES
from tiltcal.laboratory.laboratory import SimulatedLaboratory
from tiltcal.laboratory.random_instrument import SPREAD, draw_instrument
from tiltcal.laboratory.scenario import parse_scenario


@pytest.mark.parametrize("grade", GRADES)
def test_every_size_lies_within_the_range_of_its_grade(grade):
    setup = setup_of("dual", *INSTRUMENT)
    for seed in range(20):
        for effect in draw_instrument(setup, grade, seed):
            axes = next((s.axes for s in INSTRUMENT if s.name == effect.sensor), ())
            for p in (p for p in CATALOGUE[effect.id].parameters if p.stands_on(setup.rig)):
                limit = p.plausible[GRADES.index(grade)] * p.factor
                for name in p.expand(axes):
                    assert (
                        SPREAD[0] * limit
                        <= abs(effect.value(name)) * (1 + 1e-12)
                        <= limit * (1 + 1e-9)
                    )


def test_the_same_seed_draws_the_same_instrument_and_another_draws_another():
    setup = setup_of("three", *INSTRUMENT)
    first, again, other = (draw_instrument(setup, "mid_mems", seed) for seed in (4, 4, 5))
    assert [e.values for e in first] == [e.values for e in again]
    assert [e.values for e in first] != [e.values for e in other]


def test_a_hand_held_instrument_has_no_table_errors():
    drawn = draw_instrument(setup_of("handheld", *INSTRUMENT), "consumer", 1)
    assert not [e for e in drawn if e.stage == "table"]
    assert all(e.ordinary for e in drawn)


def test_a_named_effect_takes_the_place_of_the_drawn_one():
    table = {
        "schema": 1,
        "site": {"gravity_m_s2": 9.8},
        "rig": {"table": "dual"},
        "grade": "mid_mems",
        "grade_seed": 3,
        "sensor": [{"name": "accel", "kind": "accelerometer"}],
        "effect": [{"id": "acc_bias", "bias_x_ug": 7.0}, {"id": "acc_noise", "white_ug_rthz": 0.0}],
        "sequence": [{"action": "rest", "dwell_s": 1.0}],
    }
    scenario = parse_scenario(table)
    (bias,) = [e for e in scenario.effects if e.id == "acc_bias"]
    assert bias.value("bias_y") == 0.0
    recording = SimulatedLaboratory().record(scenario)
    assert abs(np.mean(recording.column("accel_x_m_s2"))) > 1e-6
