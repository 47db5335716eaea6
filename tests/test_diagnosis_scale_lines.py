"""A scale factor that varies with a period: in the readings it is a line only while they are
constant.
"""

import numpy as np
import pytest
from diagnosis_fixtures import rewritten
from test_hand_motion import scenario, turned

from tiltcal.diagnosis.data_faults.prepare import prepare
from tiltcal.diagnosis.diagnose import diagnose
from tiltcal.diagnosis.lines.spectral_lines import scales_of

EVERY = 10  # samples, 0.2 s


def short():
    """Turns by hand of which a FOG's counter reads every tenth sample short by 0.2 %."""
    recording, _, fog = turned(4, seconds=150.0)
    lost = np.where(np.arange(len(fog)) % EVERY == 3, 2e-3 * fog, 0.0)
    return rewritten(recording, fog_a_rad_s=recording.column("fog_a_rad_s") - lost)


def lines(recording):
    found = prepare(scenario(), [recording])
    return scales_of(found.observations, found.start)


def test_every_tenth_sample_makes_lines_of_the_scale_factor():
    """5 Hz and its multiples; beside strong ones those at which the turns repeat."""
    found = lines(short())
    assert found[0] * EVERY / 50.0 == pytest.approx(1.0, abs=1e-3)
    assert sum(abs(f / 5.0 - round(f / 5.0)) < 1e-3 for f in found) >= 3


def test_a_steady_scale_factor_has_none():
    assert lines(turned(4, seconds=150.0)[0]) == ()


def test_it_is_a_finding():
    found = diagnose(scenario(), [short()])
    assert found.verdict == "unlisted"
    (finding,) = found.findings
    assert "scale factor of fog a that follows time, with a period of" in finding.statement
