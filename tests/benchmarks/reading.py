"""Time of dwells + fit on a real log, after imports, and with reading the text: as ratios to
``numpy.loadtxt`` of the same text in the same run.

The limit of the fit is the time of imu_tk, the C++ program that the log comes from. On an idle
machine it took 53 ms for the log where dwells and fit took 35 ms, which is 1.5 times loadtxt: 2.3
times loadtxt for imu_tk, and the limit lies below. The earlier limit of 25 ms was for dwells and
one fit. Since then every fit is tested: a third of its time goes into 14 refits with a direction
left out, a fifth into the codes that the channels were rounded to, less than a tenth into the
tests of the channels. The limit with reading leaves half as much again as loadtxt for our own
reader, which checks units, stamps and gaps.
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


FIT, WHOLE, HELP_MS = 2.0, 3.5, 300


def main() -> None:
    """Medians of eleven runs. And the command line's answer to --help."""
    start = []
    for _ in range(sized(5, 1)):
        begin = children_s()
        subprocess.run([sys.executable, "-m", "tiltcal", "--help"], capture_output=True, check=True)
        start.append(children_s() - begin)
    print(f"tiltcal --help: {1e3 * np.median(start):.0f} ms (limit {HELP_MS})")
    if (reason := reason_without(LOG)) is not None:
        print(f"real log left out: {reason}")
        return
    from tiltcal.calibration.methods.registry import calibrate
    from tiltcal.laboratory.scenario import load_scenario
    from tiltcal.recordings.foreign_files import import_recording
    from tiltcal.recordings.mapping import load_mapping

    setup = load_scenario(ROOT / "scenarios/real/xsens.toml")
    mapping = load_mapping(ROOT / "scenarios/real/xsens_map.toml")
    times = []
    for _ in range(sized(11, 1)):
        begin = time.process_time()
        np.loadtxt(LOG)
        plain = time.process_time()
        recording = import_recording(LOG, mapping)
        read = time.process_time()
        found = calibrate("norm", recording, setup)
        times.append((plain - begin, read - plain, time.process_time() - read))
    loadtxt, reading, fit = np.median(times, axis=0)
    print(
        f"dwells + 9-parameter fit of {len(recording)} real samples: {1e3 * fit:.0f} ms,"
        f" {fit / loadtxt:.2f} x numpy.loadtxt of its text (limit {FIT}), with reading the text"
        f" {(reading + fit) / loadtxt:.2f} x (limit {WHOLE}), held-out"
        f" {found.heldout_rms['accel'] / 9.80665e-3:.3f} mg"
    )
