"""Who may take the place of the best explanation."""

from tiltcal.diagnosis.account import Term
from tiltcal.diagnosis.rivals import Rival, inseparable
from tiltcal.diagnosis.suspects import Suspect
from tiltcal.effects import CATALOGUE


def rival(id: str, gain: float, separation: float, curves: int = 0) -> Rival:
    suspect = Suspect(CATALOGUE[id]({"k2_x": 1e-4}, "accel"), ("k2_x",))
    terms = (Term(suspect, ("k2_x",), (1e-4,)),) * (1 + curves)
    return Rival(terms, gain, gain, 0.95, 0.98, separation, True, 0.95)


def test_a_curve_does_not_bring_a_rival_back_where_a_textbook_form_fits() -> None:
    """An odd quadratic fits to the noise; a cubic leaves 1680 of it, which a free curve of the input would take."""
    best = rival("acc_Koq", 53_000.0, 0.0)
    assert [r.suspect.id for r in inseparable(best, [best, rival("acc_K3", 52_990.0, 1680.0, curves=3)])] == ["acc_Koq"]
    assert len(inseparable(best, [best, rival("acc_K3", 52_990.0, 10.0, curves=3)])) == 2


def test_where_the_best_needs_curves_itself_those_of_a_rival_count_too() -> None:
    best = rival("acc_Koq", 53_000.0, 0.0, curves=2)
    assert len(inseparable(best, [best, rival("acc_K3", 52_990.0, 1680.0, curves=3)])) == 2
