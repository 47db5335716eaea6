"""A bit that always reads 0 is told from the codes alone, and put back by what the table's motion
says.
"""

import numpy as np
import pytest
from diagnosis_fixtures import BY_HAND, bench, faults_of, honest, recorded, rewritten
from statistics_helpers import rng_of

from tiltcal.data_quality.bits import stuck_bit
from tiltcal.diagnosis.data_faults.prepare import prepare
from tiltcal.diagnosis.data_faults.restored_bits import was_set
from tiltcal.recordings.recording import Recording

LSB = 5e-4  # m/s2


def swept(rng, n=6000):
    """A quarter of a turn and back with rests, in m/s2, noisy."""
    angle = np.pi / 2 * np.clip(1.4 * np.sin(np.linspace(0, 4 * np.pi, n)), -1, 1)
    return 9.8 * np.sin(angle) + rng.normal(0, 2 * LSB, n)


def in_codes(values, bit=None, magnitude=False):
    """Codes of values, without the bit of that number: by the converter's own logic."""
    codes = np.rint(values / LSB).astype(np.int64)
    if bit is not None:
        mask = ~np.int64(1 << bit)
        codes = np.sign(codes) * (np.abs(codes) & mask) if magnitude else codes & mask
    return codes * LSB


@pytest.mark.parametrize(
    "magnitude", [False, True], ids=["two's complement", "magnitude with a sign"]
)
@pytest.mark.parametrize("number", [4, 5, 6, 7, 8])
def test_a_bit_that_is_never_set_is_told_from_the_codes(number, magnitude):
    values = in_codes(swept(rng_of(f"bit {number} {magnitude}")), number, magnitude)
    assert stuck_bit(values) == pytest.approx(LSB * 2**number, rel=1e-3)


@pytest.mark.parametrize("seed", range(8))
def test_sound_codes_lack_none(seed):
    rng = rng_of(f"sound {seed}")
    assert stuck_bit(in_codes(swept(rng))) is None
    rests = np.repeat(rng.uniform(-9.8, 9.8, 24), 100)  # rests say no more than their number
    assert stuck_bit(in_codes(rests + rng.normal(0, 2 * LSB, len(rests)))) is None


def test_a_grid_that_a_file_has_cut_lacks_no_bit():
    """Codes of 11.96 units cut to whole units: all values in half of each cycle, and all at its
    beginning.
    """
    codes = 0.01196 * np.rint(swept(rng_of("grid")) / 0.01196)
    assert stuck_bit(np.floor(codes * 1000) / 1000) is None


@pytest.mark.parametrize(
    "magnitude", [False, True], ids=["two's complement", "magnitude with a sign"]
)
def test_a_missing_bit_is_put_back(magnitude):
    truth = bench()
    sound = recorded(truth, 5)
    x = in_codes(sound.column("accel_x_m_s2"))
    found = prepare(honest(truth), [rewritten(sound, accel_x_m_s2=in_codes(x, 5, magnitude))])
    (fault,) = found.faults
    assert (fault.effect.id, fault.axes) == ("adc_stuck_bit", ("x",))
    assert fault.effect.value("bit_value") == pytest.approx(
        32 * LSB, abs=3 * fault.sigma["bit_value"]
    )
    whole = found.observations.sources[0].column("accel_x_m_s2")
    assert np.mean(np.abs(whole - x) < 0.1 * LSB) > 0.999


@pytest.mark.parametrize("start", [0.0, 1.0])
def test_where_nothing_predicts_a_channel_the_smoothest_course_had_the_bit(start):
    rng = rng_of(f"smooth {start}")
    course = start + 2 * np.sin(np.linspace(0, 6 * np.pi, 3000)) + rng.normal(0, 2 * LSB, 3000)
    whole, cut = in_codes(course), in_codes(course, 7)
    assert np.mean(was_set(cut, np.full(3000, 128 * LSB)) == (whole != cut)) > 0.999
    assert 0.3 < np.mean(whole != cut) < 0.7


def test_by_hand_a_fog_says_where_a_gyro_lacks_its_bit(rng):
    """Shaken: from sample to sample a rate goes further than the bit, and no course is smooth."""
    time = np.arange(6000) / 50.0
    moving = time % 12.0 > 4.0
    turns = np.column_stack(
        [
            (1.5 * np.sin((1.1 + 0.3 * k) * time) + 0.4 * np.sin((70.0 + 7 * k) * time)) * moving
            for k in range(3)
        ]
    )
    noisy = turns + rng.normal(0, 3e-4, turns.shape)
    lsb, bit = 1e-4, 64
    codes = np.rint(noisy[:, 2] / lsb).astype(np.int64)
    columns = {f"gyro_{a}_rad_s": noisy[:, k] for k, a in enumerate("xyz")}
    columns |= {
        "gyro_z_rad_s": (codes & ~np.int64(bit)) * lsb,
        "fog_a_rad_s": turns @ [0.6, 0.0, 0.8] + rng.normal(0, 1e-4, len(time)),
    }
    found = prepare(BY_HAND, [Recording.from_columns(time, columns)])
    assert [(f.effect.id, f.axes) for f in found.faults] == [("adc_stuck_bit", ("z",))]
    assert np.abs(np.diff(noisy[moving, 2])).max() > bit * lsb
    whole = found.observations.sources[0].column("gyro_z_rad_s")
    assert np.mean(np.abs(whole - codes * lsb)[moving] < 0.1 * lsb) > 0.999


def test_the_simulated_fault_is_found():
    truth = bench({"id": "adc_stuck_bit", "sensor": "accel", "axis": "z", "bit_value_si": 0.02})
    fault = faults_of(truth, recorded(truth, 6))["adc_stuck_bit"]
    assert fault.axes == ("z",)
    assert fault.effect.value("bit_value") == pytest.approx(0.02, rel=1e-3)
