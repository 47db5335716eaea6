"""The motion of an environment that was driven at random, as a course that a laboratory records."""

from dataclasses import dataclass

import numpy as np

from tiltcal.setup.trajectory import Drive, Jet


@dataclass
class Course:
    """The motion of an environment whose states were kept: accelerations are linear in a step."""

    names: tuple[str, ...]
    step: float
    states: np.ndarray  # (steps, 3, axes)
    rows_apart: bool = True  # loads as for an environment, which knows no later row

    @property
    def times(self):
        return 0.0, (len(self.states) - 1) * self.step

    def drive(self, time):
        k = np.clip(np.floor(time / self.step + 1e-9).astype(int), 0, len(self.states) - 1)
        t = np.where(time < 0, 0.0, time - k * self.step)[:, None]
        x, v, a = self.states[k].transpose(1, 0, 2)
        jerk = (self.states[np.minimum(k + 1, len(self.states) - 1), 2] - a) / self.step
        parts = x + t * (v + t * (a / 2 + t * jerk / 6)), v + t * (a + t * jerk / 2), a + t * jerk
        axes = {n: Jet(*(p[:, i] for p in parts)) for i, n in enumerate(self.names)}
        n = len(time)
        climate = np.full(n, 20.0)
        mounts = ((0, np.eye(3)),)
        return Drive(
            time,
            axes,
            0.0,
            climate,
            20.0,
            np.full(n, -1),
            mounts,
            known=np.ones(n, bool),
            rows_apart=self.rows_apart,
        )


def driven(environment, rng, steps, seed):
    """The states and readings of an environment under random demands."""
    motion = environment.unwrapped.rigs.motion
    _, info = environment.reset(seed=seed)
    states = [np.concatenate([motion.position, motion.rate, motion.acceleration])]
    found = [info["readings"]]
    for step in range(steps):
        if step % 20 == 0:
            action = rng.uniform(-1, 1, environment.action_space.shape)
        _, _, _, _, info = environment.step(action.astype(np.float32))
        states.append(np.concatenate([motion.position, motion.rate, motion.acceleration]))
        found.append(info["readings"])
    return np.array(states), {n: np.array([f[n] for f in found]) for n in found[0]}
