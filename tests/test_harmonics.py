"""The harmonic dictionary of docs/physics.md, "Harmonics": a horizontal axis turned once, a reading
every degree.

The numbers are from an independent program: ``s1 -1.00`` is -sin(outer), a channel's change in
units of the effect's own size (in g, or rad times g). x reads -sin, z cos. Where the product counts
the readout's error (readout = true + error) and that program the angle's, the sign below is
inverted.
"""

import re

import numpy as np
import pytest
from builders import ACCEL, G, effect_of, read_poses, setup_of, still

from tiltcal.core.units import ARCSEC, G0

SENSOR, TABLE = 1e-6 * G0, ARCSEC * G  # m/s2 per ug, per arcsec

ONE_WAY = {
    "acc_bias bias_x_ug": "x[DC +1.00] y[-] z[-] |f|[s1 -1.00]",
    "acc_bias bias_y_ug": "x[-] y[DC +1.00] z[-] |f|[-]",
    "acc_bias bias_z_ug": "x[-] y[-] z[DC +1.00] |f|[c1 +1.00]",
    "acc_scale scale_x_ppm": "x[s1 -1.00] y[-] z[-] |f|[DC +0.50 c2 -0.50]",
    "acc_scale scale_z_ppm": "x[-] y[-] z[c1 +1.00] |f|[DC +0.50 c2 +0.50]",
    "acc_K2 k2_x_ug_g2": "x[DC +0.50 c2 -0.50] y[-] z[-] |f|[s1 -0.75 s3 +0.25]",
    "acc_K2 k2_z_ug_g2": "x[-] y[-] z[DC +0.50 c2 +0.50] |f|[c1 +0.75 c3 +0.25]",
    "acc_K3 k3_x_ug_g3": "x[s1 -0.75 s3 +0.25] y[-] z[-] |f|[DC +0.38 c2 -0.50 c4 +0.12]",
    "acc_K3 k3_z_ug_g3": "x[-] y[-] z[c1 +0.75 c3 +0.25] |f|[DC +0.38 c2 +0.50 c4 +0.12]",
    "acc_Koq koq_x_ug_g2": "x[s1 -0.85 s3 +0.17] y[-] z[-] |f|[DC +0.42 c2 -0.51 c4 +0.07]",
    "acc_Koq koq_z_ug_g2": "x[-] y[-] z[c1 +0.85 c3 +0.17] |f|[DC +0.42 c2 +0.51 c4 +0.07]",
    "acc_Kio kio_x_ug_g2": "x[s2 -0.50] y[-] z[-] |f|[c1 +0.25 c3 -0.25]",
    "acc_Kip kip_z_ug_g2": "x[-] y[-] z[s2 -0.50] |f|[s1 -0.25 s3 -0.25]",
    "acc_Kpo kpo_y_ug_g2": "x[-] y[s2 -0.50] z[-] |f|[-]",
    "acc_cross_axis cross_xz_ppm": "x[c1 +1.00] y[-] z[-] |f|[s2 -0.50]",
    "acc_cross_axis cross_yx_ppm": "x[-] y[s1 -1.00] z[-] |f|[-]",
    "mount_misalignment tilt_x_arcsec": "x[-] y[c1 +1.00] z[-] |f|[-]",
    "mount_misalignment tilt_y_arcsec": "x[c1 -1.00] y[-] z[s1 -1.00] |f|[-]",
    "mount_misalignment tilt_z_arcsec": "x[-] y[s1 +1.00] z[-] |f|[-]",
    "table_levelling tilt_east_arcsec": "x[-] y[DC +1.00] z[-] |f|[-]",
    "table_levelling tilt_north_arcsec": "x[c1 -1.00] y[-] z[s1 -1.00] |f|[-]",
    "table_encoder_zero -outer_zero_arcsec": "x[c1 -1.00] y[-] z[s1 -1.00] |f|[-]",
    "table_encoder_eccentricity -cos_arcsec": "x[DC -0.50 c2 -0.50] y[-] z[s2 -0.50] |f|[-]",
    "table_encoder_eccentricity -sin_arcsec": "x[s2 -0.50] y[-] z[DC -0.50 c2 +0.50] |f|[-]",
    "table_encoder_2rev -cos_arcsec": "x[c1 -0.50 c3 -0.50] y[-] z[s1 +0.50 s3 -0.50] |f|[-]",
    "table_encoder_2rev -sin_arcsec": "x[s1 -0.50 s3 -0.50] y[-] z[c1 -0.50 c3 +0.50] |f|[-]",
    "table_sag sag_arcsec": "x[s2 -0.50] y[-] z[DC -0.50 c2 +0.50] |f|[-]",
    # (c + i s) exp(i n a) along z and x: only the turn about x lifts y, by s cos(na) + c sin(na)
    "table_axis_wobble m1s_arcsec": "x[-] y[c1 +1.00] z[-] |f|[-]",
    "table_axis_wobble m1c_arcsec": "x[-] y[s1 -1.00] z[-] |f|[-]",
    "table_axis_wobble p2s_arcsec": "x[-] y[c2 +1.00] z[-] |f|[-]",
    "table_axis_wobble p2c_arcsec": "x[-] y[s2 +1.00] z[-] |f|[-]",
    "table_axis_wobble m2s_arcsec": "x[-] y[c2 +1.00] z[-] |f|[-]",
    "table_axis_wobble m2c_arcsec": "x[-] y[s2 -1.00] z[-] |f|[-]",
}
ASYMMETRY = {  # the program's unit is the whole coefficient, the product's reading += a/2 |f|
    "acc_scale_asym scale_asym_x_ppm": (
        "x[DC +0.64 c2 -0.42 c4 -0.08] y[-] z[-] |f|[s1 -0.85 s3 +0.17]"
    ),
    "acc_scale_asym scale_asym_z_ppm": (
        "x[-] y[-] z[DC +0.64 c2 +0.42 c4 -0.08] |f|[c1 +0.85 c3 +0.17]"
    ),
}
ROUNDED, HIDDEN = 0.0051, 0.03  # the program prints two decimals, and nothing below 0.03


def expected(line):
    """The dictionary's words -> channel -> harmonic -> amplitude."""
    return {
        channel: {name: float(value) for name, value in re.findall(r"(\w+) ([-+]\d\.\d+)", words)}
        for channel, words in re.findall(r"(\S+)\[([^]]*)\]", line)
    }


def harmonics(signal):
    """Harmonic content up to the fifth order."""
    spectrum = np.fft.rfft(signal) / len(signal)
    found = {"DC": spectrum[0].real}
    for k in range(1, 6):
        found[f"c{k}"], found[f"s{k}"] = 2 * spectrum[k].real, -2 * spectrum[k].imag
    return found


def signature(words):
    """Change of each channel and of the norm over one turn, per unit of the effect."""
    id, key = words.split(" ")
    sign, key = (-1, key[1:]) if key.startswith("-") else (1, key)
    setup = setup_of("placing", ACCEL)
    setup = setup.model_copy(update={"site": setup.site.model_copy(update={"gravity_m_s2": G0})})
    drive = still(setup, outer=np.arange(360.0))
    unit = 1e-6 if key.endswith("ppm") or "_ug" in key else ARCSEC
    plain, plus, minus = (
        read_poses(setup, drive, effect_of(id, setup, **{key: sign * size}))["accel"] / G0
        for size in (0.0, 10.0, -10.0)
    )
    change = (plus - minus) / (20 * unit)
    return {
        "x": change[:, 0],
        "y": change[:, 1],
        "z": change[:, 2],
        "|f|": np.sum(plain * change, axis=1),
    }


@pytest.mark.parametrize("words", [*ONE_WAY, *ASYMMETRY])
def test_an_effect_has_the_harmonics_of_the_dictionary(words):
    size = 0.5 if words in ASYMMETRY else 1.0
    line = expected((ONE_WAY | ASYMMETRY)[words])
    for channel, signal in signature(words).items():
        for name, found in harmonics(signal).items():
            wanted = size * line[channel].get(name, 0.0)
            assert found == pytest.approx(wanted, abs=size * (ROUNDED if wanted else HIDDEN)), (
                f"{channel} {name}"
            )


def test_one_channel_cannot_tell_encoder_eccentricity_from_bias_and_k2_but_the_norm_can():
    encoder, bias, k2 = (
        signature(w)
        for w in (
            "table_encoder_eccentricity cos_arcsec",
            "acc_bias bias_x_ug",
            "acc_K2 k2_x_ug_g2",
        )
    )
    np.testing.assert_allclose(encoder["x"], bias["x"] - k2["x"], atol=1e-6)
    assert np.abs(encoder["|f|"]).max() < 1e-6
    assert np.abs(bias["|f|"] - k2["|f|"]).max() > 0.3


def test_sag_is_the_twin_of_the_encoders_sine_on_a_horizontal_axis():
    sag, encoder = (
        signature("table_sag sag_arcsec"),
        signature("table_encoder_eccentricity -sin_arcsec"),
    )
    for channel in ("x", "y", "z"):
        np.testing.assert_allclose(sag[channel], encoder[channel], atol=1e-3)


@pytest.mark.parametrize(
    ("words", "sign"),
    [("table_backlash width_arcsec", -1), ("table_encoder_eccentricity cos_arcsec", 1)],
)
def test_lost_motion_changes_sign_with_the_way_round_and_eccentricity_does_not(words, sign):
    setup = setup_of("placing", ACCEL)
    id, key = words.split(" ")
    there, back = (
        still(setup, outer=angles) for angles in (np.arange(0.0, 361.0), np.arange(360.0, -1.0, -1))
    )
    up, down = (
        (
            read_poses(setup, drive, effect_of(id, setup, **{key: 10.0}))["accel"]
            - read_poses(setup, drive)["accel"]
        )[1:-1]
        for drive in (there, back)
    )
    assert np.abs(up).max() > 1e-5
    np.testing.assert_allclose(down[::-1], sign * up, atol=1e-3 * np.abs(up).max())
