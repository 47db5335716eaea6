"""The analogue chain with one converter: each part by a figure worked by hand."""

import numpy as np
import pytest
from builders import LATITUDE, G
from pydantic import ValidationError

from tiltcal.core.units import ARCSEC, G0
from tiltcal.forward.signal_chain import converted, fine_grid, quantise
from tiltcal.laboratory.laboratory import SimulatedLaboratory
from tiltcal.laboratory.scenario import Scenario
from tiltcal.setup.sensor import Converter, Sensor

AD7705 = Converter()


def gain_at(frequency, converter=AD7705, channel=0, delay=0.0):
    """Complex gain of the chain at a frequency, by a cosine and a sine."""
    # stamps that do not beat with the tone
    time = 1.0 + np.arange(200) * 0.05 + 1e-4 * np.arange(200)
    grid = fine_grid(converter, time, delay)
    read = [
        converted(
            converter,
            grid,
            np.column_stack([wave(2 * np.pi * frequency * grid)] * 2),
            [time - delay] * 2,
        )[:, channel]
        for wave in (np.cos, np.sin)
    ]
    return (read[0] + 1j * read[1]) / np.exp(2j * np.pi * frequency * time)


def test_the_code_is_that_of_the_paper_with_and_without_the_amplifier():
    assert np.arcsin(AD7705.lsb / G0) / ARCSEC == pytest.approx(1.75, abs=0.005)
    bare = Converter(amplifier=1.0)
    assert np.arcsin(bare.lsb / G0) / ARCSEC == pytest.approx(157, abs=0.5)
    # +- 15 deg fit, with a little room
    assert np.degrees(np.arcsin(AD7705.limit / G0)) == pytest.approx(16.1, abs=0.05)


@pytest.mark.parametrize("frequency", [1.0, 10.0, 50.0, 100.0])
def test_low_pass_and_sinc3_have_their_textbook_response(frequency):
    """docs/physics.md, "Electronics": at 250 Hz the sinc3 passes 50 Hz at -1.7 dB."""
    lowpass = 1 / np.sqrt(1 + (frequency / AD7705.lowpass_hz) ** 2)
    sinc3 = abs(np.sinc(frequency / AD7705.output_hz)) ** 3
    assert np.abs(gain_at(frequency)) == pytest.approx(lowpass * sinc3, rel=0.004)
    if frequency == 50.0:
        assert 20 * np.log10(sinc3) == pytest.approx(-1.7, abs=0.05)


def test_a_notch_lies_at_the_output_rate():
    assert np.abs(gain_at(250.0)).max() < 1e-3


def test_the_channels_are_taken_in_turn_sixteen_milliseconds_apart():
    f = 2.0
    first, second = (np.angle(np.mean(gain_at(f, channel=c))) for c in (0, 1))
    assert (second - first) / (2 * np.pi * f) == pytest.approx(AD7705.turn_s, rel=1e-3)
    assert AD7705.turn_s == pytest.approx(0.016)
    # half the window, and the low-pass
    group = (
        1.5 / AD7705.output_hz
        - 1.5 / AD7705.modulator_hz
        + np.arctan(f / AD7705.lowpass_hz) / (2 * np.pi * f)
    )
    assert -second / (2 * np.pi * f) == pytest.approx(group, rel=0.002)


def test_a_delay_is_added_to_the_chain_s_own():
    f = 2.0
    late, prompt = (np.angle(np.mean(gain_at(f, delay=d))) for d in (0.02, 0.0))
    assert (prompt - late) / (2 * np.pi * f) == pytest.approx(0.02, rel=1e-3)


def test_codes_are_whole_and_end_at_the_limits():
    values = np.array([[-100.0, 100.0], [0.4 * AD7705.lsb, 0.6 * AD7705.lsb]])
    np.testing.assert_allclose(
        quantise(AD7705, values) / AD7705.lsb, [[-32768, 32767], [0, 1]], atol=1e-9
    )


def scenario(*effects, **converter):
    table = {
        "schema": 1,
        "name": "chain",
        "site": {"gravity_m_s2": G, "latitude_deg": LATITUDE},
        "rig": {"table": "vertical"},
        "sensor": [
            {
                "name": "accel",
                "kind": "accelerometer",
                "axes": ["x", "y"],
                "rate_hz": 20,
                "converter": converter,
            }
        ],
        "sequence": [{"action": "rest", "dwell_s": 20}],
        "effect": list(effects),
    }
    return Scenario.model_validate(table)


def test_mains_at_fifty_hertz_folds_to_ten_in_the_recording():
    """Twenty pairs a second: 50 Hz and its alias at 10 Hz are one."""
    mains = {"id": "mains_pickup", "pickup_x_ug": 1000, "frequency_hz": 50.3}
    read = SimulatedLaboratory().record(scenario(mains)).column("accel_x_m_s2")[40:]
    power = np.abs(np.fft.rfft(read - read.mean()))
    alias = np.fft.rfftfreq(len(read), 0.05)[np.argmax(power)]
    assert alias == pytest.approx(9.7, abs=0.06)  # 60 - 50.3
    size = np.sinc(50.3 / 250) ** 3 / np.sqrt(1 + 5.03**2)
    assert np.sqrt(2) * read.std() == pytest.approx(1e-3 * G0 * size, rel=0.03)


def test_a_tilt_beyond_the_range_clips_at_the_limit_and_a_noisy_one_is_coded():
    steep = SimulatedLaboratory().record(
        scenario({"id": "table_levelling", "tilt_north_arcsec": 20 * 3600})
    )
    assert np.abs(steep.column("accel_x_m_s2")) == pytest.approx(AD7705.limit)
    noisy = SimulatedLaboratory().record(scenario({"id": "acc_noise", "white_ug_rthz": 11}), 3)
    codes = noisy.column("accel_y_m_s2") / AD7705.lsb
    assert np.abs(codes - np.rint(codes)).max() < 1e-6
    assert len(set(np.rint(codes))) > 5


def test_a_converter_where_none_can_be_is_refused_in_words():
    with pytest.raises(ValidationError, match="all its channels in turn within one sample"):
        Sensor(name="a", kind="accelerometer", axes=("x", "y"), rate_hz=50, converter=AD7705)
    with pytest.raises(ValidationError, match="a converter serves an accelerometer"):
        Sensor(name="g", kind="gyro", rate_hz=5, converter=AD7705)
    with pytest.raises(ValidationError, match="call the sensor an accelerometer"):
        Sensor(name="i", kind="inclinometer", axes=("x", "y"), rate_hz=5, converter=AD7705)


def test_noise_is_added_after_the_filter_with_its_own_size():
    read = (
        SimulatedLaboratory()
        .record(scenario({"id": "acc_noise", "white_ug_rthz": 100}), 4)
        .column("accel_x_m_s2")
    )
    assert read.std() == pytest.approx(100e-6 * G0 * np.sqrt(20), rel=0.15)
