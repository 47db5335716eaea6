"""Who is confused with whom: the eight recordings and 57 columns of docs/physics.md,
"What is confused with what".
"""

import numpy as np
import pytest
from builders import ACCEL, drive_of, setup_of

from tiltcal.core.frames import rotation
from tiltcal.core.units import G0
from tiltcal.design.identifiability import classes, confuse, tie_breaker
from tiltcal.effects import make_effect
from tiltcal.effects.base import SignalEffect
from tiltcal.forward.kinematics import closed_form
from tiltcal.forward.signal_chain import make_sense
from tiltcal.laboratory.scenario import load_scenario
from tiltcal.setup.trajectory import Jet

MICRO = 1e-6 * G0
TURN = [
    np.eye(3),
    rotation("x", np.pi),
    rotation("y", np.pi / 2),
    rotation("z", np.pi / 2),
    rotation("x", np.pi / 2),
]


def degrees(low, high, step):
    return np.arange(low, high + 1e-9, step)


def horizontal(*runs):
    """(outer angle, direction, remount) of sweeps: (angles, direction, remount)."""
    return [((a,), d, R) for angles, d, R in runs for a in (angles if d > 0 else angles[::-1])]


def recordings():
    """Name -> (table, poses as (angles deg, direction, remount), rank, visible)."""
    full, eye = degrees(0, 350, 10), TURN[0]
    both = [(full, 1, eye), (full, -1, eye)]
    tilts, turns = [0, 45, 90, 135, 180, -135, -90, -45], [0, 45, 90, 135, 180, 225, 270, 315]
    grid = [
        ((t, r), 1 if i % 2 else -1, eye)
        for i, (t, r) in enumerate((t, r) for t in tilts for r in turns)
    ]
    rng = np.random.default_rng(3)
    random = [(tuple(np.degrees(rng.uniform(-np.pi, np.pi, 3))), 1, eye) for _ in range(60)]
    six = [((0, b, c), 1, eye) for b, c in ((0, 0), (0, 180), (0, 90), (0, -90), (90, 0), (-90, 0))]
    remounted = [(full, 1, R) for R in TURN[1:2] + TURN[2:4] + TURN[4:]]
    return {
        "H90": ("placing", horizontal((degrees(0, 90, 1), 1, eye)), 21, 42),
        "H360": ("placing", horizontal((full, 1, eye)), 25, 42),
        "H360B": ("placing", horizontal(*both), 26, 42),
        "H360M": ("placing", horizontal(*both, *remounted), 47, 55),
        "V360": ("vertical", horizontal(*both), 14, 24),
        "SIX": ("three", six, 18, 46),
        "D24": ("dual", grid, 49, 56),
        "T60": ("three", random, 51, 56),
    }


TWINS = {
    "H90": [
        {"K1_x", "K1asym_x"},
        {"K2_x", "Koq_x"},
        {"K0_y", "level_E"},
        {"mis_yx", "mount_z"},
        {"enc1s", "sag"},
        {"mount_y", "level_N", "enc0", "backlash"},
    ],
    "H360": [{"K0_y", "level_E"}, {"mount_y", "level_N", "enc0", "backlash"}, {"enc1s", "sag"}],
    "H360B": [{"K0_y", "level_E"}, {"mount_y", "level_N", "enc0"}, {"enc1s", "sag"}],
    "H360M": [{"level_N", "enc0"}, {"enc1s", "sag"}],
    "V360": [
        {"K0_x", "mis_xz", "mount_y"},
        {"K0_z", "K1_z", "K2_z", "K3_z", "Koq_z", "K1asym_z", "gmag"},
    ],
    "SIX": [
        {"K1_x", "K3_x", "Koq_x"},
        {"K2_x", "K1asym_x"},
        {"mount_x", "enc0"},
        {"level_E", "nonorth1"},
    ],
    "D24": [{"mount_z", "enc0"}],
    "T60": [{"mount_x", "enc0"}],
}


def column_effects(table):
    """Column name of the table -> (effect id, parameters, axis)."""
    last = {"placing": "outer", "vertical": "outer", "dual": "inner", "three": "inner"}[table]
    found = {}
    stems = {
        "K0": ("acc_bias", "bias_{}_ug"),
        "K1": ("acc_scale", "scale_{}_ppm"),
        "K2": ("acc_K2", "k2_{}_ug_g2"),
        "K3": ("acc_K3", "k3_{}_ug_g3"),
        "Koq": ("acc_Koq", "koq_{}_ug_g2"),
        "K1asym": ("acc_scale_asym", "scale_asym_{}_ppm"),
        "Kip": ("acc_Kip", "kip_{}_ug_g2"),
        "Kio": ("acc_Kio", "kio_{}_ug_g2"),
        "Kpo": ("acc_Kpo", "kpo_{}_ug_g2"),
        "drift": ("acc_drift", "drift_{}_ug"),
    }
    for a in "xyz":
        for stem, (id, key) in stems.items():
            found[f"{stem}_{a}"] = (id, {key.format(a): 10.0}, None)
        for b in "xyz":
            if a != b:
                found[f"mis_{a}{b}"] = ("acc_cross_axis", {f"cross_{a}{b}_ppm": 100.0}, None)
        found[f"mount_{a}"] = ("mount_misalignment", {f"tilt_{a}_arcsec": 2.0}, None)
    for name, part in (("level_E", "tilt_east_arcsec"), ("level_N", "tilt_north_arcsec")):
        found[name] = ("table_levelling", {part: 2.0}, None)
    found |= {
        "enc0": ("table_encoder_zero", {f"{last}_zero_arcsec": 2.0}, None),
        "enc1c": ("table_encoder_eccentricity", {"cos_arcsec": 2.0}, last),
        "enc1s": ("table_encoder_eccentricity", {"sin_arcsec": 2.0}, last),
        "enc2c": ("table_encoder_2rev", {"cos_arcsec": 2.0}, last),
        "enc2s": ("table_encoder_2rev", {"sin_arcsec": 2.0}, last),
        "sag": ("table_sag", {"sag_arcsec": 2.0}, None),
        "gmag": ("gravity_magnitude", {"gravity_error_ppm": 10.0}, None),
        "backlash": ("table_backlash", {"width_arcsec": 2.0}, "outer"),
        "nonorth1": (
            "axis_nonorthogonality",
            {"outer_middle_arcsec" if table == "three" else "outer_inner_arcsec": 2.0},
            None,
        ),
        "nonorth2": ("axis_nonorthogonality", {"middle_inner_arcsec": 2.0}, None),
    }
    for n, order in (("m1", "-1"), ("p2", "+2"), ("m2", "-2")):
        for part, c in (("re", "c"), ("im", "s")):
            found[f"wob{order}{part}"] = ("table_axis_wobble", {f"{n}{c}_arcsec": 2.0}, last)
    return found


def columns(name):
    """Signatures at the poses of a recording, in micro-g, as the table has them: name -> (3 n,)."""
    table, poses, *_ = recordings()[name]
    setup = setup_of(table, ACCEL)
    n = len(poses)
    angles = np.radians(np.array([p[0] for p in poses], dtype=float))
    direction = np.array([p[1] for p in poses], dtype=float)
    starts = [k for k in range(n) if k == 0 or not np.array_equal(poses[k][2], poses[k - 1][2])]
    mounts = tuple((k, poses[k][2]) for k in starts)
    axes = {
        axis: Jet(angles[:, i], 1e-9 * direction, np.zeros(n))
        for i, axis in enumerate(setup.rig.axis_names)
    }
    drive = drive_of(axes, np.arange(n, dtype=float), rest=True, mounts=mounts)

    def reading(effect):
        still = closed_form(setup, drive, [] if isinstance(effect, SignalEffect) else [effect])
        sense = make_sense(setup.sensor[0], setup, still, drive)
        values = sense.true_input()
        return effect.apply(values, sense, None) if isinstance(effect, SignalEffect) else values

    found = {}
    for column, (id, values, axis) in column_effects(table).items():
        sides = []
        for sign in (1, -1):
            if id == "table_backlash" and table == "three":
                sides.append(0.0)  # their three-axis table has none
                continue
            plus = make_effect(id, values, setup, axis=axis)
            sides.append(
                reading(
                    type(plus)(
                        {k: sign * v for k, v in plus.values.items()}, plus.sensor, plus.axis
                    )
                )
            )
        found[column] = (
            (np.asarray(sides[0]) - sides[1]).ravel() / 2 / MICRO
            if np.ndim(sides[0])
            else np.zeros(3 * n)
        )
    return found


def normalised(found):
    names = [k for k, v in found.items() if np.linalg.norm(v) > 1e-6]
    return names, np.array([found[k] / np.linalg.norm(found[k]) for k in names]).T


@pytest.mark.parametrize("name", list(recordings()))
def test_the_confusability_table_is_reproduced(name):
    _, _, rank, visible = recordings()[name]
    names, J = normalised(columns(name))
    assert len(names) == visible
    assert np.linalg.matrix_rank(J, 1e-6) == rank
    cosine = np.abs(J.T @ J)
    for group in TWINS[name]:
        index = [names.index(m) for m in group]
        assert cosine[np.ix_(index, index)].min() > 0.9999, group


def test_a_scenario_is_told_what_it_can_tell_apart(tmp_path):
    path = tmp_path / "sweep.toml"
    path.write_text("""schema = 1
name = "placing sweep"
[site]
gravity_m_s2 = 9.8
[rig]
table = "placing"
[[sensor]]
name = "accel"
kind = "accelerometer"
rate_hz = 20
adjustable = ["bias", "scale", "cross_axis"]
[[sequence]]
action = "rest"
dwell_s = 3
[[sequence]]
action = "sweep"
outer_deg = 360
step_deg = 20
dwell_s = 3
[[sequence]]
action = "sweep"
outer_deg = 0
step_deg = 20
dwell_s = 3
""")
    found = confuse(load_scenario(path))
    sights = {s.column.label: s for s in found.sights}
    # a constant on y: one with its bias
    assert sights["table_levelling.tilt_east"].absorbed > 0.999
    assert np.isinf(sights["gravity_magnitude.gravity_error"].detectable)
    assert "table_encoder_eccentricity[outer].sin" in dict(
        sights["table_sag[outer].sag"].alternatives
    )
    assert any({"table_sag", "table_encoder_eccentricity"} <= set(g) for g in classes(found))
    assert "payload" in tie_breaker("table_sag", "table_encoder_eccentricity")
    assert 0 < sights["acc_K2[accel].k2_x"].detectable < 500


def test_a_detectable_size_is_what_monte_carlo_finds_at_eighty_per_cent(rng):
    """Power of a one-parameter test at 0.1 % false alarm with the non-centrality that POWER
    states.
    """
    from scipy.stats import chi2, ncx2

    from tiltcal.design.identifiability import POWER

    assert ncx2.sf(chi2.isf(1e-3, 1), 1, POWER) == pytest.approx(0.8, abs=0.005)
    draws = (rng.normal(size=20000) + np.sqrt(POWER)) ** 2 > chi2.isf(1e-3, 1)
    assert draws.mean() == pytest.approx(0.8, abs=3.9 * np.sqrt(0.16 / 20000))
