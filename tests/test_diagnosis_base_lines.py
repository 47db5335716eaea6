"""The base tilts to and fro, slower than the table turns: in the readings that is no line."""

import numpy as np
from diagnosis_fixtures import honest, rewritten
from test_diagnosis_stamps import moving

from tiltcal.diagnosis.data_faults.prepare import averaged_blocks, prepare
from tiltcal.diagnosis.diagnose import diagnose
from tiltcal.diagnosis.lines.spectral_lines import base_tilts_of, tones_of

EVERY = 15.3  # s
LASTS = 121.0  # s
BLOCK = 3  # samples
SAW = {
    "id": "learned",
    "on": "tilt",
    "slot": "base",
    "turn": "y",
    "coordinate": "time",
    "period": EVERY,
    "knots": [0.0, EVERY],
    "coefficients": [0.0, 4e-4],
}
"""82 arcsec in each 15.3 s, then back to nothing."""


def prepared(*effects):
    scenario, recording = moving(*effects)
    return prepare(honest(scenario), [recording])


def near(frequencies):
    """Whether one is that of the cycle to half the width of a line."""
    return any(abs(f - 1 / EVERY) < 0.5 / LASTS for f in frequencies)


def test_a_cycle_of_the_base_is_a_line_in_its_tilt_and_none_in_the_readings():
    found = prepared(SAW)
    assert near(base_tilts_of(found.observations, found.start))
    assert not near(tones_of(found.observations, found.start))


def test_a_base_that_stands_still_has_none():
    found = prepared()
    assert base_tilts_of(found.observations, found.start) == ()


def test_a_cycle_of_the_base_is_a_finding_there():
    """Its mean, half of the saw, is a table that is not level."""
    scenario, recording = moving(SAW)
    found = diagnose(honest(scenario), [recording])
    assert found.verdict == "unlisted"
    mean, cycle = found.findings
    assert mean.effect == "table_levelling"
    tilt, sigma = mean.parameters["tilt_north_arcsec"]
    assert abs(tilt - np.degrees(2e-4) * 3600) < 3 * sigma
    assert (cycle.effect, cycle.stage) == (None, "environment")
    assert "tilt of the frame 'base' about y" in cycle.statement
    assert "period of 15.3 s" in cycle.statement


def test_averages_hold_no_line_beyond_half_their_rate():
    """Each channel lacks other cells, so that the means of its blocks have stamps of their own."""
    scenario, recording = moving(SAW)
    lost, columns = np.random.default_rng(3), {}
    for axis in "xyz":
        name = f"accel_{axis}_m_s2"
        columns[name] = recording.column(name).copy()
        columns[name][lost.random(len(recording.time)) < 0.05] = np.nan
    found = averaged_blocks(prepare(honest(scenario), [rewritten(recording, **columns)]), BLOCK)
    lines = base_tilts_of(found.observations, found.start)
    assert near(lines)
    assert max(lines) < 0.5 * 25.0 / BLOCK
