"""Speed of the laboratory against a bare ``mj_inverse`` loop over the same samples, in one run;
peak memory.
"""

import json
import resource
import subprocess
import sys
import time

import mujoco
import numpy as np

from tests.benchmarks import sized
from tiltcal.laboratory.scenario import Scenario, parse_scenario

RATE, HOUR = 100.0, 3600.0
ERRORS = [
    {"id": "table_levelling", "tilt_east_arcsec": 12, "tilt_north_arcsec": -7},
    {"id": "table_encoder_eccentricity", "axis": "outer", "cos_arcsec": 5, "sin_arcsec": 3},
    {"id": "axis_nonorthogonality", "outer_middle_arcsec": 10, "middle_inner_arcsec": -8},
    {"id": "mount_misalignment", "tilt_x_arcsec": 120, "tilt_y_arcsec": -60, "tilt_z_arcsec": 200},
    {"id": "lever_arm", "lever_x_mm": 12, "lever_y_mm": -4, "lever_z_mm": 30},
    {"id": "acc_bias", "bias_x_ug": 3000, "bias_y_ug": -2000, "bias_z_ug": 1000},
    {"id": "acc_scale", "scale_x_ppm": 900, "scale_y_ppm": -600, "scale_z_ppm": 300},
    {"id": "acc_cross_axis", "cross_xy_ppm": 700, "cross_yz_ppm": -300, "cross_zx_ppm": 200},
    {"id": "acc_K2", "k2_x_ug_g2": 120, "k2_y_ug_g2": -60, "k2_z_ug_g2": 30},
    {"id": "acc_K3", "k3_x_ug_g3": 20},
    {"id": "acc_Kip", "kip_x_ug_g2": 40},
    {"id": "acc_temp_bias", "temp_bias_x_ug_degC": 100, "temp_bias_z_ug_degC": -50},
    {"id": "acc_noise", "white_ug_rthz": 25, "flicker_ug": 8, "walk_ug_rts": 0.2},
    {"id": "adc_quantisation", "sensor": "accel", "lsb_si": 1e-4},
    {"id": "gyr_bias", "bias_x_deg_s": 0.2, "bias_y_deg_s": -0.1},
    {"id": "gyr_scale", "scale_x_ppm": 3000, "scale_z_ppm": -2000},
    {"id": "gyr_misalignment", "cross_xy_ppm": 2000, "cross_zy_ppm": -1500},
    {"id": "gyr_gsens", "gsens_xx_deg_h_g": 30, "gsens_yz_deg_h_g": 20},
    {"id": "gyr_noise", "white_deg_rth": 0.3, "flicker_deg_h": 8},
    {"id": "adc_quantisation", "sensor": "gyro", "lsb_si": 1e-5},
]


def scenario(moving: bool) -> Scenario:
    """One hour at 100 Hz on six axes: always moving, or mostly dwells."""
    if moving:
        steps = [
            {"action": "turn", "axis": axis, "angle_deg": 20.0 * 200, "rate_deg_s": 20.0}
            for axis in ("outer", "middle", "inner") * sized(6, 1)
        ]
    else:
        steps = [
            {
                "action": "move",
                "outer_deg": 7.0 * k,
                "middle_deg": 31.0 * k,
                "inner_deg": 53.0 * k % 360,
                "rate_deg_s": 60,
                "dwell_s": 55,
            }
            for k in range(1, sized(64, 3))
        ]
    return parse_scenario(
        {
            "schema": 1,
            "name": "benchmark",
            "site": {"gravity_m_s2": 9.80123, "latitude_deg": 45.0},
            "rig": {"table": "three"},
            "climate": {"ramp_degC_h": 4.0},
            "sensor": [
                {"name": "accel", "kind": "accelerometer", "rate_hz": RATE},
                {"name": "gyro", "kind": "gyro", "rate_hz": RATE},
            ],
            "sequence": steps,
            "effect": ERRORS,
        }
    )


def bare_loop(q: np.ndarray, v: np.ndarray, a: np.ndarray) -> float:
    """Seconds of a plain Python loop of mj_inverse over all samples, without any error."""
    from tiltcal.core.assets import folder

    spec = mujoco.MjSpec.from_file(str(folder("models") / "three.xml"))
    for axis in "xyz":
        spec.delete(spec.joint(f"bend_{axis}"))
    spec.delete(spec.sensor("fog"))
    model = spec.compile()
    data = mujoco.MjData(model)
    out = np.empty((len(q), 6))
    start = time.process_time()
    for k in range(len(q)):
        data.qpos[:], data.qvel[:], data.qacc[:] = q[k], v[k], a[k]
        mujoco.mj_inverse(model, data)
        out[k] = data.sensordata
    return time.process_time() - start


def measure(moving: bool) -> dict[str, float]:
    """Seconds of the laboratory and of the loop over the same samples; peak RSS of the laboratory
    in MiB.
    """
    from tiltsim.laboratory import MujocoLaboratory

    case = scenario(moving)
    laboratory = MujocoLaboratory()
    start = time.process_time()
    recording = laboratory.record(case, 1)
    ours = time.process_time() - start
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    drive = case.schedule.drive(recording.time)
    q, v, a = (
        np.column_stack([np.asarray(getattr(jet, part)) for jet in drive.axes.values()])
        for part in "xva"
    )
    return {
        "rows": len(recording),
        "laboratory_s": ours,
        "loop_s": bare_loop(q, v, a),
        "peak_MiB": peak,
    }


def main() -> None:
    """Three runs of each case, each in a process of its own; the median ratio."""
    for name, moving, limit in (("always moving", True, 1.25), ("mostly dwells", False, 0.40)):
        runs = []
        for _ in range(sized(3, 1)):
            code = (
                "import json; from tests.benchmarks.simulation import measure;"
                f" print(json.dumps(measure({moving})))"
            )
            done = subprocess.run(
                [sys.executable, "-c", code], capture_output=True, text=True, check=True
            )
            runs.append(json.loads(done.stdout))
        ratio = float(np.median([r["laboratory_s"] / r["loop_s"] for r in runs]))
        peak = max(r["peak_MiB"] for r in runs)
        print(
            f"simulate 1 h x 100 Hz x 6 axes, {name}: {runs[0]['rows']} rows, {ratio:.2f} x a bare"
            f" mj_inverse loop (limit {limit}), {np.median([r['laboratory_s'] for r in runs]):.2f}"
            f" s, peak RSS {peak:.0f} MiB (limit 300)"
        )
