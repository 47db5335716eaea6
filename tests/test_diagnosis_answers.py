"""What a diagnosis says is what it fitted: parts of findings, verdicts without a test, the check by
the simulator.
"""

import re
from dataclasses import dataclass, replace
from html import unescape

import numpy as np
import pytest
from diagnosis_fixtures import bench, honest, recorded, rewritten

from tiltcal.diagnosis.conclusions.answering import Resimulation, answered, simulated
from tiltcal.diagnosis.conclusions.finding import in_words, verdict_of
from tiltcal.diagnosis.conclusions.other_findings import finding_of
from tiltcal.diagnosis.conclusions.residual_plots import laws_of
from tiltcal.diagnosis.conclusions.whole_law import _as_left
from tiltcal.diagnosis.data_faults.fault import Fault
from tiltcal.diagnosis.data_faults.prepare import prepare
from tiltcal.diagnosis.diagnose import diagnose
from tiltcal.diagnosis.hypotheses.hypothesis import Hypothesis
from tiltcal.diagnosis.model.finding_tests import NoiseSource
from tiltcal.diagnosis.model.fitted_model import FittedTerm
from tiltcal.diagnosis.model.refitting import refit
from tiltcal.diagnosis.search.candidates import Names
from tiltcal.diagnosis.search.explained import Explained
from tiltcal.diagnosis.search.state import Doubt
from tiltcal.effects import CATALOGUE
from tiltcal.effects.learned import LearnedReading
from tiltcal.laboratory.laboratory import SimulatedLaboratory
from tiltcal.laboratory.scenario import parse_scenario
from tiltcal.recordings.recording import Recording
from tiltcal.report.diagnosis import write_diagnosis

K2 = {"id": "acc_K2", "sensor": "accel", "k2_x_ug_g2": 400.0}
ENCODER = {"id": "table_encoder_2rev", "axis": "outer", "cos_arcsec": 40.0}
TIME = {"id": "learned", "on": "tilt", "coordinate": "time", "slot": "base", "turn": "x"}
RELAXING = TIME | {
    "knots": [0.0, 50.0, 100.0, 150.0, 220.0],
    "coefficients": [0.0, 5e-5, 3.2e-4, 3.4e-4, 4e-4],
}
BUMP = {
    "id": "learned",
    "on": "reading",
    "coordinate": "table_outer",
    "sensor": "accel",
    "axis": "y",
    "knots": [-3.2, -0.5, 0.2, 0.6, 3.2],
    "coefficients": [0.0, 0.0, 8e-3, 0.0, 0.0],
}
CASES = {
    "nothing": (),
    "one": (K2,),
    "two": (K2, ENCODER),
    "a law that is no textbook law": (RELAXING,),
    "no listed law": (BUMP,),
}
KNOTS = (-9.81, -4.9, 0.0, 4.9, 9.81)


def in_file(table):
    """An effect of an amended scenario without what says whose it is."""
    kept = {
        k: v
        for k, v in table.items()
        if k not in ("role", "finding", "seen_in", "on", "place") and not k.startswith("sigma_")
    }
    return repr(sorted(kept.items()))


def in_answer(part):
    """A part of a finding as the amended scenario has it."""
    values = {n: p["value"] for n, p in part.get("parameters", {}).items()}
    words = ("effect", "description", "stage", "axes", "parameters", "energy_share")
    kept = {k: v for k, v in part.items() if k not in words and v is not None}
    return repr(sorted({"id": part["effect"], **kept, **values}.items()))


def assert_all_is_named(found):
    """The found effects of the amended scenario are the parts of the findings, each by itself."""
    answer = found.to_json()
    held = [e for e in found.amended["effect"] if e.get("role") == "found"]
    for number, finding in enumerate(answer["findings"], 1):
        mine = sorted(in_file(e) for e in held if e["finding"] == number)
        assert mine == sorted(in_answer(p) for p in finding["parts"])
        assert sum(p["energy_share"] for p in finding["parts"]) == pytest.approx(1.0)
        for part in finding["parts"] if len(finding["parts"]) > 1 else ():
            word = part["description"] if part["effect"] == "learned" else part["effect"]
            assert word in finding["statement"]
            assert word in answer["statement"]
    assert {e["finding"] for e in held} == set(range(1, len(answer["findings"]) + 1))
    assert all(e.get("role") for e in found.amended["effect"])


@pytest.mark.parametrize("hidden", CASES.values(), ids=CASES)
def test_every_effect_of_the_amended_scenario_is_named(hidden, tmp_path):
    truth = bench(*hidden)
    found = diagnose(honest(truth), [recorded(truth, 11)])
    assert_all_is_named(found)
    write_diagnosis(found, tmp_path / "report.html", "run.csv")
    report = unescape((tmp_path / "report.html").read_text(encoding="utf-8"))
    for part in (p for f in found.findings for p in f.parts):
        assert f"<code>{part.effect}</code> {part.description}" in report
        assert f"{100 * part.energy_share:.1f} %" in report
    assert bool(hidden) == (found.verdict != "match")
    if RELAXING in hidden:
        assert len(found.findings[0].parts) > 1
    if BUMP in hidden:
        assert found.verdict == "unlisted"


def test_faults_of_the_data_are_parts_of_their_findings():
    truth = bench(K2)
    sound = recorded(truth, 4)
    frozen = sound.column("accel_y_m_s2").copy()
    frozen[900:1300] = frozen[900]
    wrong = rewritten(sound, accel_y_m_s2=frozen, accel_z_m_s2=-sound.column("accel_z_m_s2"))
    found = diagnose(honest(truth), [wrong])
    assert_all_is_named(found)
    assert {"data_stuck", "data_sign", "acc_K2"} <= {f.effect for f in found.findings}


def said_of(found, fitted):
    """A search that came to this model, whose only finding is a K2 for sure."""
    names = Names({"acc_K2": 1.0}, ("acc_K2",), ())
    return Explained(fitted, found.whitened, (), NoiseSource(None, 1), (names,), (1.0,), ())


@pytest.fixture(scope="module")
def cancelling():
    """A fitted model whose finding holds a law and a curve that takes part of it back."""
    truth = bench(K2)
    found = prepare(honest(truth), [recorded(truth, 5)])
    law = Hypothesis(CATALOGUE["acc_K2"]({"k2_x": 1e-4}, "accel", None, "found"), ("k2_x",))
    names = ("c0", "c2", "c4")
    curve = Hypothesis(
        LearnedReading(
            dict.fromkeys(names, 1e-3), "accel", "x", "found", coordinate="input", knots=KNOTS
        ),
        names,
    )
    terms = (FittedTerm.start(law), replace(FittedTerm.start(curve), host=law))
    both = refit(replace(found.start, terms=terms), found.whitened)
    alone = refit(replace(found.start, terms=terms[:1]), found.whitened)
    answer, amended = answered(found, said_of(found, both))
    return truth, found, both, alone, answer, amended


def test_sizes_are_those_of_the_whole_law_as_if_fitted_alone(cancelling):
    _, _, both, alone, answer, _ = cancelling
    value, sigma = answer.findings[0].parameters["k2_x_ug_g2"]
    assert value == pytest.approx(alone.terms[0].values[0] * 1e6, rel=1e-3)
    assert sigma == pytest.approx(float(alone.sigmas(0)[0]) * 1e6, rel=1e-3)
    assert sigma < 0.2 * float(both.sigmas(0)[0]) * 1e6  # the curve can stand for the law


def test_parts_stay_as_fitted(cancelling):
    _, _, both, _, answer, _ = cancelling
    assert_all_is_named(answer)
    law, curve = answer.findings[0].parts
    assert law.parameters["k2_x_ug_g2"][0] == pytest.approx(both.terms[0].values[0] * 1e6)
    held = [e for e in answer.amended["effect"] if e.get("finding") == 1]
    predicted = parse_scenario(dict(answer.amended)).effects
    assert [e.values for e in predicted if e.role == "found"] == [
        pytest.approx({**t.effect.values, **({} if t.host is None else {"c1": 0.0, "c3": 0.0})})
        for t in both.terms
    ]
    assert curve.curve["coefficients"] == held[1]["coefficients"]


def test_the_law_of_a_picture_has_the_curves_that_complete_it(cancelling):
    _, _, both, alone, answer, _ = cancelling
    (law,) = answer.findings[0].laws
    assert (law.subject, law.unit) == ("accel.x", "ug")
    u = law.coordinates["input_g"][law.still]
    square = u**2
    lead, whole = law.leading[law.still], law.law[law.still]
    np.testing.assert_allclose(lead, both.terms[0].values[0] * 1e6 * square, rtol=0.02, atol=5)
    # together they are the law that fits alone, but for a bias and a scale that others take up
    line = np.column_stack([np.ones_like(u), u])
    apart = whole - alone.terms[0].values[0] * 1e6 * square
    apart -= line @ np.linalg.lstsq(line, apart, rcond=None)[0]
    assert np.abs(apart).max() < 60
    assert np.abs(lead - whole).max() > 100


def test_a_learned_law_is_drawn_over_the_coordinate_that_it_follows():
    truth = bench(K2)
    found = prepare(honest(truth), [recorded(truth, 5)])
    names = ("c0", "c2", "c4")
    values = dict.fromkeys(names, 1e-3)
    curve = LearnedReading(values, "accel", "y", "found", coordinate="force_x", knots=KNOTS)
    term = replace(FittedTerm.start(Hypothesis(curve, names)), values=(2e-3, 0.0, 1e-3))
    fitted = replace(found.start, terms=(term,))
    left = found.observations.residuals(fitted.effects)
    ((law,),) = laws_of(fitted, found.observations, left)
    assert (law.subject, law.unit, law.follows) == ("accel.y", "ug", "force_x_g")
    u = law.coordinates["force_x_g"][law.still] * 9.80665
    np.testing.assert_allclose(law.law[law.still], term.effect.curve(u) / 9.80665e-6, atol=0.5)


def test_the_law_of_a_readout_error_is_drawn_as_an_angle():
    truth = bench(ENCODER)
    found = prepare(honest(truth), [recorded(truth, 5)])
    effect = CATALOGUE[ENCODER["id"]]({"cos": 1e-4}, None, "outer", "found")
    term = FittedTerm.start(Hypothesis(effect, ("cos",)))
    fitted = refit(replace(found.start, terms=(term,)), found.whitened)
    left = found.observations.residuals(fitted.effects)
    ((angle, *channels),) = laws_of(fitted, found.observations, left)
    assert angle.unit == "arcsec"
    u = np.radians(angle.coordinates["table_outer_deg"])
    size = fitted.terms[0].values[0] * 180 / np.pi * 3600
    assert size == pytest.approx(40.0, rel=0.1)
    np.testing.assert_allclose(np.abs(angle.law), np.abs(size * np.cos(2 * u)), atol=1e-3 * size)
    assert {law.unit for law in channels} == {"ug"}


@dataclass(frozen=True)
class Wrong:
    """A simulator whose readings of an axis are off by a share of a sample's noise."""

    share: float

    def predict(self, scenario, motion, seed=None, by_others=False):
        right = SimulatedLaboratory().predict(scenario, motion, seed, by_others)
        noise = 25e-6 * 9.80665 * np.sqrt(10.0)
        off = right.column("accel_x_m_s2") + self.share * noise
        return rewritten(right, accel_x_m_s2=off)


@pytest.mark.parametrize(
    ("share", "verdict"), [(0.0, None), (0.01, None), (0.3, "cannot_tell"), (1.0, "cannot_tell")]
)
def test_what_the_simulator_does_not_reproduce_is_not_explained(cancelling, share, verdict):
    _, found, _, _, answer, amended = cancelling
    again = simulated(answer, Wrong(share), found.observations, amended)
    assert again.verdict == (verdict or answer.verdict)
    assert answer.verdict in ("explained", "ambiguous")
    assert again.findings == answer.findings
    assert ("does not reproduce the fit" in again.statement) == bool(verdict)
    if verdict:  # to the accuracy of the channel's noise level, and of its mean
        said = re.findall(
            r"by up to (\S+) of a sample's noise, which adds (\S+) to", again.statement
        )
        at_most, rise = (float(x) for x in said[0])
        n = len(found.observations.channels[0].values)
        assert at_most == pytest.approx(share, rel=0.1)
        assert rise == pytest.approx(n * at_most**2, abs=8 * at_most * np.sqrt(n))


def test_an_amended_scenario_without_the_finding_is_not_reproduced(cancelling):
    """However small the finding is beside the noise of all samples."""
    _, found, _, _, answer, amended = cancelling
    without = {
        **answer.amended,
        "effect": [e for e in answer.amended["effect"] if "finding" not in e],
    }
    assert len(without["effect"]) < len(answer.amended["effect"])
    again = simulated(
        replace(answer, amended=without), SimulatedLaboratory(), found.observations, amended
    )
    assert again.verdict == "cannot_tell"


def test_a_simulator_that_is_nearer_to_the_recording_than_the_fit_is_no_failure():
    far = [Resimulation(0.5, 4.0, -900.0, 1000), Resimulation(1.1, 4.0, 900.0, 1000)]
    assert [r.failed for r in far] == [False, True]
    assert not Resimulation(refused="no triad").failed
    assert "not re-simulated: no triad" in Resimulation(refused="no triad").words


@pytest.mark.parametrize(("verdict", "left"), [("unlisted", "unlisted"), ("match", "cannot_tell")])
def test_what_is_not_reproduced_is_neither_named_nor_a_match(cancelling, verdict, left):
    _, found, _, _, answer, amended = cancelling
    said = replace(answer, verdict=verdict)
    again = simulated(said, Wrong(1.0), found.observations, amended)
    assert again.verdict == left
    assert "does not reproduce the fit" in again.statement


HANDHELD = parse_scenario(
    {
        "schema": 1,
        "name": "turned by hand",
        "site": {"gravity_m_s2": 9.81},
        "rig": {"table": "handheld"},
        "sensor": [
            {"name": "accel", "kind": "accelerometer", "rate_hz": 50.0, "adjustable": ["bias"]}
        ],
    }
)


def turning(rng, still_s, frozen):
    """An accelerometer that is turned without a stop after a while."""
    time = np.arange(0, 60, 0.02)
    a, b = (rate * np.maximum(time - still_s, 0) for rate in (0.5, 0.3))
    up = np.column_stack([np.cos(a) * np.cos(b), np.sin(a) * np.cos(b), np.sin(b)])
    force = 9.81 * up + rng.normal(0, 0.01, up.shape)
    if frozen:
        force[1000:2000, 1] = force[1000, 1]
    return Recording.from_columns(
        time, {f"accel_{a}_m_s2": force[:, k] for k, a in enumerate("xyz")}
    )


@pytest.mark.parametrize(
    ("still_s", "frozen", "reason"),
    [
        (2.0, False, "leaves no degrees of freedom"),
        (2.0, True, "leaves no degrees of freedom"),
        (0.0, True, "holds no rests"),
    ],
)
def test_a_recording_without_enough_rests_explains_nothing(still_s, frozen, reason, rng):
    found = diagnose(HANDHELD, [turning(rng, still_s, frozen)])
    assert found.verdict == "cannot_tell"
    assert reason in found.statement
    assert "Record several seconds at rest" in found.statement
    assert [f.effect for f in found.findings] == ["data_stuck"] * frozen
    assert all(f.statement in found.statement for f in found.findings)
    assert found.after.chi2_per_dof is found.before.chi2_per_dof is None
    assert "0.000" not in found.statement


def test_a_table_that_was_hardly_read_explains_nothing():
    truth = bench(K2)
    unread = recorded(truth, 3)
    names = [f"table_{a}_deg" for a in ("outer", "inner")]
    first = {n: np.where(np.arange(len(unread)) < 5, unread.column(n), np.nan) for n in names}
    found = diagnose(honest(truth), [rewritten(unread, **first)])
    assert found.verdict == "cannot_tell"
    assert "Record poses with the table read" in found.statement


def test_fewer_samples_than_parameters_explain_nothing(cancelling):
    """A model with as many columns as there are samples: chi-square is not defined."""
    _, found, both, *_ = cancelling
    full = replace(both)
    vars(full)["basis"] = tuple(np.zeros((len(q), found.observations.samples)) for q in both.basis)
    answer, _ = answered(found, said_of(found, full))
    assert answer.verdict == "cannot_tell"
    assert answer.after.chi2_per_dof is None
    assert "no degrees of freedom" in answer.statement
    assert answer.findings


def with_a_sign_turned() -> Fault:
    truth = bench()
    sound = recorded(truth, 4)
    turned = rewritten(sound, accel_z_m_s2=-sound.column("accel_z_m_s2"))
    (fault,) = prepare(honest(truth), [turned]).faults
    return fault


def test_nothing_tested_comes_before_any_finding():
    findings = (finding_of(with_a_sign_turned()),)
    assert verdict_of(findings, True) == "explained"
    assert verdict_of(findings, False) == "cannot_tell"


def test_what_is_more_probable_than_not_stands_in_the_statement_beside_what_is_found(cancelling):
    _, found, both, _, answer, _ = cancelling
    perhaps = Hypothesis(CATALOGUE["acc_K3"]({"k3_x": 1e-4}, "accel", None, "found"), ("k3_x",))
    said = replace(said_of(found, both), doubts=(Doubt(perhaps, 0.83, None, 0.0),))
    doubtful, _ = answered(found, said)
    assert doubtful.verdict == answer.verdict == "explained"
    assert doubtful.statement.startswith(answer.statement)
    added = doubtful.statement.removeprefix(answer.statement)
    assert "acc_K3" in added
    assert "(probability 0.83)" in added


def test_a_class_names_a_law_that_no_list_has_in_words():
    assert in_words(("acc_K2", "unlisted")) == ["acc_K2", "a cause outside the catalogue"]


def test_the_size_of_a_step_that_creeps_is_what_it_leaves():
    """Half at once and half over ten seconds: one half each, whatever their signals look like."""
    step = CATALOGUE["acc_bias_step"]({"bias_step_x": 0.1, "time": 20.0}, "accel", None)
    law = Hypothesis(step, ("bias_step_x",))
    late = Hypothesis(replace(step, values={**step.values, "creep": 10.0}), ("bias_step_x",))
    terms = [FittedTerm(law, law.names, (0.05,)), FittedTerm(late, law.names, (0.05,), law)]
    assert _as_left(terms, np.array([[0.7]])).tolist() == [[1.0]]
    other = FittedTerm(replace(late, alias="acc_drift"), law.names, (0.05,), law)
    assert _as_left([terms[0], other], np.array([[0.7]])).tolist() == [[0.7]]
