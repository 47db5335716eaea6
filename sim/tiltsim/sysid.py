"""A scenario's effects and MuJoCo's system identification (``mujoco.sysid``): go on from one in
the other.

    exchange = Exchange.of("out/amended.toml", "arm.xml")
    problem = exchange.problem(read_recording("run.csv"))
    found, result = sysid.optimize(
        exchange.parameters, sysid.build_residual_fn(**problem), optimizer="scipy", x_scale="jac"
    )
    found.save_to_disk("found.yaml")

Needs the extra ``sysid``.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
from mujoco import sysid

from tiltcal.core.arrays import Array
from tiltcal.core.errors import TiltcalError
from tiltcal.effects.base import AngleEffect, Effect
from tiltcal.effects.streams import Streams
from tiltcal.forward.kinematics import true_angles, world_of
from tiltcal.forward.signal_chain import readings
from tiltcal.laboratory.model_parameters import ModelParameter, model_parameters, with_values
from tiltcal.laboratory.own_model import fixed_error
from tiltcal.laboratory.scenario import Scenario, load_scenario
from tiltcal.recordings.recording import Recording
from tiltcal.recordings.replay import Replay, replay
from tiltcal.setup.setup import Setup
from tiltcal.setup.trajectory import Drive, Jet, Motion
from tiltsim.fixed_model import Reference, build_in, prescribed_model
from tiltsim.model_reader import spec_of
from tiltsim.motion import read_states
from tiltsim.rig import Rig

if not hasattr(sysid, "optimize"):  # it imports without its libraries, and is empty then
    raise TiltcalError(
        "mujoco.sysid",
        found="its libraries are not installed",
        need="the extra 'sysid'",
        do='install it with pip install "tiltcal[sysid]"',
    )

KEPT = 64  # motions: one for each step of a finite difference


@dataclass
class Exchange:
    """The effects of a scenario as parameters of ``mujoco.sysid`` on the user's own model.

    Args:
        scenario: source of the effects.
        spec: the user's model, which the scenario's links were read from.
    """

    scenario: Scenario
    spec: "mujoco.MjSpec"
    _moved: dict[bytes, Array] = field(default_factory=dict, repr=False)

    @classmethod
    def of(cls, scenario: str | Path, model: str | Path) -> "Exchange":
        """From a scenario's file and a model's, MJCF or URDF.

        Raises:
            TiltcalError: a file cannot be read, or they do not belong together.
        """
        return cls(load_scenario(scenario), spec_of(Path(model)))

    def __post_init__(self) -> None:
        self.reference = Reference.of(self.spec, self.scenario)
        self.known, self.left_out = model_parameters(self.scenario)

    @property
    def parameters(self) -> "sysid.ParameterDict":
        """The numbers of the effects, at their values; SI."""
        return sysid.ParameterDict({p.name: _parameter(p) for p in self.known})

    def effects(self, params: "sysid.ParameterDict") -> tuple[Effect, ...]:
        """The effects at the values of parameters; those that have none are left out."""
        ours = {p.name for p in self.known}
        values = {name: float(p.value[0]) for name, p in params.items() if name in ours}
        kept = {p.effect for p in self.known}
        return tuple(e for k, e in enumerate(with_values(self.scenario, values)) if k in kept)

    def build_model(self, params: "sysid.ParameterDict", spec: "mujoco.MjSpec") -> "mujoco.MjModel":
        """The user's model with the effects built in, and with what other parameters modify:
        ``build_model`` of ``sysid.build_residual_fn``, for rollouts of the user's own.

        Springs are joints ``<axis>_bearing_bend_z`` or ``base_bend_x`` with their stiffness; give
        them damping. Errors of sensors are no part of a model.
        """
        changed, ours = spec.copy(), {p.name for p in self.known}
        others = {name: p for name, p in params.items() if name not in ours}
        sysid.apply_param_modifiers_spec(sysid.ParameterDict(others), changed)
        build_in(changed, self.reference, self.scenario, self.effects(params))
        return changed.compile()

    def problem(self, recording: Recording) -> dict[str, Any]:
        """Arguments of ``sysid.build_residual_fn`` for a recording whose readouts prescribe the
        motion.

        Raises:
            TiltcalError: a column is missing, or a sensor sits elsewhere than the instrument.
        """
        course = replay(recording, self.scenario)
        self._require_simple(recording, course)
        columns = {s.name: recording.sensor(s).values for s in self.scenario.sensor}
        spec = _read_as(self.spec, {name: c.shape[1] for name, c in columns.items()})
        model = spec.compile()
        mapping = sysid.TimeSeries.compute_all_sensor_mapping(model)
        measured = sysid.TimeSeries(recording.time, np.column_stack([*columns.values()]), mapping)
        control = sysid.TimeSeries(recording.time, np.zeros((len(recording), model.nu)))
        data = mujoco.MjData(model)
        state = sysid.create_initial_state(model, data.qpos, data.qvel, data.act)
        sequences = sysid.ModelSequences(
            self.scenario.name, spec, "recording", state, control, measured
        )
        self._moved.clear()

        def rollout(**given: Any) -> list["sysid.SystemTrajectory"]:
            return [
                self._predicted(model, params, course, control, state)
                for model, params in zip(given["models"], given["param_dicts"], strict=True)
            ]

        return {
            "models_sequences": [sequences],
            "custom_rollout": rollout,
            "resample_true": False,
            "n_threads": 1,
        }

    def _require_simple(self, recording: Recording, course: Replay) -> None:
        """One mounting, every sensor sampled on every row, at the instrument's site."""
        elsewhere = [s.name for s in self.scenario.sensor if s.place is not None]
        if elsewhere:
            raise TiltcalError(
                f"sensor {elsewhere[0]}",
                found="a site of its own",
                need="sensors at the site of the instrument",
                do="leave it out of the scenario",
            )
        sparse = [
            s.name for s in self.scenario.sensor if len(recording.sensor(s).time) < len(recording)
        ]
        if sparse or len(course.mounts) > 1:
            raise TiltcalError(
                f"{recording.source}",
                found=f"rows without sensor {sparse[0]}" if sparse else "several mountings",
                need="one mounting, and every sensor on every row",
                do="cut or resample the recording",
            )

    def _predicted(
        self,
        model: "mujoco.MjModel",
        params: "sysid.ParameterDict",
        course: Replay,
        control: "sysid.TimeSeries",
        state: Array,
    ) -> "sysid.SystemTrajectory":
        """What the sensors read, from the second row on: sysid drops the first measured one."""
        times = {s.name: course.time for s in self.scenario.sensor}
        found = readings(self.scenario, course, times, self.effects(params), mover=self._move)
        data = np.column_stack([found[s.name] for s in self.scenario.sensor])[1:]
        still = np.tile(state, (len(data), 1))
        still[:, 0] = course.time[1:]
        return sysid.SystemTrajectory(
            model,
            control,
            sysid.TimeSeries(course.time[1:], data),
            state,
            sysid.TimeSeries(course.time[1:], still),
        )

    def _move(
        self, setup: Setup, drive: Drive, effects: Sequence[Effect], streams: Streams
    ) -> Motion:
        """The motion of the instrument on the user's model; kept, because sensors' own errors do
        not change it.
        """
        key = repr([(e.address, sorted(e.values.items())) for e in effects]).encode()
        key += drive.time.tobytes()
        if key not in self._moved:
            self._moved[key] = self._moves(setup, drive, effects, streams)
            for old in list(self._moved)[:-KEPT]:
                del self._moved[old]
        return Motion(drive.time, *self._moved[key])

    def _moves(
        self, setup: Setup, drive: Drive, effects: Sequence[Effect], streams: Streams
    ) -> Array:
        spec = self.spec.copy()
        springs = build_in(spec, self.reference, setup, effects)
        varying = [e for e in effects if isinstance(e, AngleEffect) and not _is_fixed(e, setup)]
        angles = true_angles(setup, drive, varying, streams)
        world = world_of(setup, effects)
        model = prescribed_model(spec, self.reference.site, drive.mounts[0][1], world.lever)
        rig = Rig(model, {}, springs, displaced=True, inertial=True)
        q, v, a = self._states(rig, angles, len(drive.time))
        return np.array(read_states(rig, q, v, a, world, drive.time))

    def _states(self, rig: Rig, angles: dict[str, Jet], n: int) -> tuple[Array, Array, Array]:
        """qpos (n, nq), qvel (n, nv), qacc (n, nv): the joints that are read follow the readout,
        the others stand at the model's reference.
        """
        q = np.tile(rig.model.qpos0, (n, 1))
        v, a = np.zeros((n, rig.model.nv)), np.zeros((n, rig.model.nv))
        for link in self.scenario.rig.link:
            jet, dof = angles[link.axis], rig.dof(link.joint)
            q[:, rig.position(link.joint)] = link.sign * jet.x + link.zero
            v[:, dof], a[:, dof] = link.sign * jet.v, link.sign * jet.a
        return q, v, a


def _is_fixed(effect: AngleEffect, setup: Setup) -> bool:
    return all(fixed_error(effect, setup, a) is not None for a in setup.rig.axis_names)


def _parameter(of: ModelParameter) -> "sysid.Parameter":
    return sysid.Parameter(of.name, of.value, of.low, of.high, of.frozen)


def _read_as(spec: "mujoco.MjSpec", channels: dict[str, int]) -> "mujoco.MjSpec":
    """A model whose sensors are the scenario's, with so many channels each."""
    found = spec.copy()
    for sensor in list(found.sensors):
        found.delete(sensor)
    for name, count in channels.items():
        found.add_sensor(name=name, type=mujoco.mjtSensor.mjSENS_USER, dim=count)
    return found
