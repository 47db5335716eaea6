"""Names of methods: built in, an entry point of ``tiltcal.methods``, ``package.module:function``,
or a command.
"""

import importlib
import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import replace
from importlib.metadata import entry_points
from pathlib import Path
from typing import Any

import numpy as np

from tiltcal.calibration.methods.fog_scale import fog_scale
from tiltcal.calibration.methods.gyro_rates import gyro_rates
from tiltcal.calibration.methods.gyro_turns import gyro_turns
from tiltcal.calibration.methods.norm import norm
from tiltcal.calibration.methods.north_seeking import north
from tiltcal.calibration.methods.options import check_options
from tiltcal.calibration.methods.placing_table import placing_table
from tiltcal.calibration.methods.six_position import six_position
from tiltcal.calibration.methods.thermal import thermal
from tiltcal.calibration.methods.two_position import two_position
from tiltcal.calibration.parameter_units import in_our_units
from tiltcal.calibration.result import Calibration, load_calibration, require_finite
from tiltcal.calibration.screen.data import findings_of, without_causes
from tiltcal.calibration.screen.limiter import limiter_tests
from tiltcal.calibration.validity import threshold_test
from tiltcal.core.errors import TiltcalError, nearest
from tiltcal.core.numerical import determining
from tiltcal.core.units import split_unit
from tiltcal.data_quality.registry import BY_NAME
from tiltcal.effects.parameter import by_name
from tiltcal.recordings.means_table import MeansTable
from tiltcal.recordings.recording import Recording
from tiltcal.recordings.saving import write_recording
from tiltcal.setup.setup import Setup

Method = Callable[..., Calibration]
METHODS: dict[str, Method] = {
    "placing_table": placing_table,
    "six_position": six_position,
    "norm": norm,
    "two_position": two_position,
    "gyro_turns": gyro_turns,
    "fog_scale": fog_scale,
    "north": north,
    "gyro_rates": gyro_rates,
    "thermal": thermal,
}
GROUP = "tiltcal.methods"
BY_MEANS = ("six_position", "norm", "placing_table")  # methods that use means of dwells only


def find_method(name: str | Method) -> Method:
    """The method of that name; a function is its own.

    Raises:
        TiltcalError: it is not known, or does not import.
    """
    if not isinstance(name, str):
        return _checked(name, "given as a function")
    if name in METHODS:
        return METHODS[name]
    if ":" in name:
        return import_named(name)
    installed = {e.name: e for e in entry_points(group=GROUP)}
    if name in installed:
        return _checked(installed[name].load(), name)
    raise TiltcalError(
        f"method '{name}'",
        found="no such method",
        need="a built-in, an entry point, or package.module:function",
        do=nearest(name, [*METHODS, *installed]),
    )


_NOT_THERE = (ImportError, AttributeError, ValueError, TypeError)


def import_named(name: str) -> Callable[..., Any]:
    """The function a user names as ``package.module:function``.

    Raises:
        TiltcalError: it does not import, or cannot be called.
    """
    module, _, attribute = name.partition(":")
    here = str(Path.cwd())
    if here not in sys.path:
        sys.path.append(here)  # last: a file there cannot take the place of an installed package
    try:
        target: Any = importlib.import_module(module)
        for part in attribute.split("."):
            target = getattr(target, part)
    except Exception as error:
        if os.environ.get("TILTCAL_TRACEBACK") and not isinstance(error, _NOT_THERE):
            raise
        raise TiltcalError(
            f"method '{name}'",
            found=str(error) or type(error).__name__,
            need="an importable package.module:function",
            do="check the name and the folder",
        ) from error
    return _checked(target, name)


def _checked(target: Any, name: str) -> Callable[..., Any]:
    if not callable(target):
        raise TiltcalError(
            f"method '{name}'",
            found=type(target).__name__,
            need="a function",
            do="name the function itself",
        )
    return target


def calibrate(
    wanted: str | Method, recording: Recording, setup: Setup, **options: Any
) -> Calibration:
    """Run a method on a recording. It is handed the recording and the set-up, never a truth.

    Args:
        wanted: the name of a method, or a function.
        recording: to calibrate from.
        setup: site, rig, sensors and their uncertainties; of a scenario only these are handed on.
        options: of the method.

    Raises:
        TiltcalError: an option is unknown, the method returns no Calibration, or an estimate in a
            unit of another dimension.
    """
    method = find_method(wanted)
    name = wanted if isinstance(wanted, str) else getattr(wanted, "__name__", repr(wanted))
    ours = METHODS.get(name) is method
    check_options(method, f"method {name}", options, handed=2)  # the recording and the set-up
    _require_log(name, recording)
    bare = setup.bare
    with _explained(recording, bare), determining(recording.source, f"the parameters of {name}"):
        result = (
            method(recording, bare, **options)
            if ours
            else _foreign(method, name, recording, bare, options)
        )
        if not isinstance(result, Calibration):
            raise TiltcalError(
                f"method {name}",
                found=f"a {type(result).__name__}",
                need="a tiltcal.calibration.result.Calibration",
                do="return one",
            )
        require_finite(result, recording.source)
    if ours:
        result = judge_determination(judge_limits(result, recording, bare), bare)
        result = replace(result, tests=without_causes(result.tests))
    found = _stated(result if ours else in_our_units(result, bare), bare, recording)
    stated = {k: v for k, v in options.items() if k != "segments" and v is not None}
    return replace(
        found, provenance={**found.provenance, "options": stated} if stated else found.provenance
    )


def judge_limits(result: Calibration, recording: Recording, setup: Setup) -> Calibration:
    """The calibration, ``suspect`` where a channel of its sensors keeps to a limit while the table
    turns.
    """
    used = [s for s in setup.sensor if recording.has(s) and _is_used(s.name, result)]
    tests = [t for s in used for t in limiter_tests(recording, setup, s)]
    failed = any(not t.passed for t in tests)
    verdict = "suspect" if failed and result.verdict == "good" else result.verdict
    return replace(result, verdict=verdict, tests=[*result.tests, *tests])


def _is_used(sensor: str, result: Calibration) -> bool:
    """Whether a calibration has terms or tables of a sensor."""
    return any(n.startswith(f"{sensor}.") for n in [*result.parameters, *result.bias_tables])


def judge_determination(result: Calibration, setup: Setup) -> Calibration:
    """The calibration, with the verdict ``cannot_tell`` where a parameter is no better known than
    without the recording: its sigma exceeds the largest size of an instrument of its kind.
    """
    model = result.instrument(setup.sensor, setup.site.gravity)
    # a misfit widens all sigmas: it is no lack of information
    widened = max(result.chi2_per_dof, 1.0)
    sigmas = np.sqrt(np.maximum(np.diag(model.covariance), 0.0) / widened)
    wide = []
    for parameter, sigma in zip(model.parameters, sigmas, strict=True):
        stated = by_name(model.effects[parameter.effect].parameters)[parameter.key]
        largest = stated.plausible[-1] * stated.factor
        if 0 < largest < sigma:
            wide.append(parameter.name)
    if not wide:
        return result
    text = f"the recording does not determine {', '.join(wide)}: turn or tilt those axes"
    test = threshold_test("determined", len(wide), False, text)
    return replace(result, verdict="cannot_tell", tests=[*result.tests, test])


def _require_log(name: str, recording: Recording) -> None:
    """Refuse a table of means for a method that looks inside the dwells."""
    if isinstance(recording, MeansTable) and name in METHODS and name not in BY_MEANS:
        raise TiltcalError(
            f"method {name}",
            found="a table of means",
            need="a log of readings",
            do=f"give the log; means are enough for {', '.join(BY_MEANS)}",
        )


@contextmanager
def _explained(recording: Recording, setup: Setup) -> Iterator[None]:
    """A refusal of the recording says what is wrong with its channels: that may be its cause."""
    try:
        yield
    except TiltcalError as error:
        if error.subject != recording.source:
            raise
        faults: list[str] = []
        with suppress(TiltcalError):
            found = findings_of(recording, setup.sensor)
            faults = [f.statement for f in found if BY_NAME[f.kind].answer != "note"]
        faults = [words for words in faults if words not in error.found]
        if not faults:
            raise
        every = "; ".join([error.found, *faults])
        raise TiltcalError(error.subject, found=every, need=error.need, do=error.do) from error


def _foreign(
    method: Method, name: str, recording: Recording, setup: Setup, options: dict[str, Any]
) -> Calibration:
    """Call a method that is not ours: whatever goes wrong in it is said to be its own."""
    try:
        return method(recording, setup, **options)
    except (TiltcalError, MemoryError):
        raise
    except Exception as error:
        if os.environ.get("TILTCAL_TRACEBACK"):
            raise
        raise TiltcalError(
            f"method {name}",
            found=f"an error in it ({type(error).__name__}: {error})",
            need="a function that returns",
            do="mend it; TILTCAL_TRACEBACK=1 shows where",
        ) from error


def _with_setup(result: Calibration, setup: Setup) -> Calibration:
    """The calibration with the set-up in its provenance, so that CAL.json alone can correct a
    recording.
    """
    stated = json.loads(setup.model_dump_json(exclude_none=True))
    return replace(result, provenance={**result.provenance, "setup": stated})


def _stated(result: Calibration, setup: Setup, recording: Recording) -> Calibration:
    """The calibration with the set-up and the units of the user's columns in its provenance."""
    there = [s for s in setup.sensor if recording.has(s)]
    first = {s.name: str(recording.channel(f"{s.name}_{s.axes[0]}")) for s in there}
    columns = {name: split_unit(column)[1] for name, column in first.items()}
    stated: dict[str, Any] = {"columns": columns}
    if recording.temperature() is not None:
        values = recording.column(str(recording.channel("temperature")))
        stated["temperature_degC"] = float(np.nanmean(values))
    result = replace(result, provenance={**result.provenance, **stated})
    return _with_setup(result, setup)


def run_command(command: Sequence[str], recording: Recording, setup: Setup) -> Calibration:
    """A program as the method: it gets files and writes CAL.json; no shell.

    Args:
        recording, setup: what the method is given.
        command: words with {recording}, {scenario}, {cal} where the paths go.

    Raises:
        TiltcalError: it fails, or writes no calibration.
    """
    import tomli_w

    with tempfile.TemporaryDirectory(prefix="tiltcal-") as folder:
        paths = {key: str(Path(folder) / name) for key, name in _FILES.items()}
        write_recording(recording, paths["recording"])
        bare = setup.bare
        stated = json.loads(bare.model_dump_json(exclude_none=True))
        Path(paths["scenario"]).write_text(
            tomli_w.dumps({"schema": 1, "name": "under test", **stated}), encoding="utf-8"
        )
        words = [_filled(word, paths) for word in command]
        try:
            done = subprocess.run(words, capture_output=True, text=True, check=False)
        except OSError as error:
            raise TiltcalError(
                f"command {words[0]}",
                found=str(error),
                need="a program that runs",
                do="check the path",
            ) from error
        if done.returncode != 0:
            last = (done.stderr or done.stdout).strip().splitlines()[-1:] or ["no message"]
            raise TiltcalError(
                f"command {words[0]}",
                found=f"exit status {done.returncode} ({last[0]})",
                need="0",
                do="run it yourself",
            )
        return _stated(in_our_units(load_calibration(paths["cal"]), bare), bare, recording)


_FILES = {"recording": "recording.csv", "scenario": "scenario.toml", "cal": "CAL.json"}


def _filled(word: str, paths: dict[str, str]) -> str:
    for key, path in paths.items():
        word = word.replace("{" + key + "}", path)
    return word
