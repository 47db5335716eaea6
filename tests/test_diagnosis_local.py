"""What a curve of few harmonics is slow to say: a saw over an angle is told by its period and the place of its jump."""

import numpy as np
import pytest
from dossier import bench, honest, recorded, rewritten

from tiltcal.diagnosis.diagnose import diagnose

G = 9.81
WHITE = 25e-6 * G * np.sqrt(10.0 / 2)  # of a sample, m/s2


def saw(angle, period, at):
    """From -1/2 to 1/2, with a jump back at ``at`` and every ``period``."""
    return (angle - at) / period - np.floor((angle - at) / period) - 0.5


@pytest.mark.parametrize(("table", "sensor", "column", "size", "unit"), [
    ("dual", "accel", "accel_z_m_s2", 2e-3, 1.0), ("vertical", "incl", "incl_x_deg", 0.02, np.radians(1.0) * G),
])  # fmt: skip
def test_a_saw_over_an_angle_is_learned_as_a_saw(table, sensor, column, size, unit):
    """Each jump is told to what the table turns from sample to sample, the period by the first and the last of them."""
    period = np.radians(80.0)
    truth = bench(table=table, sensor=sensor)
    whole = recorded(truth, 5)
    angle = np.radians(whole.column("table_outer_deg"))
    read = whole.column(column) + size * saw(angle, period, np.radians(17.0))
    found = diagnose(honest(truth), [rewritten(whole, **{column: read})])
    assert found.verdict == "unlisted"
    assert [f.where.coordinate for f in found.findings] == ["table_outer"]
    (effect,) = [e for e in found.amended["effect"] if e["id"] == "learned"]
    travel = np.abs(np.diff(angle)).max()
    assert effect["period"] == pytest.approx(period, abs=2 * travel / (np.ptp(angle) / period - 1))
    sigma = WHITE * np.sqrt(12 / len(whole))  # of the height of a saw, whose rms is that over the root of 12
    assert np.ptp(effect["coefficients"]) == pytest.approx(size * unit, abs=4 * sigma)


def test_a_bump_is_no_saw():
    truth = bench()
    whole = recorded(truth, 5)
    angle = np.radians(whole.column("table_outer_deg"))
    read = whole.column("accel_z_m_s2") + 3e-3 * np.exp(-(((angle - 0.7) / 0.5) ** 2))
    found = diagnose(honest(truth), [rewritten(whole, accel_z_m_s2=read)])
    (effect,) = [e for e in found.amended["effect"] if e["id"] == "learned"]
    assert "period" not in effect
    assert effect["coordinate"] == "table_outer"
