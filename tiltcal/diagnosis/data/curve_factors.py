"""Changes of a channel by the coefficients of a curve, as factors: the curve, which many places
share, and what the channel answers to it at one of them.

At an instant the motion depends on a turn's angle, rate and acceleration at that instant only: the
curve's value, rate and acceleration, each times the answer to it, are the change.
"""

from dataclasses import dataclass

import numpy as np

from tiltcal.core.arrays import Single
from tiltcal.diagnosis.data.block_grid import Sampling


@dataclass(frozen=True, eq=False)
class SharedCurve:
    """A curve that acts at many places, for each coefficient alone at its plausible size.

    Args:
        parts: its value, rate and acceleration where a model is asked, (p, m) each; those at the
            end that are zero are left out.
    """

    parts: tuple[Single, ...]


@dataclass(frozen=True)
class CurveFactors:
    """Change of a channel by each coefficient of a curve alone.

    Args:
        curve: of p coefficients.
        answers: of the channel to each part of the curve where a model is asked, SI, (m,) each;
            None where there is none.
        sampling: from there to the samples of the channel.
        spread: of the samples, by which they are divided, (n,); None where all are alike.
    """

    curve: SharedCurve
    answers: tuple[Single | None, ...]
    sampling: Sampling
    spread: Single | None = None

    def columns(self, which: slice = slice(None)) -> Single:
        """The changes by some coefficients, SI, (p, n)."""
        parts = zip(self.answers, self.curve.parts, strict=True)
        known = [(answer, part[which]) for answer, part in parts if answer is not None]
        total = known[0][0] * known[0][1]
        more = np.empty_like(total)
        for answer, part in known[1:]:
            total += np.multiply(answer, part, out=more)
        found = np.ascontiguousarray(self.sampling.of(total.T).T)
        return found if self.spread is None else found / self.spread

    def adjoint(self, vectors: Single) -> Single:
        """What has the inner products with changes where a model is asked that vectors have with
        those at the samples, (n, q) -> (m, q).
        """
        weighed = vectors if self.spread is None else vectors / self.spread[:, None]
        return self.sampling.adjoint(weighed)
