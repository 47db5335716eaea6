"""The whole search: the causes, random settings beside them, how probable each cause is, what it
may be, and what the noise that is left holds.
"""

from collections.abc import Callable
from dataclasses import replace

from tiltcal.diagnosis.data_faults.fault import Fault
from tiltcal.diagnosis.data_faults.prepare import PreparedData
from tiltcal.diagnosis.data_faults.setting_errors import (
    beside_stops,
    find_setting_error,
    lawful_part,
)
from tiltcal.diagnosis.model.finding_tests import NoiseSource
from tiltcal.diagnosis.model.fitted_model import FittedModel
from tiltcal.diagnosis.model.refitting import refit_about_itself
from tiltcal.diagnosis.model.whitened_model import WhitenedModel
from tiltcal.diagnosis.residual_checks.oscillations import (
    MovingTone,
    NarrowBand,
    moving_tones,
    narrow_bands,
)
from tiltcal.diagnosis.residual_checks.random_motion import RandomMotion, random_motions
from tiltcal.diagnosis.residual_checks.slow_variation import slow_variations
from tiltcal.diagnosis.residual_checks.varying_noise import VaryingNoise, varying_noise
from tiltcal.diagnosis.search.best_shape import normalise_tone_phase
from tiltcal.diagnosis.search.curve_misfit import largest_misfit
from tiltcal.diagnosis.search.dictionary import extend_dictionary
from tiltcal.diagnosis.search.explained import CLAIM, DOUBTED, Explained, select_claims
from tiltcal.diagnosis.search.model_search import iterate_to_convergence, most_probable
from tiltcal.diagnosis.search.names import named, without_misfits
from tiltcal.diagnosis.search.random_settings import beside_random_settings, is_systematic_error
from tiltcal.diagnosis.search.scan import Scan
from tiltcal.diagnosis.search.slow_laws import slow_laws
from tiltcal.diagnosis.search.state import laws
from tiltcal.effects.spans import SpectralLines
from tiltcal.statistics.noise_spectrum import NoiseFit


def search_for_causes(
    prepared: PreparedData,
    lines: SpectralLines,
    at_rest: tuple[NoiseFit, ...] | None,
    found: Callable[[int], None],
    compared: Callable[[], None],
) -> Explained:
    """The most probable model of the recordings, random effects beside it, and what each of its
    causes may be.

    Args:
        prepared: the data, with the columns of all hypotheses.
        lines: spectral lines that have hypotheses.
        at_rest: noise of each channel from a record at rest, when there is one.
        found: is told the number of causes of the best model so far.
        compared: is told when the model is found and alternatives are compared.
    """
    start, whitened = prepared.start, prepared.whitened
    noise_source = NoiseSource(at_rest, len(whitened.hypotheses))
    state = most_probable(start, whitened, noise_source, found)
    if extend_dictionary(state, lines):
        noise_source = replace(noise_source, total=len(whitened.columns.hypotheses))
        state = iterate_to_convergence(state.over(whitened.columns), noise_source)
    compared()
    random = False
    if not whitened.floors:
        state, random = beside_random_settings(state, noise_source)
    state, chances, doubts = select_claims(state, noise_source)
    scan = Scan(state.whitened)
    if any(not law.listed for law in laws(state.fitted)):
        state, _ = named(state, scan, random)  # what has a name leaves less of its law
    state, kept = without_misfits(state, scan)
    chances = tuple(chances[k] for k in kept)
    state, names = named(state, scan, random)
    fitted, random_faults = state.fitted, list[Fault]()
    if not whitened.floors:
        fitted, random_faults = _by_chance(fitted, start, state.whitened, noise_source)
    if fitted.terms:
        fitted = refit_about_itself(fitted, state.whitened)
    remaining = laws(fitted)
    held = [k for k, law in enumerate(laws(state.fitted)) if any(law is one for one in remaining)]
    left = noise_source.left_by(fitted, state.whitened)
    return Explained(
        normalise_tone_phase(fitted, prepared.observations),
        left,
        tuple(random_faults),
        noise_source,
        tuple(names[k] for k in held),
        tuple(chances[k] for k in held),
        slow_variations(left, DOUBTED),
        *(((), (), ()) if held or doubts else _in_the_noise(left, fitted)),
        () if held or random_faults else _motions(left, fitted),
        doubts,
        slow_laws(state, noise_source, doubts),
    )


def _in_the_noise(
    left: WhitenedModel, fitted: FittedModel
) -> tuple[tuple[NarrowBand, ...], tuple[MovingTone, ...], tuple[VaryingNoise, ...]]:
    """Bands with more power than noise, tones whose frequency moves, and noise that follows an
    angle or a cycle, in what a model leaves.
    """
    rest = left.residual(fitted.effects)
    tones = moving_tones(left, rest, fitted.effects, DOUBTED)
    varying = varying_noise(left, rest, fitted.effects, CLAIM)
    return narrow_bands(left, rest, DOUBTED), tones, varying


def _motions(left: WhitenedModel, fitted: FittedModel) -> tuple[RandomMotion, ...]:
    """Random motion in what a model leaves."""
    rest = left.residual(fitted.effects)
    return random_motions(left, rest, fitted.effects, DOUBTED)


def _by_chance(
    fitted: FittedModel, start: FittedModel, whitened: WhitenedModel, noise_source: NoiseSource
) -> tuple[FittedModel, list[Fault]]:
    """Random effects last, because they explain anything that varies from stop to stop; other
    findings have to be significant beside them.

    Unlisted curves with as many parameters as there are stops are no law: they are left out of this
    test.
    """
    lawful = lawful_part(fitted, whitened)
    setting = find_setting_error(
        lawful, start, whitened, noise_source.total, largest_misfit(lawful)
    )
    if setting is None or is_systematic_error(setting):
        return fitted, []
    return beside_stops(lawful, setting.stops, whitened, noise_source.total), [setting.fault]
