"""Products along a drive: of the harmonics of two angles, and what a curve is multiplied by."""

import numpy as np

from tiltcal.effects.curve_coordinates import motion_jet
from tiltcal.setup.trajectory import Drive, Jet

ORDERS = 3  # of each angle in a product of two


def multiplier(name: str, drive: Drive) -> Jet:
    """What a curve is multiplied by along a drive with its time derivatives, (n, 1): the
    temperature from T0 in K, what its rate changes by left out, an angle, its rate, which way it
    last went, or time.
    """
    if name != "temperature":
        parts = motion_jet(name, drive)
        x, v, a = (
            np.broadcast_to(part, drive.time.shape)[:, None] for part in (parts.x, parts.v, parts.a)
        )
        return Jet(x, v, a)
    warm = drive.temperature - drive.reference_temperature
    rate = np.gradient(warm, drive.time) if len(warm) > 1 else np.zeros_like(warm)
    return Jet(warm[:, None], rate[:, None], np.zeros((len(warm), 1)))


def products(one: Jet, other: Jet) -> Jet:
    """Products of the harmonics of two angles, (n, 4 ORDERS^2): cos cos, cos sin, sin cos, sin sin
    of (1, 1), (1, 2), ...
    """
    waves = [
        [(u.harmonic(m, 1.0, 0.0), u.harmonic(m, 0.0, 1.0)) for m in range(1, ORDERS + 1)]
        for u in (one, other)
    ]
    each = [p.times(q) for first in waves[0] for second in waves[1] for p in first for q in second]
    x, v, a = (
        np.column_stack(
            [np.broadcast_to(part, np.shape(e.x)) for e, part in zip(each, parts, strict=True)]
        )
        for parts in ([e.x for e in each], [e.v for e in each], [e.a for e in each])
    )
    return Jet(x, v, a)
