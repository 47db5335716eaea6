"""The tables of a scenario file other than its set-up and sequence."""

from typing import Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Field, model_validator

from tiltcal.setup.part import StrictTable


class EffectTable(BaseModel):
    """One ``[[effect]]``: an id, where it acts, and its parameters with their units.

    The parameters are those of ``tiltcal effects``; ``sigma_<parameter>`` is the standard
    uncertainty of one.
    """

    model_config = ConfigDict(extra="allow", frozen=True, use_attribute_docstrings=True)

    id: str
    """Id of an effect of the catalogue."""
    sensor: str | None = None
    """Sensor that it acts on, where there is a choice."""
    axis: str | None = None
    """Table axis that it acts on, where there is a choice."""
    role: Literal["calibration", "found", "concealed"] | None = None
    """Why it is there: a term of a calibration, a finding of a diagnosis, a concealed truth."""
    finding: Annotated[int, Field(ge=1)] | None = None
    """Number of the finding of a diagnosis that it is part of, from 1."""
    fit: bool = False
    """Re-fit its parameters instead of taking them as known."""
    seen_in: str | None = None
    """Digest of the recording in which an event happened."""
    earlier: tuple[str, ...] = ()
    """Digests of the recordings before the event."""
    lasts: bool = True
    """The event's state stays in later recordings."""


class Dynamics(StrictTable):
    """A run by time steps instead of prescribed motion: the servo follows, the structure rings."""

    timestep_s: Annotated[float, Field(gt=0, le=0.002)] = 0.0005
    """Step of the integration, s."""
    stiffness_N_m_rad: Annotated[float, Field(gt=0)] | None = None
    """Stiffness of every axis servo, or of the hand, N m/rad; not given: the model's."""
    damping_N_m_s_rad: Annotated[float, Field(ge=0)] | None = None
    """Damping of the same, N m s/rad; not given: the model's."""
    friction_N_m: Annotated[float, Field(ge=0)] = 0.0
    """Dry friction of every table axis, N m."""
    hand_torque_N_m: Annotated[float, Field(ge=0)] = 0.1
    """Irregular torque of a hand at full speed, rms about each body axis, N m."""


class Accept(StrictTable):
    """What a method has to reach, over all its runs. Bands are computed from statistics; the
    numbers here are choices, not tolerances.
    """

    parameters: bool = True
    """Every parameter agrees with the injected truth: over all runs, in each, and by itself."""
    required: tuple[str, ...] | None = None
    """Parameters that every run returns, such as `accel.bias_x`, or `accel.bias` for all axes;
    not given: the adjustable and the injected terms.
    """
    false_alarm: Annotated[float, Field(gt=0, lt=1)] = 1e-3
    """Largest probability of rejecting a correct method, shared by all limits."""
    tilt_arcsec: Annotated[float, Field(gt=0)] | None = None
    """Largest rms tilt error over all directions, arcsec."""
    tilt_over_bound: Annotated[float, Field(gt=0)] | None = None
    """Largest rms tilt error over what the covariance predicts."""
    better_by: Annotated[float, Field(gt=0)] | None = None
    """Least rms tilt error before calibration over that after it."""
    quantile: Annotated[float, Field(gt=0, lt=1)] = 0.95
    """Share of the runs for which the limits of the tilt error hold, besides their rms."""


class MethodTable(StrictTable):
    """One ``[[method]]``: which algorithm, how often, and what it has to reach."""

    name: str | None = None
    """Method of `tiltcal methods`, or package.module:function."""
    command: tuple[str, ...] | None = None
    """Or a program and its arguments; needs `--allow-commands`."""
    options: dict[str, Any] = {}
    """Options of the method."""
    expect: Literal["good", "suspect", "cannot_tell"] = "good"
    """Verdict that it has to give."""
    runs: Annotated[int, Field(ge=1)] = 1
    """Recordings with different seeds."""
    accept: Accept = Accept()
    """What it has to reach."""

    @model_validator(mode="after")
    def _one(self) -> "MethodTable":
        if (self.name is None) == (self.command is None):
            raise ValueError("give either name or command")
        return self

    @property
    def title(self) -> str:
        """Its name, or the command's."""
        return self.name or " ".join(self.command or ())


class AcceptOnline(StrictTable):
    """What an estimator that is fed sample by sample has to reach; its tilt error is the angle
    between true and estimated up.
    """

    rms_arcsec: Annotated[float, Field(gt=0)] | None = None
    """Largest rms tilt error over all judged samples, arcsec."""
    worst_arcsec: Annotated[float, Field(gt=0)] | None = None
    """Largest tilt error of any judged sample, arcsec."""
    rest_arcsec: Annotated[float, Field(gt=0)] | None = None
    """Largest rms tilt error at standstill, arcsec."""
    moving_arcsec: Annotated[float, Field(gt=0)] | None = None
    """Largest rms tilt error in moves and swings, arcsec."""
    settled_arcsec: Annotated[float, Field(gt=0)] = 60.0
    """Band in which the error counts as settled, arcsec."""
    settling_s: Annotated[float, Field(ge=0)] | None = None
    """Longest time after a move until the error stays within that band, s."""
    sample_us: Annotated[float, Field(gt=0)] | None = None
    """Largest mean time for a sample, us."""
    answered: Annotated[float, Field(ge=0, le=1)] = 1.0
    """Least share of samples with an answer."""


class EstimatorTable(StrictTable):
    """One ``[[estimator]]``: an algorithm that runs sample by sample."""

    name: str | None = None
    """Its factory: a built-in name, or package.module:factory."""
    command: tuple[str, ...] | None = None
    """Or a program that is fed on its standard input; needs `--allow-commands`."""
    options: dict[str, Any] = {}
    """Options of the estimator."""
    calibrate: str | None = None
    """Method that runs first, on what was recorded before `from_s`; the factory gets its result."""
    calibrate_options: dict[str, Any] = {}
    """Options of that method."""
    from_s: float = 0.0
    """Where feeding and judging begin, s."""
    accept: AcceptOnline = AcceptOnline()
    """What it has to reach."""

    @model_validator(mode="after")
    def _one(self) -> "EstimatorTable":
        if (self.name is None) == (self.command is None):
            raise ValueError("give either name or command")
        if self.calibrate is not None and self.command is not None:
            raise ValueError(
                "a command gets no calibration: export it, or pass it as one of its arguments"
            )
        return self

    @property
    def title(self) -> str:
        """Its name, or the command's."""
        return self.name or " ".join(self.command or ())
