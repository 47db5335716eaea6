"""Physical effects, each written once. See ``tiltcal.effects.base`` for what one is, ``catalogue``
for all of them.
"""

from tiltcal.effects.base import Effect, Parameter
from tiltcal.effects.catalogue import CATALOGUE, make_effect, to_file

__all__ = ["CATALOGUE", "Effect", "Parameter", "make_effect", "to_file"]
