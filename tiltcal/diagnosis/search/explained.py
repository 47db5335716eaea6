"""What a search comes to: a fitted model, and how probable each of its causes is."""

from dataclasses import dataclass

from tiltcal.diagnosis.data_quality.fault import Fault
from tiltcal.diagnosis.model.finding_tests import NoiseSource
from tiltcal.diagnosis.model.fitted_model import FittedModel
from tiltcal.diagnosis.model.whitened_model import WhitenedModel
from tiltcal.diagnosis.residual_checks.moving_tones import MovingTone
from tiltcal.diagnosis.residual_checks.narrow_bands import NarrowBand
from tiltcal.diagnosis.residual_checks.random_motion import RandomMotion
from tiltcal.diagnosis.residual_checks.slow_variation import SlowVariation
from tiltcal.diagnosis.residual_checks.varying_noise import VaryingNoise
from tiltcal.diagnosis.search.name_probabilities import Names
from tiltcal.diagnosis.search.state import Doubt


@dataclass(frozen=True)
class Explained:
    """The most probable explanation of some recordings.

    Args:
        fitted: the model; whitened: its columns under the noise that it leaves.
        random_settings: random setting errors of a table axis.
        noise_source: says where the noise comes from.
        names: what each finding may be; probability: that each is there.
        slow: variation that is too large to be noise, more probably than not.
        bands: of frequency that hold more than noise; tones: whose frequency moves; both more
            probably than not, and where nothing else was found.
        varying: noise that follows an angle or a cycle, almost certainly, where nothing else was
            found.
        motions: at random, more probably than not, and where nothing else was found.
        doubts: causes that the noise may be instead.
    """

    fitted: FittedModel
    whitened: WhitenedModel
    random_settings: tuple[Fault, ...]
    noise_source: NoiseSource
    names: tuple[Names, ...]
    probability: tuple[float, ...]
    slow: tuple[SlowVariation, ...]
    bands: tuple[NarrowBand, ...] = ()
    tones: tuple[MovingTone, ...] = ()
    varying: tuple[VaryingNoise, ...] = ()
    motions: tuple[RandomMotion, ...] = ()
    doubts: tuple[Doubt, ...] = ()
