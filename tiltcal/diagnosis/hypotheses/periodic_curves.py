"""Curves that repeat in time, at the frequencies of spectral lines: thermostats, pumps, hum."""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import product
from typing import Any

import numpy as np

from tiltcal.diagnosis.data.observations import Observations
from tiltcal.diagnosis.hypotheses.curve_forms import curve_over, harmonics
from tiltcal.diagnosis.hypotheses.hypothesis import Hypothesis
from tiltcal.effects.learned import (
    Learned,
    LearnedDelay,
    LearnedReading,
    LearnedReadout,
    LearnedTilt,
)
from tiltcal.effects.spans import SpectralLines
from tiltcal.laboratory.scenario import Scenario

Place = tuple[type[Learned], dict[str, Any]]
HARMONICS = (1, 4)


def periodic_curves(
    observations: Observations, lines: SpectralLines, sensors: Sequence[str]
) -> Iterator[Hypothesis]:
    """At every place, one for each spectral line in time.

    Args:
        observations: whose table and sensors; lines: that stand out of their residual.
        sensors: that are read.
    """
    scenario = observations.scenario
    # of a line in a coefficient, each as probable as another
    frequencies = max(len(r) for r in observations.recordings) / 2
    for cls, where in _places(scenario, sensors) if lines.tones else ():
        for frequency, count in product(lines.tones, HARMONICS):
            yield curve_over(cls, "time", harmonics(count), period=1 / frequency, **where)
    modulated: list[tuple[type[Learned], dict[str, Any], tuple[float, ...]]] = [
        *((LearnedDelay, where, lines.late) for where in stamped(scenario, sensors)),
        *((LearnedTilt, where, lines.base_tilts) for where in frames(scenario, "base")),
        *((LearnedReading, where, lines.scales) for where in gains(scenario, sensors)),
    ]
    for cls, where, own in modulated:
        for frequency, count in product(own, HARMONICS):
            curve = curve_over(cls, "time", harmonics(count), period=1 / frequency, **where)
            yield replace(curve, log_odds=-float(np.log(frequencies)))


def stamped(scenario: Scenario, sensors: Sequence[str]) -> list[dict[str, Any]]:
    """Whose stamps may be late against those of a table: each sensor's, and all; none by hand,
    where there is no other clock.
    """
    each: list[str | None] = [s for s in sensors if scenario.rig.axes]
    every: list[str | None] = [*each, None] if len(each) > 1 else each
    return [{"sensor": sensor, "place": "timing"} for sensor in every]


def _places(scenario: Scenario, sensors: Sequence[str]) -> Iterator[Place]:
    for sensor in scenario.sensor:
        for axis in sensor.axes if sensor.name in sensors else ():
            yield LearnedReading, {"sensor": sensor.name, "axis": axis}
    for axis in scenario.rig.kind.turning:
        yield LearnedReadout, {"axis": axis, "place": "table"}
    for where in frames(scenario, "base", "mount"):
        yield LearnedTilt, where


def gains(scenario: Scenario, sensors: Sequence[str]) -> list[dict[str, Any]]:
    """The scale factors of the sensors that are read."""
    return [
        {"sensor": s.name, "axis": axis, "per_input": True}
        for s in scenario.sensor
        for axis in (s.axes if s.name in sensors else ())
    ]


def frames(scenario: Scenario, *slots: str) -> list[dict[str, Any]]:
    """The tilts of frames, base or mount; none by hand."""
    known = {"base": ("xy", "environment"), "mount": ("xyz", "mount")}
    return [
        {"slot": slot, "turn": turn, "place": known[slot][1]}
        for slot in (slots if scenario.rig.axes else ())
        for turn in known[slot][0]
    ]
