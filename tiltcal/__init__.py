"""tiltcal: a calibration testbed for inclinometers, accelerometers and gyroscopes.

    import tiltcal as tc

    bench = tc.load_scenario("bench.toml")
    recording = tc.read("run.csv")
    calibration = bench.calibrate(recording, "six_position")

The names in ``__all__`` are the stable interface; each is loaded when it is first asked for. The
rooms below, each of which imports only from those after it: ``cli`` (the commands), ``guide``
(what to record next, live), ``api`` (what programs call), ``report``, ``diagnosis``, ``design``
and ``validation``, ``calibration`` and ``laboratory``, ``recordings``, ``forward``, ``effects``,
``setup``, ``statistics``, ``core``. The
simulator (package ``tiltsim``) imports tiltcal, never the other way round.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from tiltcal.api.certifying import Certificate
    from tiltcal.api.comparing import combine, compare
    from tiltcal.api.designing import DesignedSequence
    from tiltcal.api.diagnosing import Diagnosis
    from tiltcal.api.instruments import load_instrument
    from tiltcal.api.reading import read
    from tiltcal.api.scenario import Scenario, correct, load_scenario, parse_scenario
    from tiltcal.calibration.result import Calibration, Estimate, load_calibration
    from tiltcal.core.errors import TiltcalError
    from tiltcal.guide.guide import Guide
    from tiltcal.guide.state import GuideState
    from tiltcal.laboratory.instrument.instrument import Instrument
    from tiltcal.laboratory.instrument.wrap import wrap
    from tiltcal.recordings.recording import Recording
    from tiltcal.recordings.segmentation import Segment, find_segments
    from tiltcal.report.stated import Stated
    from tiltcal.validation.cross_check import Check

__version__ = "0.2.0"
__all__ = [
    "Calibration",
    "Certificate",
    "Check",
    "DesignedSequence",
    "Diagnosis",
    "Estimate",
    "Guide",
    "GuideState",
    "Instrument",
    "Recording",
    "Scenario",
    "Segment",
    "Stated",
    "TiltcalError",
    "combine",
    "compare",
    "correct",
    "find_segments",
    "load_calibration",
    "load_instrument",
    "load_scenario",
    "parse_scenario",
    "read",
    "wrap",
]
_MODULES = {
    "api.certifying": ("Certificate",),
    "api.comparing": ("combine", "compare"),
    "api.designing": ("DesignedSequence",),
    "api.diagnosing": ("Diagnosis",),
    "api.instruments": ("load_instrument",),
    "api.reading": ("read",),
    "api.scenario": ("Scenario", "correct", "load_scenario", "parse_scenario"),
    "calibration.result": ("Calibration", "Estimate", "load_calibration"),
    "core.errors": ("TiltcalError",),
    "guide.guide": ("Guide",),
    "guide.state": ("GuideState",),
    "laboratory.instrument.instrument": ("Instrument",),
    "laboratory.instrument.wrap": ("wrap",),
    "recordings.recording": ("Recording",),
    "recordings.segmentation": ("Segment", "find_segments"),
    "report.stated": ("Stated",),
    "validation.cross_check": ("Check",),
}
_PLACES = {name: module for module, names in _MODULES.items() for name in names}


def __getattr__(name: str) -> Any:
    if name not in _PLACES:
        raise AttributeError(f"module 'tiltcal' has no attribute '{name}'")
    found = getattr(import_module(f"tiltcal.{_PLACES[name]}"), name)
    globals()[name] = found
    return found


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
