"""The library of measuring schemes: what is turned up, on which table, and what each scheme can
tell.
"""

import numpy as np
import pytest
from builders import ACCEL, G, setup_of
from pydantic import ValidationError

from tiltcal.calibration.methods.terms import term_columns
from tiltcal.core.errors import TiltcalError
from tiltcal.core.frames import parse_up
from tiltcal.forward.kinematics import closed_form
from tiltcal.setup.pose_schemes import directions, label_of
from tiltcal.setup.schedule import build_schedule
from tiltcal.setup.sequence import Step
from tiltcal.setup.setup import Rig

COUNTS = {"6": 6, "8": 8, "12": 12, "24": 24, "tumble": 36}


def rank_of(scheme: str, terms: list[str]) -> tuple[int, int]:
    """Rank of the design of some terms at the positions of a scheme, and the number of its
    parameters.
    """
    names, _, columns = term_columns(terms, ACCEL, setup_of("dual", ACCEL), G * directions(scheme))
    A = columns.reshape(len(names), -1).T
    return int(
        np.linalg.matrix_rank(A / np.maximum(np.linalg.norm(A, axis=0), 1e-12), tol=1e-9)
    ), len(names)


@pytest.mark.parametrize("scheme", COUNTS)
def test_a_scheme_has_its_number_of_unit_directions(scheme):
    up = directions(scheme)
    assert len(up) == COUNTS[scheme]
    np.testing.assert_allclose(np.linalg.norm(up, axis=1), 1)
    np.testing.assert_allclose(up.mean(axis=0), 0, atol=1e-12)  # every direction has its opposite
    assert rank_of(scheme, ["bias", "scale", "cross_axis"]) == (12, 12)


def test_each_scheme_tells_the_terms_it_is_for():
    second = ["bias", "scale", "cross_axis", "K2"]
    assert rank_of("8", second) == (12, 15)  # f_i^2 = g^2/3 at every corner: K2 is a bias there
    assert rank_of("12", second) == (15, 15)
    products = ["bias", "scale", "cross_axis", "Kip", "Kio", "Kpo"]
    assert rank_of("6", products)[0] == 12  # six faces load one axis at a time
    assert rank_of("8", products) == (21, 21)
    assert rank_of("tumble", [*second, "K3", "Kip", "Kio", "Kpo"]) == (27, 27)


@pytest.mark.parametrize("mount", ["identity", "Rz(90)", "Rx(90) Rz(180)"])
@pytest.mark.parametrize("table", ["dual", "three", "handheld"])
@pytest.mark.parametrize("scheme", COUNTS)
def test_every_table_turns_up_what_the_scheme_says_and_labels_it(scheme, table, mount):
    setup = setup_of(table, ACCEL, mount=mount)
    schedule = build_schedule([Step(action="scheme", scheme=scheme, dwell_s=2)], setup.rig)
    rests = [leg for leg in schedule.legs if leg.profile == "rest"]
    drive = schedule.drive(np.array([(leg.t0 + leg.t1) / 2 for leg in rests]))
    up = closed_form(setup, drive).up
    expected = directions(scheme)
    labels = np.array([parse_up(leg.label) for leg in rests])
    if table == "handheld":  # by hand the mounting lies inside the instrument's own body
        up = up if mount == "identity" else labels
    np.testing.assert_allclose(labels, expected, atol=1e-6)
    np.testing.assert_allclose(up, expected, atol=2e-6)


def test_twenty_four_positions_have_four_headings_on_three_axes():
    schedule = build_schedule([Step(action="scheme", scheme="24", dwell_s=1)], Rig(table="three"))
    rests = [leg for leg in schedule.legs if leg.profile == "rest"]
    assert {round(float(np.degrees(leg.q0[0]))) for leg in rests} == {0, 90, 180, 270}


def test_labels_are_short_where_they_can_be():
    assert [label_of(np.array(v)) for v in ([0, 0, -1.0], [0.6, 0, 0.8])] == ["-z", "[0.6, 0, 0.8]"]


def test_a_table_that_cannot_reach_them_and_a_scheme_that_is_none_are_refused():
    with pytest.raises(
        TiltcalError,
        match=r"step 1 \(scheme\): found table placing, need dual, three, four or handheld",
    ):
        build_schedule([Step(action="scheme", scheme="6", dwell_s=1)], Rig(table="placing"))
    with pytest.raises(ValidationError, match="action scheme needs scheme"):
        Step(action="scheme")
    with pytest.raises(ValidationError, match="scheme"):
        Step(action="scheme", scheme="7")
