"""Columns of suspects on a user's own model: a 7-joint arm, 60 000 rows that move half of the
time.
"""

import json
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

from tests.benchmarks import sized

ROWS = sized(60_000, 4000)
SUSPECTS = sized(60, 4)
LIMITS = (60.0, 1500)  # s, MiB


def columns() -> dict[str, float]:
    """Calibration and the first suspects of the catalogue: seconds and peak RSS."""
    import resource

    from tests.model_rig import scenario_text
    from tiltcal.diagnosis.data_faults.prepare import prepare
    from tiltcal.diagnosis.hypotheses.coordinate_ranges import ranges_of
    from tiltcal.diagnosis.hypotheses.hypothesis import listed_hypotheses
    from tiltcal.effects.spans import SpectralLines
    from tiltcal.laboratory.scenario import load_scenario

    with tempfile.TemporaryDirectory() as folder:
        path, axes, site, recording = arm(Path(folder))
        (honest := Path(folder, "honest.toml")).write_text(scenario_text(path, axes, site))
        scenario = load_scenario(honest)
        start = time.process_time()
        prepared = prepare(scenario, [recording])
        ready = time.process_time()
        observations, model = prepared.observations, prepared.start
        taken = [t.hypothesis for t in model.nuisance]
        span = ranges_of(observations, SpectralLines())
        suspects = list(listed_hypotheses(scenario, span, taken))[:SUSPECTS]
        for suspect in suspects:
            prepared.whitened.columns.add(suspect, model.effects)
        end = time.process_time()
    return {
        "suspects": len(suspects),
        "preparation": ready - start,
        "columns": end - ready,
        "peak_MiB": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024,
    }


def arm(folder: Path):  # type: ignore[no-untyped-def]
    """Model file, axes, site and recording of an arm on random poses, by plain MuJoCo."""
    import gymnasium
    import mujoco

    from tests.model_rig import Mapped, PlainModel, poses_and_moves
    from tiltcal.recordings.recording import Recording

    source = Path(gymnasium.__file__).parent / "envs" / "mujoco" / "assets" / "pusher_v5.xml"
    (path := folder / source.name).write_bytes(source.read_bytes())
    model = mujoco.MjModel.from_xml_path(str(path))
    names = [model.joint(k).name for k in range(model.njnt)]
    axes = {f"j{k}": Mapped(n) for k, n in enumerate(n for n in names if n.startswith("r_"))}
    rng = np.random.default_rng(1)
    stamps, jets = poses_and_moves(rng, list(axes), ROWS // 200 + 2)
    stamps, jets = stamps[:ROWS], {a: jet[:, :ROWS] for a, jet in jets.items()}
    force, _ = PlainModel(path, axes, "tips_arm").readings(stamps, jets)
    force = force + 60e-6 * 9.80665 * np.sqrt(50) * rng.normal(0, 1, force.shape)
    angles = {f"table_{a}_deg": np.degrees(jet[0]) for a, jet in jets.items()}
    readings = {f"accelerometer_{a}_m_s2": force[:, i] for i, a in enumerate("xyz")}
    return path, axes, "tips_arm", Recording.from_columns(stamps, angles | readings)


def main() -> None:
    """Once, in a process of its own."""
    code = (
        "import json; from tests.benchmarks.own_model import columns; print(json.dumps(columns()))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    found = json.loads(done.stdout.splitlines()[-1])
    seconds, peak = LIMITS
    print(
        f"{ROWS} rows of a 7-joint arm: {found['suspects']:.0f} suspects in"
        f" {found['preparation'] + found['columns']:.1f} s (limit {seconds:g}), of which"
        f" calibration {found['preparation']:.1f} s; peak RSS {found['peak_MiB']:.0f} MiB"
        f" (limit {peak:g})"
    )


if __name__ == "__main__":
    main()
