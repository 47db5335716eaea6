"""What follows the temperature, its rate or time on a FOG beside a gyro triad, turned by hand: one
slow course like another.
"""

import numpy as np
import pytest
from statistics_helpers import rng_of

from tiltcal.diagnosis.data.observe import observe
from tiltcal.diagnosis.diagnose import diagnose
from tiltcal.diagnosis.hypotheses.coordinate_ranges import ranges_of
from tiltcal.diagnosis.hypotheses.curves import curves
from tiltcal.effects.hysteresis_and_lag import first_order_lag
from tiltcal.effects.spans import SpectralLines
from tiltcal.laboratory.scenario import parse_scenario
from tiltcal.recordings.recording import Recording

BESIDE = parse_scenario(
    {
        "schema": 1,
        "name": "a FOG beside a gyro triad",
        "site": {"gravity_m_s2": 9.80123, "latitude_deg": 45.0},
        "rig": {"table": "handheld"},
        "sensor": [
            {
                "name": "gyro",
                "kind": "gyro",
                "rate_hz": 20.0,
                "adjustable": ["bias", "scale", "cross_axis"],
            },
            {
                "name": "fog",
                "kind": "fog",
                "axes": ["a"],
                "input_axis": [0.36, 0.48, 0.8],
                "rate_hz": 20.0,
                "adjustable": ["bias", "scale"],
            },
        ],
    }
)
TIME = np.arange(2000) / 20.0
WARM = (
    23
    + 1.1 * np.sin(2 * np.pi * TIME / 34 + 0.4)
    + 0.8 * np.sin(2 * np.pi * TIME / 75 + 2)
    - TIME / 90
)
RATE = np.gradient(WARM, TIME)


def turned(name, fog, gyro_y=0.0):
    """A log of turns about all axes with small additions to the FOG and to one gyro, rad/s, and
    coarse temperature each second.
    """
    rng = rng_of(name)
    rate = np.column_stack(
        [0.8 * np.sin((0.5 + 0.2 * k) * TIME) * (TIME % 20 > 5) for k in range(3)]
    )
    read = rate @ BESIDE.named("fog").input_vector + fog + rng.normal(0, 1e-4, len(TIME))
    rate = rate + rng.normal(0, 2e-4, rate.shape) + np.outer(gyro_y + 0 * TIME, [0, 1, 0])
    columns = {f"gyro_{a}_rad_s": rate[:, k] for k, a in enumerate("xyz")} | {"fog_a_rad_s": read}
    columns["temperature_degC"] = np.where(
        np.arange(len(TIME)) % 20 == 0, np.round(WARM, 2), np.nan
    )
    return Recording.from_columns(TIME, columns)


def test_a_rate_of_warming_that_is_felt_late_keeps_its_name():
    """3e-3 (T - late T) / lag: two laws of temperature, one of them late, say the same and are not
    needed.
    """
    lag = 11.0
    late = 3e-3 * (WARM - first_order_lag(TIME, WARM, lag)) / lag
    found = diagnose(BESIDE, [turned("late Shupe", late)]).findings
    assert [f.effect for f in found] == ["fog_shupe"]
    assert found[0].names == ("fog_shupe",)


def test_a_time_constant_is_found_beside_another_law():
    """By itself a warm-up of 20 s takes a part of what follows the rate of warming, with a time
    constant of its own.
    """
    log = turned("warm-up", 2e-3 * RATE, -3e-3 * np.exp(-TIME / 20.0))
    found = diagnose(BESIDE, [log])
    assert sorted(f.effect or "" for f in found.findings) == ["fog_shupe", "gyr_warmup"]
    taus = [e["tau_s"] for e in found.amended["effect"] if e["id"] == "gyr_warmup"]
    assert taus == [pytest.approx(20.0, rel=0.1)]


def test_a_rate_is_late_by_what_the_recording_shows_at_most():
    observations = observe(BESIDE, [turned("spans", 0.0)], [])
    found = [
        s
        for s in curves(observations, ranges_of(observations, SpectralLines()))
        if s.alias == "fog_shupe"
    ]
    assert sorted({s.effect.lag for s in found}) == [0.0, 8.0]
