"""One instrument model: what it predicts, what it inverts, and how a reading depends on each
parameter, for every term that a calibration may have, alone and in random lists of five.
"""

from dataclasses import replace

import numpy as np
import pytest
from builders import ACCEL, FOG, GYRO, INCL, G
from statistics_helpers import rng_of
from term_sizes import WARMEST, size_of

from tiltcal.core.frames import sphere
from tiltcal.core.units import G0
from tiltcal.effects.sense import Sense
from tiltcal.instrument.model import InstrumentModel
from tiltcal.instrument.terms import model_of, terms_of

SENSORS = (ACCEL, INCL, GYRO, FOG)
EVERY_TERM = [
    (sensor, name)
    for sensor in SENSORS
    for name, (cls, _) in terms_of(sensor.kind, sensor.axes).items()
    if cls.row_wise
]


def model_with(sensor, names, rng) -> InstrumentModel:
    values = {f"{sensor.name}.{n}": (rng.uniform(-1, 1) * size_of(sensor, n), "1") for n in names}
    return model_of((sensor,), G, values, np.zeros((len(names), len(names))))


def sensed(sensor, rng, n: int = 40) -> Sense:
    """Rows apart, at standstill or turning, at temperatures up to 40 K above T0."""
    up = sphere(n)
    up = up[up[:, 2] > 0.1] if sensor.kind == "inclinometer" else up
    at = Sense.at_rest(sensor, G, G * up)
    rate = rng.uniform(-1, 1, (len(up), 3)) * (0.0 if sensor.is_accelerometer else 1.0)
    memory = rng.uniform(-1, 1, len(up))
    warm = rng.uniform(-WARMEST, WARMEST, len(up))
    vector = sensor.input_vector if sensor.kind == "fog" else np.zeros(3)
    return replace(at, rate=rate, temperature=warm, temperature_memory=memory, input_vector=vector)


def inverse_error(sensor, names, seed: int) -> float:
    """Largest error of the inverted readings, of an ordinary input."""
    rng = rng_of(f"instrument model {seed}")
    model, sense = model_with(sensor, names, rng), sensed(sensor, rng)
    found = model.invert(sensor, model.predict(sensor, sense), sense)
    return float(np.abs(found - sense.true_input()).max()) / model.unit_input(sensor)


@pytest.mark.parametrize(("sensor", "name"), EVERY_TERM)
def test_a_reading_with_any_term_is_inverted(sensor, name):
    assert inverse_error(sensor, [name], 5) < 2e-12


@pytest.mark.parametrize("seed", range(200))
def test_a_reading_with_five_terms_at_once_is_inverted(seed):
    rng = rng_of(f"instrument model {seed}")
    sensor = SENSORS[seed % len(SENSORS)]
    known = [name for s, name in EVERY_TERM if s is sensor]
    names = list(rng.choice(known, min(5, len(known)), replace=False))
    assert inverse_error(sensor, names, seed) < 2e-12


@pytest.mark.parametrize("sensor", SENSORS)
def test_the_reading_is_the_input_and_the_sum_of_its_sensitivities(sensor):
    rng = rng_of("sum of sensitivities")
    names = [name for s, name in EVERY_TERM if s is sensor]
    model, sense = model_with(sensor, names, rng), sensed(sensor, rng)
    columns = model.sensitivity(sensor, sense)
    values = [model.effects[p.effect].value(p.key) for p in model.parameters]
    expected = sense.true_input() + np.tensordot(values, columns, axes=1)
    np.testing.assert_allclose(model.predict(sensor, sense), expected, rtol=0, atol=1e-11)


def test_the_model_by_hand():
    values = {
        "accel.bias_x": (2.0, "mg"),
        "accel.scale_x": (300.0, "ppm"),
        "accel.cross_xz": (-4e-4, "1"),
        "accel.K2_x": (50.0, "ug_g2"),
        "accel.temp2_bias_x": (1e-6, "m_s2_degC2"),
        "temperature.T0": (20.0, "degC"),
        "nobody.bias_x": (1.0, "m_s2"),
    }
    model = model_of((ACCEL,), G, values, np.diag(np.arange(1.0, 8.0) ** 2))
    at = Sense.at_rest(ACCEL, G, np.array([[3.0, 4.0, 5.0]]))
    at = replace(at, temperature=np.array([10.0]))
    by_hand = 3 + 2e-3 * G0 + 3e-4 * 3 - 4e-4 * 5 + 50e-6 / G0 * 9 + 1e-6 * 100
    assert model.predict(ACCEL, at)[0, 0] == pytest.approx(by_hand, abs=1e-15)
    assert [p.name for p in model.parameters] == list(values)[:5]
    sigmas = np.sqrt(np.diag(model.covariance))
    assert sigmas == pytest.approx([1e-3 * G0, 2e-6, 3.0, 4e-6, 5.0])
    assert model.reference_degC == 20.0
