"""Noise of a recording: drawn for the file, and as a covariance for the oracle."""

import numpy as np

from blind.laboratory import Lab

# s: a sum of exponentials passes for 1/f over the length of a recording
FLICKER_TAUS = 4.0 ** np.arange(6)
TAIL = 2.0  # of the heavier part: 8 sigma stay as rare as they ought to be


def draw(rng: np.random.Generator, lab: Lab, t: np.ndarray) -> np.ndarray:
    """White (with heavier tails), random walk and flicker of every channel, SI. t: (n,), returns
    (n, channels).
    """
    parts = [_one(rng, lab, t) for _ in lab.channels]
    white, walk, flicker = (np.stack(part, 1) for part in zip(*parts, strict=True))
    own = lab.noise.nuisance
    if own and own.white:
        white = own.white(rng, lab, t, white)
    return np.array([lab.sensors[s].sigma for s, _ in lab.channels]) * (white + walk + flicker)


def _one(
    rng: np.random.Generator, lab: Lab, t: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """White noise, random walk and flicker of one channel, in units of a sample's sigma."""
    n, own = len(t), lab.noise
    white = rng.standard_normal(n) * np.where(rng.random(n) < own.heavy_share, TAIL, 1.0)
    steps = np.diff(t, prepend=t[0])
    walk = own.walk * np.cumsum(rng.standard_normal(n) * np.sqrt(steps))
    taus = FLICKER_TAUS if own.flicker else ()
    flicker = sum((_lagged(rng, steps, tau) for tau in taus), np.zeros(n))
    return white, walk, own.flicker * flicker


def _lagged(rng: np.random.Generator, steps: np.ndarray, tau: float) -> np.ndarray:
    """Exponentially correlated, unit variance."""
    keep = np.exp(-steps / tau)
    push = rng.standard_normal(len(steps)) * np.sqrt(1 - keep**2)
    push[0] = rng.standard_normal()
    out = np.empty(len(steps))
    state = 0.0
    for k, (a, b) in enumerate(zip(keep.tolist(), push.tolist(), strict=True)):
        state = out[k] = a * state + b
    return out


def whitener(lab: Lab, t: np.ndarray, every: int) -> np.ndarray:
    """W with W C W' = I for means of ``every`` samples at t, in units of a sample's sigma. t:
    (n,).
    """
    own = lab.noise
    white = (1 + own.heavy_share * (TAIL**2 - 1)) / every
    C = white * np.eye(len(t)) + own.walk**2 * np.minimum.outer(t, t)
    if own.flicker:
        apart = np.abs(t[:, None] - t)
        C += own.flicker**2 * sum(np.exp(-apart / tau) for tau in FLICKER_TAUS)
    return np.linalg.inv(np.linalg.cholesky(C))
