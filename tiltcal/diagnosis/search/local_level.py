"""The level of what is left near a spectral line: the noise that a line has to stand out of.

A line among many others, or in a band where all is above the noise, is no line (Thomson, Proc. IEEE
70, 1982: the variance of a line test is that of its neighbourhood).
"""

from collections.abc import Sequence

import numpy as np

from tiltcal.diagnosis.data.observations import Columns
from tiltcal.diagnosis.hypotheses.hypothesis import Hypothesis
from tiltcal.diagnosis.model.fitted_model import FittedModel, FittedTerm, stored_of
from tiltcal.diagnosis.model.normal_equations import NormalEquations, left_beside, left_by_equations
from tiltcal.diagnosis.model.whitened_model import WhitenedModel

OCTAVE = 2.0  # from the lowest frequency of a neighbourhood to the highest
MIN_COEFFICIENTS = 16  # coefficients to either side


def local_level(
    law: Hypothesis,
    family: Sequence[Hypothesis],
    fitted: FittedModel,
    whitened: WhitenedModel,
) -> float:
    """Mean power of what a line leaves in its neighbourhood, in units of the noise, at least one;
    one for a law that is no line in time.

    Args:
        law: the line; family: what completes it: of a tone that wanders the lines beside it.
        fitted: the model without them; whitened: the noise.
    """
    if not law.line_hz:
        return 1.0
    own = stored_of(whitened, [FittedTerm.start(h) for h in (law, *family)])
    return _level(law, left_beside(own, fitted.basis, fitted.residual), whitened)


def level_beside(
    law: Hypothesis, equations: NormalEquations, fitted: FittedModel, whitened: WhitenedModel
) -> float:
    """As ``local_level``, from the normal equations of a law with what completes it."""
    if not law.line_hz:
        return 1.0
    return _level(
        law, left_by_equations(equations, fitted.basis, fitted.residual, whitened), whitened
    )


def _level(law: Hypothesis, left: Columns, whitened: WhitenedModel) -> float:
    channels = whitened.observations.channels
    found = [
        part[_near(law.line_hz, float(np.ptp(channels[i].time)), len(part))]
        for i, part in left.items()
    ]
    powers = np.concatenate([*found, np.zeros(0)]) ** 2
    return max(float(powers.mean()), 1.0) if len(powers) else 1.0


def _near(frequency: float, duration: float, n: int) -> slice:
    """Cosine coefficients within an octave about a frequency."""
    middle = 2 * duration * frequency
    low = min(middle / np.sqrt(OCTAVE), middle - MIN_COEFFICIENTS)
    high = max(middle * np.sqrt(OCTAVE), middle + MIN_COEFFICIENTS)
    return slice(max(int(low), 1), min(int(high) + 1, n))
