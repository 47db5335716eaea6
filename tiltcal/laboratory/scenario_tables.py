"""The tables of a scenario file other than its set-up and sequence."""

from typing import Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Field, model_validator

from tiltcal.setup.part import StrictTable


class EffectTable(BaseModel):
    """One ``[[effect]]``: an id, where it acts, and its parameters with their units.

    ``finding`` is the number of the finding of a diagnosis that it is part of, from 1. ``seen_in``,
    ``earlier`` and ``lasts`` say which recordings meet an event.
    """

    model_config = ConfigDict(extra="allow", frozen=True)

    id: str
    sensor: str | None = None
    axis: str | None = None
    role: Literal["calibration", "found", "concealed"] | None = None
    finding: Annotated[int, Field(ge=1)] | None = None
    fit: bool = False
    seen_in: str | None = None
    earlier: tuple[str, ...] = ()
    lasts: bool = True


class Dynamics(StrictTable):
    """A run by time steps instead of prescribed motion: the servo follows, the structure rings.

    Args:
        timestep_s: of the integration.
        stiffness_N_m_rad, damping_N_m_s_rad: of every axis servo (or of the hand), instead of the
            model's own.
        friction_N_m: dry friction of every table axis.
        hand_torque_N_m: rms about each body axis of a hand's irregular torque at full speed.
    """

    timestep_s: Annotated[float, Field(gt=0, le=0.002)] = 0.0005
    stiffness_N_m_rad: Annotated[float, Field(gt=0)] | None = None
    damping_N_m_s_rad: Annotated[float, Field(ge=0)] | None = None
    friction_N_m: Annotated[float, Field(ge=0)] = 0.0
    hand_torque_N_m: Annotated[float, Field(ge=0)] = 0.1


class Accept(StrictTable):
    """What a method has to reach, over all its runs. Bands are computed from statistics; the
    numbers here are choices, not tolerances.

    Args:
        parameters: every recovered parameter agrees with the injected truth: over all runs, in
            every run, and by itself.
        required: parameters that every run has to return, such as accel.bias_x, or accel.bias for
            all axes; if not given, the adjustable and the injected terms of the sensor.
        false_alarm: probability, at most, of rejecting a correct method; shared by all limits.
        tilt_arcsec: largest rms tilt error over all directions.
        tilt_over_bound: the same, as a multiple of what the covariance predicts.
        better_by: rms tilt error before calibration over after, at least.
        quantile: of the runs, for which the limits of the tilt error are judged in addition to
            their rms.
    """

    parameters: bool = True
    required: tuple[str, ...] | None = None
    false_alarm: Annotated[float, Field(gt=0, lt=1)] = 1e-3
    tilt_arcsec: Annotated[float, Field(gt=0)] | None = None
    tilt_over_bound: Annotated[float, Field(gt=0)] | None = None
    better_by: Annotated[float, Field(gt=0)] | None = None
    quantile: Annotated[float, Field(gt=0, lt=1)] = 0.95


class MethodTable(StrictTable):
    """One ``[[method]]``: which algorithm, how often, and what it has to reach."""

    name: str | None = None
    command: tuple[str, ...] | None = None
    options: dict[str, Any] = {}
    expect: Literal["good", "suspect", "cannot_tell"] = "good"
    runs: Annotated[int, Field(ge=1)] = 1
    accept: Accept = Accept()

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
    between true and found up.

    Args:
        rms_arcsec, worst_arcsec: over all judged samples.
        rest_arcsec, moving_arcsec: rms over the samples at standstill, in moves and swings.
        settled_arcsec, settling_s: longest time after a move until the error stays within the band.
        sample_us: mean time a sample.
        answered: least share of samples with an answer.
    """

    rms_arcsec: Annotated[float, Field(gt=0)] | None = None
    worst_arcsec: Annotated[float, Field(gt=0)] | None = None
    rest_arcsec: Annotated[float, Field(gt=0)] | None = None
    moving_arcsec: Annotated[float, Field(gt=0)] | None = None
    settled_arcsec: Annotated[float, Field(gt=0)] = 60.0
    settling_s: Annotated[float, Field(ge=0)] | None = None
    sample_us: Annotated[float, Field(gt=0)] | None = None
    answered: Annotated[float, Field(ge=0, le=1)] = 1.0


class EstimatorTable(StrictTable):
    """One ``[[estimator]]``: an algorithm that runs sample by sample.

    Args:
        name: of its factory: built in, or package.module:factory.
        command: or a program, fed on its standard input.
        calibrate: a method that is run first, on what was recorded before from_s; its result is
            handed to the factory.
        from_s: where feeding and judging begin, s.
    """

    name: str | None = None
    command: tuple[str, ...] | None = None
    options: dict[str, Any] = {}
    calibrate: str | None = None
    calibrate_options: dict[str, Any] = {}
    from_s: float = 0.0
    accept: AcceptOnline = AcceptOnline()

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
