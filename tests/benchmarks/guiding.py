"""Share of a core that the live guide takes: a stream of 1 kHz with six channels for ten minutes, a
pose every 20 s, the state asked for 20 times a second. Limit: half a core.
"""

import resource
import time

import numpy as np
from hand_simulation import Hand, scenario

import tiltcal as tc
from tests.benchmarks import sized
from tiltcal.setup.pose_schemes import directions

RATE_HZ, BLOCK = 1000.0, 50  # samples a second, rows a feed
LENGTH_S = sized(600.0, 20.0)
MOVE_S, HOLD_S = 5.0, 15.0
LIMIT = 0.5  # of a core


def main() -> None:
    bench = tc.parse_scenario(scenario(rate_hz=RATE_HZ))
    guide = tc.Guide(bench, "norm", goal={"bias": "0.1ug"})  # never reached
    hand = Hand(rate_hz=RATE_HZ, white=100e-6 * 9.80665 * np.sqrt(RATE_HZ))
    rng = np.random.default_rng(1)
    poses = np.vstack([directions(scheme) for scheme in ("6", "12", "8")])
    spent, longest, number = 0.0, 0.0, 0
    while hand.time < LENGTH_S:
        pose = poses[number % len(poses)]
        number += 1
        for stamps, columns in (hand.turn(pose, MOVE_S), hand.hold(HOLD_S)):
            gyro = {f"gyro_{a}_deg_s": rng.normal(0, 0.05, len(stamps)) for a in "xyz"}
            every = {**columns, **gyro}
            for first in range(0, len(stamps), BLOCK):
                part = slice(first, first + BLOCK)
                begun = time.process_time()
                guide.feed(stamps[part], {name: v[part] for name, v in every.items()})
                assert guide.state.rows
                took = time.process_time() - begun
                spent, longest = spent + took, max(longest, took)
    memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    share = spent / hand.time
    print(f"guiding {hand.time:.0f} s of {RATE_HZ:.0f} Hz x 6: {share:.3f} of a core", end=" ")
    print(f"(limit {LIMIT}), longest feed {longest:.2f} s, {memory:.0f} MiB at most,", end=" ")
    print(f"{len(guide.state.dwells)} dwells")
