"""What remembers: play, leaky integrals, lags. All on a uniform grid of time."""

import numpy as np


def play(x: np.ndarray, half_width: float) -> np.ndarray:
    """State of a play operator in [-1, 1]: where x stands in its gap. x: (n,), the gap begins
    centred.
    """
    middle, out = float(x[0]), np.empty(len(x))
    for k, value in enumerate(x.tolist()):
        middle = min(max(middle, value - half_width), value + half_width)
        out[k] = value - middle
    return out / half_width


def leaky(x: np.ndarray, tau_s: float, step_s: float) -> np.ndarray:
    """First-order lag of x with unit gain, settled at the start. x: (n,)."""
    keep, state, out = np.exp(-step_s / tau_s), float(x[0]), np.empty(len(x))
    for k, value in enumerate(x.tolist()):
        state = keep * state + (1 - keep) * value
        out[k] = state
    return out


def smooth_walk(rng: np.random.Generator, n: int, width: int) -> np.ndarray:
    """A wandering curve of unit rms, smooth over ``width`` steps. Returns (n,)."""
    kernel = np.hanning(width + 2)
    wander = np.cumsum(np.convolve(rng.standard_normal(n + 2 * width), kernel, "same"))[
        width:-width
    ]
    wander -= np.linspace(wander[0], wander[-1], n)
    return wander / max(wander.std(), 1e-12)
