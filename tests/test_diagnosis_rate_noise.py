"""A FOG on a fast table whose stamps are rounded: the rates that the readout tells are noisy while
it moves.
"""

import numpy as np
from diagnosis_fixtures import bench, honest, recorded
from statistics_helpers import rng_of

from tiltcal.diagnosis.data.observe import observe
from tiltcal.diagnosis.diagnose import diagnose
from tiltcal.laboratory.scenario import parse_scenario
from tiltcal.recordings.recording import Recording

EARTH = 7.292115e-5  # rad/s
NOISE = 3e-5  # rad/s, of the FOG
TABLE = parse_scenario(
    {
        "schema": 1,
        "name": "a FOG on a vertical axis",
        "site": {"gravity_m_s2": 9.80123, "latitude_deg": 30.0},
        "rig": {"table": "vertical"},
        "sensor": [
            {
                "name": "fog",
                "kind": "fog",
                "axes": ["a"],
                "input_axis": [0.0, 0.0, 1.0],
                "rate_hz": 20.0,
                "adjustable": ["bias", "scale"],
            }
        ],
    }
)


def swung(name):
    """Rest and swings in turn, each of 20 s; stamps that scatter and are rounded to 0.1 ms."""
    rng = rng_of(name)
    time = np.arange(4, 3604) / 20.2 + rng.normal(0, 8e-4, 3600)
    moving = time % 40 > 20
    phase = 2 * np.pi * 0.4 * (time % 20)
    angle = 0.35 * (1 - np.cos(phase)) * moving
    rate = 0.35 * 2 * np.pi * 0.4 * np.sin(phase) * moving
    read = rate + EARTH * np.sin(np.radians(30.0)) + rng.normal(0, NOISE, len(time))
    readout = np.degrees(angle + rng.normal(0, 2e-7, len(time)))
    columns = {"table_outer_deg": readout, "fog_a_rad_s": read}
    return Recording.from_columns(np.rint(time * 1e4) / 1e4, columns), moving


def test_rows_are_weighed_by_the_noise_of_the_rate_that_the_readout_tells():
    recording, moving = swung("rows")
    observations = observe(TABLE, [recording])
    (channel,), (left,) = observations.channels, observations.residuals(observations.known)
    assert channel.spread is not None
    np.testing.assert_allclose(channel.spread[channel.stop >= 0], 1.0, atol=1e-3)
    weighed = channel.weighed(left)
    plain, alike = (np.std(r[moving]) / np.std(r[~moving]) for r in (left, weighed))
    assert plain > 1.5
    assert 0.5 < alike < 1.3


def test_the_noise_of_rates_is_no_finding():
    recording, _ = swung("null")
    assert diagnose(TABLE, [recording]).verdict == "match"


def test_moves_that_are_too_quick_for_the_rate_of_a_log_are_no_finding():
    """Its rows miss each acceleration alike: many such moves tell no more than one."""
    gyro = {"name": "gyro", "kind": "gyro", "rate_hz": 10.0, "adjustable": ["bias"]}
    table = bench().model_dump(exclude_defaults=True, by_alias=True)
    table |= {"schema": 1, "sensor": [gyro]}
    noise = {"id": "gyr_noise", "sensor": "gyro", "white_deg_rth": 0.1}
    truth = parse_scenario({**table, "effect": [noise]})
    found = diagnose(honest(truth), [recorded(truth, 5)])
    assert found.findings == ()


def test_noise_that_grows_with_the_motion_weighs_rows_and_is_told():
    rng = rng_of("grows")
    recording, moving = swung("grows")
    columns = {name: recording.column(name) for name in recording.column_names}
    columns["fog_a_rad_s"] = columns["fog_a_rad_s"] + 20 * NOISE * moving * rng.normal(
        size=len(moving)
    )
    loud = Recording.from_columns(recording.time, columns)
    observations = observe(TABLE, [loud])
    (channel,), (left,) = observations.channels, observations.residuals(observations.known)
    assert channel.growth is not None
    weighed = channel.weighed(left)
    assert 0.6 < np.std(weighed[moving]) / np.std(weighed[~moving]) < 1.5
    (averaged,) = observations.averaged(3).channels
    assert averaged.growth is not None
    middles = channel.growth[1::3][: len(averaged.growth)]
    within = (averaged.stop < 0) & (middles > 1)
    np.testing.assert_allclose(averaged.growth[within], middles[within], rtol=0.2)
    answer = diagnose(TABLE, [loud])
    assert answer.verdict == "match"
    assert any("while moving as at rest" in note for note in answer.notes)
