"""What a diagnosis says: findings, verdict and figures, as the file ``diagnosis.json`` has them
(docs/interfaces.md, "diagnosis.json").

One effect of the amended scenario that belongs to a finding.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Literal

from tiltcal.core.tabular import Tabular
from tiltcal.diagnosis.conclusions.noise_figures import NoiseReport
from tiltcal.diagnosis.conclusions.residual_plots import LawView, Spectrum, View
from tiltcal.diagnosis.conclusions.seen_range import SeenRange
from tiltcal.diagnosis.hypotheses.priors import UNLISTED


@dataclass(frozen=True)
class FindingPart:
    """One effect of the amended scenario that belongs to a finding.

    Args:
        effect: its id there; ``learned`` for a curve.
        description: in words.
        stage: of the chain; sensor: that it acts on; axis: of the table, or channel.
        axes: channels that hold its signal, the strongest first.
        parameters: name with unit -> (value, standard uncertainty; None where it was not fitted),
            as the amended scenario has them; empty for a curve.
        curve: keys of a learned curve, as the amended scenario has them.
        energy_share: product of its signal with that of the whole finding over the energy of the
            latter, both whitened and without what calibration and other findings may take. The
            shares of a finding add up to 1; parts that cancel have shares of opposite signs.
        recording: of several, the one that an event happened in or a line in time is in.
    """

    effect: str
    description: str
    stage: str
    sensor: str | None = None
    axis: str | None = None
    axes: tuple[str, ...] = ()
    parameters: Mapping[str, tuple[float, float | None]] = field(default_factory=dict)
    curve: Mapping[str, Any] = field(default_factory=dict)
    energy_share: float = 1.0
    recording: str | None = None

    def to_json(self) -> dict[str, Any]:
        """As the file has it."""
        found: dict[str, Any] = {
            "effect": self.effect,
            "description": self.description,
            "stage": self.stage,
            "sensor": self.sensor,
            "axis": self.axis,
            "axes": list(self.axes),
            **({} if self.recording is None else {"recording": self.recording}),
        }
        if self.curve:
            found |= self.curve
        else:
            found["parameters"] = {
                name: {"value": v, "sigma": s} for name, (v, s) in self.parameters.items()
            }
        return found | {"energy_share": self.energy_share}


NO_LISTED = "a cause outside the catalogue"
Verdict = Literal["match", "explained", "ambiguous", "unlisted", "cannot_tell"]


@dataclass(frozen=True)
class Where:
    """Where in the recording an effect shows.

    Args:
        coordinate: what it follows; harmonic: orders over the outer and inner angle; interval: s
            from the first stamp; seen: range of the coordinate over which a curve was learned.
        recording: of several, the one that an event happened in, or the two that it happened
            between; those that hold a line in time, where some do not.
    """

    coordinate: str
    harmonic: tuple[int, int] | None = None
    interval: tuple[float, float | None] | None = None
    seen: SeenRange | None = None
    recording: str | None = None

    def to_json(self) -> dict[str, Any]:
        """As the file has it."""
        return {
            "coordinate": self.coordinate,
            "harmonic": list(self.harmonic) if self.harmonic else None,
            "interval_s": None if self.interval is None else list(self.interval),
            "seen": None if self.seen is None else self.seen.to_json(),
            **({} if self.recording is None else {"recording": self.recording}),
        }


@dataclass(frozen=True)
class Finding:
    """One effect that the scenario does not know.

    Args:
        effect: catalogue id; None when no name fits.
        names: ids that the recording cannot tell from it, itself first.
        stage: of the chain.
        sensors, axes: where it shows, the strongest first.
        where: coordinate, harmonic, interval.
        parameters: name with unit -> (value, standard uncertainty), of the whole law.
        parts: effects of the amended scenario that it consists of.
        p_value: after correction for all that was tried.
        delta_bic: BIC with it minus without; heldout_gain: nats. None, as a p-value, where it was
            not tested: a fault of the data is no term of a model of the same readings.
        rivals: (id, cosine, separation).
        statement, next_measurement: in words.
        probability: that something is there; of each name, ``unlisted`` for none of the catalogue,
            given that something is.
        laws: for pictures.
    """

    effect: str | None
    names: tuple[str, ...]
    stage: str
    sensors: tuple[str, ...]
    axes: tuple[str, ...]
    where: Where
    parameters: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    parts: tuple[FindingPart, ...] = ()
    p_value: float | None = None
    delta_bic: float | None = None
    heldout_gain: float | None = None
    rivals: tuple[tuple[str, float, float], ...] = ()
    statement: str = ""
    next_measurement: str = ""
    probability: float | None = None
    name_probability: Mapping[str, float] = field(default_factory=dict)
    laws: tuple[LawView, ...] = ()

    def to_json(self) -> dict[str, Any]:
        """As the file has it."""
        return {
            "effect": self.effect,
            "class": list(self.names),
            "stage": self.stage,
            "sensors": list(self.sensors),
            "axes": list(self.axes),
            "where": self.where.to_json(),
            "parameters": {n: {"value": v, "sigma": s} for n, (v, s) in self.parameters.items()},
            "parts": [p.to_json() for p in self.parts],
            "p_value": self.p_value,
            "delta_bic": self.delta_bic,
            "heldout_gain": self.heldout_gain,
            "rivals": [{"effect": e, "cosine": c, "separation": s} for e, c, s in self.rivals],
            "statement": self.statement,
            "next_measurement": self.next_measurement,
            **({} if self.probability is None else self._probabilities()),
        }

    def _probabilities(self) -> dict[str, Any]:
        return {"probability": self.probability, "names": dict(self.name_probability)}


@dataclass(frozen=True)
class Fitness:
    """How well a model fits; None where nothing was tested.

    Args:
        chi2_per_dof: of the residual under the white noise of each channel, which is fixed before
            anything is explained.
        rms: by channel, SI.
        heldout_chi2_per_dof: the same of blocks that were not fitted to.
        log_likelihood: Whittle's, under the noise that the model itself leaves, nats.
    """

    chi2_per_dof: float | None = None
    rms: Mapping[str, float] = field(default_factory=dict)
    heldout_chi2_per_dof: float | None = None
    log_likelihood: float | None = None

    def to_json(self) -> dict[str, Any]:
        """As the file has it."""
        return {
            "chi2_per_dof": self.chi2_per_dof,
            "rms": dict(self.rms),
            "heldout_chi2_per_dof": self.heldout_chi2_per_dof,
            "log_likelihood": self.log_likelihood,
        }


@dataclass(frozen=True)
class Undetectable:
    """An effect that was not found.

    Args:
        effect: id; sensor, axis: of the table, that it acts on, if it does on any.
        size: that it would have been found at, by name with unit.
        absorbed: share of it that calibration takes up.
    """

    effect: str
    sensor: str | None
    axis: str | None
    size: Mapping[str, float]
    absorbed: float

    def to_json(self) -> dict[str, Any]:
        """As the file has it."""
        return {
            "effect": self.effect,
            **({} if self.sensor is None else {"sensor": self.sensor}),
            **({} if self.axis is None else {"axis": self.axis}),
            "detectable_size": dict(self.size),
            "absorbed": self.absorbed,
        }


@dataclass(frozen=True)
class Diagnosis(Tabular):
    """The answer.

    Args:
        verdict: the first that applies (docs/interfaces.md, "diagnosis.json").
        statement: in words.
        findings, notes, undetectable: see there.
        before, after: fit of the scenario as it is and of the amended one.
        noise: that the amended one leaves.
        amended: the amended scenario, as a table.
        views, spectra: of what is left, for pictures.
    """

    verdict: Verdict
    statement: str
    findings: tuple[Finding, ...] = ()
    notes: tuple[str, ...] = ()
    undetectable: tuple[Undetectable, ...] = ()
    before: Fitness = Fitness()
    after: Fitness = Fitness()
    noise: NoiseReport = field(default_factory=NoiseReport)
    amended: Mapping[str, Any] = field(default_factory=dict)
    views: tuple[View, ...] = ()
    spectra: tuple[Spectrum, ...] = ()

    def to_json(self) -> dict[str, Any]:
        """As the file has it."""
        return {
            "schema": 1,
            "verdict": self.verdict,
            "statement": self.statement,
            "findings": [f.to_json() for f in self.findings],
            "notes": list(self.notes),
            "undetectable": [u.to_json() for u in self.undetectable],
            "fit": {"before": self.before.to_json(), "after": self.after.to_json()},
            "noise": self.noise.to_json(),
        }

    def as_columns(self) -> Mapping[str, Sequence[Any]]:
        """Effect, its class, where it shows and how sure it is, one row a finding."""
        return {
            "effect": [f.effect for f in self.findings],
            "class": [", ".join(f.names) for f in self.findings],
            "stage": [f.stage for f in self.findings],
            "coordinate": [f.where.coordinate for f in self.findings],
            "parameters": [
                ", ".join(f"{n} = {v:.4g} +- {s:.2g}" for n, (v, s) in f.parameters.items())
                for f in self.findings
            ],
            "probability": [f.probability for f in self.findings],
            "p_value": [f.p_value for f in self.findings],
        }

    def headline(self) -> str:
        """Verdict and statement."""
        return f"{self.verdict}: {self.statement}"


def in_words(names: Sequence[str]) -> list[str]:
    """The names of a class as a sentence has them."""
    return [NO_LISTED if name == UNLISTED else name for name in names]


def verdict_of(findings: tuple[Finding, ...], tested: bool, doubts: bool = False) -> Verdict:
    """The first that applies, of faults of the data only where there is nothing else; tested:
    whether anything was left to test the model with; doubts: whether a cause that is not claimed is
    more probable than not.
    """
    if not tested:
        return "cannot_tell"
    if any(f.effect is None for f in [f for f in findings if f.stage != "data"] or findings):
        return "unlisted"
    if any(len(f.names) > 1 for f in findings):
        return "ambiguous"
    if findings:
        return "explained"
    return "cannot_tell" if doubts else "match"
