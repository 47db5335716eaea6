"""``tiltcal demo``: built-in scenarios, then a recording of an ordinary instrument with one random
concealed effect.
"""

import json
import secrets
import sys
import time
from contextlib import redirect_stdout
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import tomli_w
from cyclopts import Parameter

from tiltcal.api.simulating import simulator
from tiltcal.cli.diagnose import diagnose
from tiltcal.cli.options import SEED, Json
from tiltcal.cli.output import paragraph, print_line, print_note, print_table, progress_line
from tiltcal.cli.verify import finish
from tiltcal.core.assets import folder
from tiltcal.core.files import make_folder, write_text
from tiltcal.effects.base import Effect
from tiltcal.effects.mount.mounting import MountCompliance, MountSlip
from tiltcal.effects.parameter import GRADES
from tiltcal.effects.sensor.accelerometer import (
    AccBias,
    AccCrossAxis,
    AccK2,
    AccK3,
    AccKio,
    AccKip,
    AccKpo,
    AccScale,
    AccScaleAsym,
)
from tiltcal.effects.sensor.environmental import AccHysteresis, AccTempBias, AccTempScale
from tiltcal.effects.sensor.noise import AccNoise
from tiltcal.effects.sensor.temporal import AccBiasStep, AccWarmup
from tiltcal.effects.table.geometry import AxisNonorthogonality, AxisWobble, TableLevelling
from tiltcal.effects.table.readout import Encoder2Rev, EncoderEccentricity, TableBacklash, TableSag
from tiltcal.effects.timing.delays import ChannelMuxSkew, DataLatency
from tiltcal.laboratory.scenario import load_scenario, parse_scenario
from tiltcal.recordings.saving import write_recording
from tiltcal.setup.tables import DUAL, angle_key
from tiltcal.validation.acceptance import Verification, run_scenario

GRADE = GRADES.index("mid_mems")
SIZES = (0.3, 1.0)  # of the plausible size
SHAPES = {
    "time": (60.0, 140.0),
    "tau": (25.0, 70.0),
}  # s: an event inside the recording, a visible time constant
CONCEALABLE: tuple[type[Effect], ...] = (
    TableLevelling,
    EncoderEccentricity,
    Encoder2Rev,
    AxisWobble,
    AxisNonorthogonality,
    TableSag,
    TableBacklash,
    MountCompliance,
    MountSlip,
    AccK2,
    AccK3,
    AccKip,
    AccKio,
    AccKpo,
    AccScaleAsym,
    AccTempBias,
    AccTempScale,
    AccWarmup,
    AccBiasStep,
    AccHysteresis,
    DataLatency,
    ChannelMuxSkew,
)
TILTS_DEG, TURNS_DEG = range(15, 375, 60), range(20, 380, 72)


def bench() -> dict[str, Any]:
    """The scenario without truth: a tumble of 30 poses on a dual-axis table, in a laboratory
    with a periodic temperature.
    """
    poses = [
        (tilt, turn)
        for k, tilt in enumerate(TILTS_DEG)
        for turn in (TURNS_DEG if k % 2 == 0 else reversed(TURNS_DEG))
    ]
    return {
        "schema": 1,
        "name": "concealed physics",
        "site": {"gravity_m_s2": 9.80123, "latitude_deg": 39.9},
        "rig": {"table": DUAL.name},
        "climate": {"swing_degC": 1.5, "period_s": 130.0},
        "sensor": [
            {
                "name": "accel",
                "kind": "accelerometer",
                "rate_hz": 25.0,
                "adjustable": ["bias", "scale", "cross_axis"],
            }
        ],
        "sequence": [
            {
                "action": "move",
                **dict(zip(map(angle_key, DUAL.axis_names), (float(a), float(b)), strict=True)),
                "rate_deg_s": 25.0,
                "dwell_s": 3.0,
            }
            for a, b in poses
        ],
    }


def ordinary(rng: np.random.Generator) -> list[dict[str, Any]]:
    """Noise and linear errors of an ordinary triad, which calibration adjusts."""
    bias = {f"bias_{a}_ug": float(rng.normal(0, 10000)) for a in "xyz"}
    scale = {f"scale_{a}_ppm": float(rng.normal(0, 3000)) for a in "xyz"}
    cross = {
        f"cross_{a}{b}_ppm": float(rng.normal(0, 2000)) for a in "xyz" for b in "xyz" if a != b
    }
    terms: tuple[tuple[type[Effect], dict[str, float]], ...] = (
        (AccNoise, {"white_ug_rthz": 20.0, "walk_ug_rts": 0.2}),
        (AccBias, bias),
        (AccScale, scale),
        (AccCrossAxis, cross),
    )
    return [{"id": cls.id, "sensor": "accel", **values} for cls, values in terms]


def concealed(rng: np.random.Generator) -> dict[str, Any]:
    """A random effect of the catalogue on one axis, at a plausible size."""
    cls = CONCEALABLE[rng.choice(len(CONCEALABLE))]
    table: dict[str, Any] = {"id": cls.id, "role": "concealed"}
    if cls.kinds:
        table["sensor"] = "accel"
    if cls.axis_wise:
        table["axis"] = DUAL.axis_names[0]
    axis = str(rng.choice(list("xyz")))
    for p in cls.parameters:
        if p.name in SHAPES:
            table[f"{p.name}{p.suffix}"] = float(rng.uniform(*SHAPES[p.name]))
        elif not p.is_shape:
            size = p.plausible[GRADE] * rng.uniform(*SIZES)
            name = p.name.format(axis=axis)
            table[f"{name}{p.suffix}"] = float(
                size if p.positive else size * rng.choice([-1.0, 1.0])
            )
    return table


SHOWN = (
    "six_faces_dual",
    "six_faces_hidden_K2",
    "norm_by_hand",
    "norm_six_random_positions",
    "two_position_level",
    "tumble_three_axis",
)


def demo(
    *,
    seed: Annotated[
        int | None, SEED, Parameter(help="Seed of the concealed effect; random if not given.")
    ] = None,
    output: Annotated[Path, Parameter(alias="-o", help="Folder for the reports.")] = Path(
        "demo-output"
    ),
    as_json: Json = False,
) -> int:
    """Run a tour of the main functions.

    Simulates, calibrates and verifies built-in scenarios. Then conceals an effect
    in a simulated recording and diagnoses it. The effect is random; the seed is
    printed, and --seed repeats it.
    """
    out = make_folder(output)
    used = secrets.randbelow(10**6) if seed is None else seed
    verification = tour()
    found = find(out, used)
    status = finish(verification, out, as_json)
    if not as_json:
        show(found, out, used)
    return status


def tour() -> Verification:
    """Run built-in scenarios and judge them against the injected errors."""
    start = time.perf_counter()
    print_note("Simulating tables in MuJoCo, calibrating, judging against the injected errors.\n")
    with progress_line() as progress:
        laboratory = simulator(progress)
        results = []
        for name in SHOWN:
            scenario = load_scenario(folder("scenarios") / f"{name}.toml")
            results.append(
                run_scenario(scenario, laboratory, source=f"{name}.toml", progress=progress)
            )
    return Verification(tuple(results), time.perf_counter() - start)


def find(out: Path, seed: int) -> tuple[dict[str, Any], dict[str, Any]]:
    """Conceal an effect and diagnose without the truth; return the concealed table and
    diagnosis.json.

    The scenario with the truth is written after the diagnosis.
    """
    print_note(
        f"Concealing an effect in a simulated recording (seed {seed}), then diagnosing it.\n"
    )
    rng = np.random.default_rng(seed)
    hidden = concealed(rng)
    truth = {**bench(), "role": "concealed", "effect": [*ordinary(rng), hidden]}
    with progress_line() as progress:
        recording = simulator(progress).record(parse_scenario(truth, "concealed.toml"), seed)
    folder = make_folder(out / "diagnosis")
    write_recording(recording, folder / "recording.csv")
    write_text(
        folder / "scenario.toml",
        tomli_w.dumps({k: v for k, v in bench().items() if k not in ("sequence", "climate")}),
    )
    with redirect_stdout(sys.stderr):  # stdout is for the tables
        diagnose((folder / "recording.csv",), scenario=folder / "scenario.toml", output=folder)
    write_text(out / "concealed.toml", tomli_w.dumps(truth))
    return hidden, json.loads((folder / "diagnosis.json").read_text(encoding="utf-8"))


def show(found: tuple[dict[str, Any], dict[str, Any]], out: Path, seed: int) -> None:
    """Print what was concealed and what was found."""
    hidden, answer = found
    sizes = {k: v for k, v in hidden.items() if isinstance(v, float)}
    rows = [["concealed", hidden["id"], _sizes(sizes)]]
    for f in answer["findings"]:
        estimates = ", ".join(
            f"{n} = {p['value']:.4g} +- {p['sigma']:.2g}" for n, p in f["parameters"].items()
        )
        rows.append(
            ["found", " or ".join(f["class"] or ["a curve of no listed effect"]), estimates]
        )
    print_table(
        ["", "effect", "size"],
        rows,
        title=f"An effect concealed at random (--seed {seed} repeats it)",
    )
    before, after = answer["fit"]["before"], answer["fit"]["after"]
    names = {
        "chi2_per_dof": "chi-square per degree of freedom",
        "heldout_chi2_per_dof": "chi-square per degree of freedom, held-out blocks",
    }
    print_table(
        ["fit", "before", "after"],
        [[text, _figure(before[k]), _figure(after[k])] for k, text in names.items()],
    )
    paragraph(f"{answer['verdict']}: {answer['statement']}")
    print_line(f"report of the diagnosis: {out / 'diagnosis' / 'report.html'}")


def _figure(value: float | None) -> str:
    return "not tested" if value is None else f"{value:.4g}"


def _sizes(sizes: dict[str, float]) -> str:
    return ", ".join(f"{name} = {value:.4g}" for name, value in sizes.items())
