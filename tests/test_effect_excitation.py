"""What a recording does not excite it does not show: every effect hides where what it needs is absent."""

import numpy as np
import pytest
from builders import AXLED, read_poses, setup_of, still
from catalogue_cases import INSTRUMENT, plausible, sensors_for

from tiltcal.effects import CATALOGUE

ROWS = 40
EXACT = 1e-11
SILENT = {"motion", "temperature", "vibration", "direction"}  # nothing at all in one pose at rest and constant temperature


def one_pose(table: str):
    """Forty seconds at rest in one tilted pose, at constant temperature, without vibration."""
    setup = setup_of(table, *INSTRUMENT)
    angles = dict(zip(("outer", "middle", "inner"), (33.0, -21.0, 47.0), strict=True))
    return setup, still(setup, **{name: np.full(ROWS, angles[name]) for name in setup.rig.axis_names})


@pytest.mark.parametrize("table", AXLED)
@pytest.mark.parametrize("id", [i for i, c in CATALOGUE.items() if c.needs in SILENT])
def test_an_effect_is_silent_without_its_excitation(id, table):
    setup, drive = one_pose(table)
    bare = read_poses(setup, drive)
    for sensor in sensors_for(CATALOGUE[id], setup):
        changed = read_poses(setup, drive, plausible(id, setup, sensor), seed=1)
        for name, values in changed.items():
            seen = values[np.isfinite(values)] - bare[name][np.isfinite(values)]
            assert np.abs(seen).max(initial=0.0) < EXACT, name


@pytest.mark.parametrize("table", AXLED)
@pytest.mark.parametrize("id", [i for i, c in CATALOGUE.items() if c.needs in ("pose", "remount")])
def test_one_pose_shows_a_pose_effect_as_a_constant_only(id, table):
    setup, drive = one_pose(table)
    bare = read_poses(setup, drive)
    for sensor in sensors_for(CATALOGUE[id], setup):
        for name, values in read_poses(setup, drive, plausible(id, setup, sensor), seed=1).items():
            assert np.ptp(values - bare[name], axis=0).max() < EXACT, name


def test_every_effect_says_what_it_needs_in_words_that_agree():
    words = {"temperature": "temperature", "vibration": "vibration", "remount": "remount"}
    for id, cls in CATALOGUE.items():
        if cls.needs in words:
            assert words[cls.needs] in cls.excited_by, id
