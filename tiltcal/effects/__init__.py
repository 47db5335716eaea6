"""Physical effects, each written once. See ``tiltcal.effects.base`` for what one is, ``catalogue``
for all of them.
"""

from tiltcal.effects.base import Effect
from tiltcal.effects.catalogue import CATALOGUE, make_effect, to_file
from tiltcal.effects.parameter import Parameter

__all__ = ["CATALOGUE", "Effect", "Parameter", "make_effect", "to_file"]
