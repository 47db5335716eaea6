"""The check that counts literals of effect ids."""

from checks.effect_ids import MOST, complaints, literals

SOURCE = 'def known(effect):\n    return effect.id in ("acc_K2", "no_effect")\n'


def test_an_id_among_the_constants_of_a_module_is_found():
    (literal,) = literals("tiltcal/some.py", SOURCE)
    assert str(literal) == "tiltcal/some.py:2: 'acc_K2'"


def test_a_literal_needs_an_exception_and_an_exception_a_literal():
    found = list(literals("tiltcal/some.py", SOURCE))
    place = ("tiltcal/some.py", "acc_K2")
    assert complaints(found, {place: "a reason"}) == []
    (missing,) = complaints(found, {})
    assert "tiltcal/some.py:2" in missing
    (unused,) = complaints([], {place: "a reason"})
    assert "no such literal" in unused


def test_there_are_few_exceptions():
    places = {(f"tiltcal/{k}.py", "acc_K2"): "a reason" for k in range(MOST + 1)}
    found = [literal for path, _ in places for literal in literals(path, SOURCE)]
    assert len(complaints(found, places)) == 1
