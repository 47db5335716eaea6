"""Who may take the place of the best explanation."""

from tiltcal.diagnosis.hypotheses.hypothesis import Hypothesis
from tiltcal.diagnosis.model.fitted_model import FittedTerm
from tiltcal.diagnosis.search.alternatives import Alternative, inseparable, preferred
from tiltcal.effects import CATALOGUE


def rival(id: str, gain: float, separation: float, curves: int = 0) -> Alternative:
    hypothesis = Hypothesis(CATALOGUE[id]({"k2_x": 1e-4}, "accel"), ("k2_x",))
    terms = (FittedTerm(hypothesis, ("k2_x",), (1e-4,)),) * (1 + curves)
    return Alternative(terms, gain, gain, 0.95, 0.98, separation, True, 0.95)


def test_a_curve_does_not_bring_a_rival_back_where_a_textbook_form_fits() -> None:
    """An odd quadratic fits to the noise; a cubic leaves 1680 of it, which a free curve of the
    input would take.
    """
    best = rival("acc_Koq", 53_000.0, 0.0)
    assert [
        r.hypothesis.id
        for r in inseparable(best, [best, rival("acc_K3", 52_990.0, 1680.0, curves=3)])
    ] == ["acc_Koq"]
    assert len(inseparable(best, [best, rival("acc_K3", 52_990.0, 10.0, curves=3)])) == 2


def test_where_the_best_needs_curves_itself_those_of_a_rival_count_too() -> None:
    best = rival("acc_Koq", 53_000.0, 0.0, curves=2)
    assert len(inseparable(best, [best, rival("acc_K3", 52_990.0, 1680.0, curves=3)])) == 2


def of(
    id: str, names: tuple[str, ...], worth: float, *, curves: int = 0, form: float = 1.0
) -> Alternative:
    sensor = "accel" if CATALOGUE[id].kinds else None
    hypothesis = Hypothesis(CATALOGUE[id](dict.fromkeys(names, 1e-4), sensor), names)
    terms = (FittedTerm(hypothesis, names, (1e-4,) * len(names)),) * (1 + curves)
    return Alternative(terms, worth, worth, form, 0.98, 0.0, True, form)


def test_a_form_that_is_as_worthy_without_what_completes_it_is_as_plain_as_any() -> None:
    """A jump of one bias, and a curve that brings next to nothing, against a slip with two sizes:
    one number is fewer.
    """
    step = of("acc_bias_step", ("bias_step_y",), 543_120.0, curves=1, form=0.9999)
    slip = of("mount_slip", ("slip_x", "slip_z"), 543_105.0)
    assert preferred([step, slip]) is step
    needed = of("acc_bias_step", ("bias_step_y",), 543_120.0, curves=1, form=0.9)
    assert preferred([needed, slip]) is slip


def test_of_the_same_form_the_one_with_less_beside_it_is_preferred() -> None:
    bare, burdened = (
        of("acc_bias_step", ("bias_step_y",), worth, curves=k, form=0.9999)
        for worth, k in ((990.0, 1), (991.0, 3))
    )
    assert preferred([burdened, bare]) is bare
