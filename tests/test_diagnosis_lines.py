"""What beats in a residual is found where it beats: in the readings, in the world, over an axis' angle, after each move."""

import pytest
from dossier import bench, honest, recorded

from tiltcal.diagnosis.bench import prepare
from tiltcal.diagnosis.filling import fill, refill
from tiltcal.diagnosis.tones import lines_of
from tiltcal.sequence import Step


def prepared(*left_out, seed=3):
    truth = bench(*left_out)
    return prepare(honest(truth), [recorded(truth, seed)])


def lines(*left_out):
    found = prepared(*left_out)
    return lines_of(found.ledger, found.start)


def test_noise_has_no_lines():
    found = lines()
    assert (found.tones, found.shakes, found.echoes, found.ripples) == ((), (), (), ())


def test_a_hum_of_the_electronics_is_a_tone_of_the_readings():
    found = lines({"id": "mains_pickup", "sensor": "accel", "pickup_x_ug": 400.0, "frequency_hz": 3.37})
    assert found.tones[0] == pytest.approx(3.37, abs=0.005)


def test_a_shaken_base_is_one_line_in_the_world():
    found = lines({"id": "base_vibration", "ec_ug": 500.0, "frequency_hz": 4.21})
    assert found.shakes[0] == pytest.approx(4.21, abs=0.005)


def test_an_interpolation_error_is_a_line_over_the_angle():
    """In a turn: between stops that are few a line has aliases."""
    turn = {"action": "turn", "axis": "outer", "rate_deg_s": 3.0, "dwell_s": 3.0}
    sequence = tuple(Step(**turn, angle_deg=angle) for angle in (360.0, -360.0))
    truth = bench({"id": "table_encoder_sde", "axis": "outer", "cos_arcsec": 60.0, "lines": 36})
    truth = truth.model_copy(update={"sequence": sequence})
    found = prepare(honest(truth), [recorded(truth, 3)])
    assert lines_of(found.ledger, found.start).ripples[:1] == (36,)


def test_what_rings_anew_after_each_move_is_an_echo():
    found = lines({"id": "settling_transient", "axis": "outer", "amplitude_arcsec": 200.0, "frequency_hz": 1.5, "tau_s": 2.0})
    assert found.echoes
    assert found.echoes[0] == pytest.approx(1.5, rel=0.1)


def test_what_stood_in_the_shadow_of_a_finding_comes_onto_the_ledger_later():
    """A line that stands out of the residual only once a large scale asymmetry is away."""
    found = prepared({"id": "mains_pickup", "sensor": "accel", "pickup_x_ug": 400.0, "frequency_hz": 3.37})
    before = lines_of(found.ledger, found.start)
    nothing = type(before)()
    fill(found.ledger, found.start, nothing)
    count = len(found.ledger.suspects)
    assert refill(found.ledger, found.start, nothing)
    new = {s.effect.values.get("frequency") for s in found.ledger.suspects[count:]}
    assert any(f is not None and abs(f - 3.37) < 0.01 for f in new)
    assert not refill(found.ledger, found.start, before)
