"""``tiltcal estimate``."""

from pathlib import Path
from typing import Annotated

import numpy as np
from cyclopts import Parameter

from tiltcal.api.instruments import load_instrument
from tiltcal.cli.calibrate import parse_options
from tiltcal.cli.options import DescribedBy, Json
from tiltcal.cli.output import paragraph, print_json, print_note
from tiltcal.core.units import DEG
from tiltcal.laboratory.scenario import load_scenario
from tiltcal.recordings.recording_files import read_recording
from tiltcal.recordings.saving import require_suffix, write_recording
from tiltcal.validation.online.estimators import make_estimator
from tiltcal.validation.online.judging import feed, samples_of


def estimate(
    recording_file: Annotated[Path, Parameter("REC", help="Recording to feed.")],
    /,
    *,
    scenario: DescribedBy,
    estimator: Annotated[
        str, Parameter(help="Name of an estimator, or package.module:factory of your own.")
    ],
    option: Annotated[
        tuple[str, ...], Parameter(help="KEY=VALUE for the estimator; may be repeated.")
    ] = (),
    calibration: Annotated[
        Path | None, Parameter(help="CAL.json that is handed to the estimator.")
    ] = None,
    output: Annotated[Path, Parameter(alias="-o", help="File of the recording with the answers.")],
    as_json: Json = False,
) -> int:
    """Feed a recorded file to an estimator, sample by sample.

    Adds the columns of its answers: tilt_x_deg and tilt_y_deg, or those that the
    estimator names. Built in: accelerometer, placing, complementary, kalman, and
    field_scale (scale errors of a gyro triad against a FOG, ppm).

      tiltcal estimate run.csv --scenario bench.toml --estimator kalman -o tilt.csv
    """
    require_suffix(output)
    setup = load_scenario(scenario)
    recording = read_recording(recording_file).require_increasing()
    found = None if calibration is None else load_instrument(calibration)
    made = make_estimator(estimator, setup, found, parse_options(option))
    names = tuple(getattr(made, "columns", ("tilt_x_deg", "tilt_y_deg")))
    answers, seconds = feed(made, samples_of(recording, setup), estimator, len(names))
    factor = 1 / DEG if names[0].startswith("tilt") else 1.0
    columns = {name: answers[:, i] * factor for i, name in enumerate(names)}
    write_recording(recording.with_columns(columns), output)
    last = {name: float(column[-1]) for name, column in columns.items()}
    answered = float(np.mean(~np.isnan(answers).any(axis=1)))
    if as_json:
        print_json({"output": str(output), "last": last, "answered": answered, "sample_s": seconds})
    else:
        text = ", ".join(f"{name} {value:.6g}" for name, value in last.items())
        print_note(f"{output}: {len(recording)} samples, answered {answered:.1%}")
        paragraph(f"last answer: {text}")
    return 0
