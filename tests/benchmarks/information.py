"""Time and memory of what `confuse` computes: a 64-pose scenario, and the information matrix of an
always moving log.
"""

import json
import subprocess
import sys
import time

import numpy as np

from tests.benchmarks import sized

ROWS = sized(60_000, 1000)


def moving() -> dict[str, float]:
    """Gram matrix of all effects for moving samples of six channels: seconds and peak
    RSS.
    """
    import resource

    from tests.benchmarks.simulation import scenario
    from tiltcal.forward.jacobian import Rows, gram, sensitivity

    case = scenario(moving=True)
    start = time.process_time()
    rows = Rows(np.arange(ROWS) / 100.0, np.ones(ROWS))
    columns = sensitivity(case, case.schedule, rows)
    matrix = gram(columns)
    seconds = time.process_time() - start
    return {
        "seconds": seconds,
        "columns": len(matrix),
        "peak_MiB": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024,
    }


def poses() -> dict[str, float]:
    """The whole answer for 64 poses on the dual table."""
    from tiltcal.design.identifiability import confuse
    from tiltcal.laboratory.scenario import parse_scenario

    steps = [
        {"action": "move", "outer_deg": o, "inner_deg": i, "dwell_s": 5.0, "rate_deg_s": 30}
        for i in range(0, 360, 45)
        for o in range(-180, 180, 45)
    ]
    case = parse_scenario(
        {
            "schema": 1,
            "name": "64 poses",
            "site": {"gravity_m_s2": 9.80123},
            "rig": {"table": "dual"},
            "sensor": [
                {
                    "name": "accel",
                    "kind": "accelerometer",
                    "rate_hz": 50.0,
                    "adjustable": ["bias", "scale", "cross_axis"],
                }
            ],
            "sequence": steps,
        }
    )
    start = time.process_time()
    found = confuse(case)
    return {"seconds": time.process_time() - start, "columns": len(found.sights), "peak_MiB": 0.0}


def main() -> None:
    """Three runs each, in processes of their own; medians."""
    for name, function, limit in (
        ("confuse, 64 poses on the dual table", "poses", 2.0),
        (f"information matrix of all effects, {ROWS} moving samples x 6", "moving", 4.0),
    ):
        code = (
            f"import json; from tests.benchmarks.information import {function};"
            f" print(json.dumps({function}()))"
        )
        runs = [
            json.loads(
                subprocess.run(
                    [sys.executable, "-c", code], capture_output=True, text=True, check=True
                ).stdout
            )
            for _ in range(sized(3, 1))
        ]
        seconds, peak = np.median([r["seconds"] for r in runs]), max(r["peak_MiB"] for r in runs)
        memory = f", peak RSS {peak:.0f} MiB (limit 600)" if peak else ""
        print(f"{name}: {runs[0]['columns']} parameters, {seconds:.2f} s (limit {limit:g}){memory}")
