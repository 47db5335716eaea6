"""What a recording does not excite it does not show: every effect hides where what it needs is
absent.
"""

import numpy as np
import pytest
from builders import AXLED, setup_of
from catalogue_cases import INSTRUMENT, plausible, sensors_for

from tiltcal.core.units import EARTH_RATE
from tiltcal.effects import CATALOGUE
from tiltcal.forward.signal_chain import readings
from tiltcal.setup.schedule import Leg, Schedule

# a point 0.1 m off the laboratory's origin feels the Earth turn
EXACT = 1e-11 + 0.1 * EARTH_RATE**2
# nothing at all in one pose at rest and constant temperature
SILENT = {
    "motion",
    "temperature",
    "vibration",
    "direction",
}
POSE = {"outer": 33.0, "middle": -21.0, "inner": 47.0, "head": 15.0}


def one_pose(table: str, *effects):
    """Readings of forty seconds at rest in one tilted pose, at constant temperature, without
    vibration.
    """
    setup = setup_of(table, *INSTRUMENT)
    q = np.radians([POSE[name] for name in setup.rig.axis_names])
    course = Schedule((Leg(0.0, 40.0, q, 0 * q, stop=0),), setup.rig.axis_names)
    times = {s.name: np.arange(0.0, 40.0, 0.05) for s in setup.sensor}
    return readings(setup, course, times, effects, seed=1)


@pytest.mark.parametrize("table", AXLED)
@pytest.mark.parametrize("id", [i for i, c in CATALOGUE.items() if c.needs in SILENT])
def test_an_effect_is_silent_without_its_excitation(id, table):
    setup, bare = setup_of(table, *INSTRUMENT), one_pose(table)
    for sensor in sensors_for(CATALOGUE[id], setup):
        for name, values in one_pose(table, plausible(id, setup, sensor)).items():
            seen = values[np.isfinite(values)] - bare[name][np.isfinite(values)]
            assert np.abs(seen).max(initial=0.0) < EXACT, name


@pytest.mark.parametrize("table", AXLED)
@pytest.mark.parametrize("id", [i for i, c in CATALOGUE.items() if c.needs in ("pose", "remount")])
def test_one_pose_shows_a_pose_effect_as_a_constant_only(id, table):
    setup, bare = setup_of(table, *INSTRUMENT), one_pose(table)
    for sensor in sensors_for(CATALOGUE[id], setup):
        for name, values in one_pose(table, plausible(id, setup, sensor)).items():
            assert np.ptp(values - bare[name], axis=0).max() < EXACT, name


def test_every_effect_says_what_it_needs_in_words_that_agree():
    words = {"temperature": "temperature", "vibration": "vibration", "remount": "remount"}
    for id, cls in CATALOGUE.items():
        if cls.needs in words:
            assert words[cls.needs] in cls.excited_by, id
