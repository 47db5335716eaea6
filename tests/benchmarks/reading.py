"""Time of dwells + fit on a real log, inside the process after imports, and with reading the
text.
"""

import subprocess
import sys
import time
from pathlib import Path

import numpy as np

from tests.benchmarks import children_s, sized
from tests.outside_files import RECORDINGS, reason_without

ROOT = Path(__file__).resolve().parents[2]
LOG = RECORDINGS / "xsens_mti" / "xsens_acc.mat"


def main() -> None:
    """Ten runs; medians. And the command line's answer to --help."""
    start = []
    for _ in range(sized(5, 1)):
        begin = children_s()
        subprocess.run([sys.executable, "-m", "tiltcal", "--help"], capture_output=True, check=True)
        start.append(children_s() - begin)
    print(f"tiltcal --help: {1e3 * np.median(start):.0f} ms (limit 300)")
    if (reason := reason_without(LOG)) is not None:
        print(f"real log left out: {reason}")
        return
    from tiltcal.calibration.methods.registry import calibrate
    from tiltcal.laboratory.scenario import load_scenario
    from tiltcal.recordings.foreign_files import import_recording
    from tiltcal.recordings.mapping import load_mapping

    setup, mapping = (
        load_scenario(ROOT / "scenarios/real/xsens.toml"),
        load_mapping(ROOT / "scenarios/real/xsens_map.toml"),
    )
    fits, whole = [], []
    for _ in range(sized(11, 1)):
        begin = time.process_time()
        recording = import_recording(LOG, mapping)
        middle = time.process_time()
        found = calibrate("norm", recording, setup)
        fits.append(time.process_time() - middle)
        whole.append(time.process_time() - begin)
    print(
        f"dwells + 9-parameter fit of {len(recording)} real samples: {1e3 * np.median(fits):.0f} ms"
        f" (limit 25), with reading the text {1e3 * np.median(whole):.0f} ms (limit 90), held-out"
        f" {found.heldout_rms['accel'] / 9.80665e-3:.3f} mg"
    )
