"""What a sigma-delta converter makes of an analogue signal: low-pass, limiter, sinc3, channels in
turn, codes.

The modulator's single bits are not drawn: its quantisation noise, shaped away from the band, is
below the code. What its filter averages is: three boxes of one output period each, sinc3 with
notches at the output rate and its multiples.
"""

import numpy as np

from tiltcal.core.arrays import Array
from tiltcal.effects.hysteresis_and_lag import first_order_lag
from tiltcal.setup.sensor import Converter

OVERSAMPLING = (
    16  # points of the fine grid a period of the output rate, at most one a modulator period
)
SETTLING = 8  # time constants of the low-pass that run before the first sample


def fine_grid(converter: Converter, time: Array, delay: float) -> Array:
    """The instants at which the analogue signal is needed for samples at ``time``, s. time: (n,);
    delay: s; the instants, (m,).
    """
    step = 1 / _fine_rate(converter)
    tau = 1 / (2 * np.pi * converter.lowpass_hz)
    lead = SETTLING * tau + 3 / converter.output_hz + 4 * converter.turn_s + delay
    return np.asarray(np.arange(time[0] - lead, time[-1] + step, step))


def converted(converter: Converter, grid: Array, signal: Array, instants: list[Array]) -> Array:
    """Readings of all channels, (n, k): channel i is kept ``turn_s`` before channel i + 1, the last
    at the stamp.

    Args:
        converter: the chain.
        grid: s, (m,), from ``fine_grid``.
        signal: of each channel on it, m/s2, (m, k).
        instants: stamps of each channel less its delay, s, (n,) each.
    """
    width = round(_fine_rate(converter) / converter.output_hz)
    box = np.full(width, 1 / width)
    kernel = np.convolve(np.convolve(box, box), box)  # sinc3
    # three boxes of points are that much too prompt
    early = 1.5 * (1 / _fine_rate(converter) - 1 / converter.modulator_hz)
    columns = []
    for i, moments in enumerate(instants):
        analogue = first_order_lag(grid, signal[:, i], 1 / (2 * np.pi * converter.lowpass_hz))
        limited = np.clip(analogue, -converter.limit, converter.limit)
        filtered = np.convolve(limited, kernel)[: len(grid)]
        end = moments - (len(instants) - 1 - i) * converter.turn_s - early
        columns.append(np.interp(end, grid, filtered))
    return np.column_stack(columns)


def coded(converter: Converter, reading: Array) -> Array:
    """Readings as whole codes, clipped at the ends of the range, m/s2. reading: m/s2, (n,)."""
    top = 2 ** (converter.bits - 1)
    return np.asarray(np.clip(np.rint(reading / converter.code), -top, top - 1) * converter.code)


def _fine_rate(converter: Converter) -> float:
    return min(OVERSAMPLING * converter.output_hz, converter.modulator_hz)
