"""Laws over the catalogue: what an effect says of itself makes sense, for every effect."""

from itertools import pairwise

import numpy as np
import pytest
from builders import INSTRUMENT, setup_of
from catalogue_cases import plausible, sensors_for

from tiltcal.design.recording_blocks import DESCRIPTIONS
from tiltcal.diagnosis.hypotheses.hypothesis import listed_hypotheses
from tiltcal.effects import CATALOGUE
from tiltcal.effects.base import SignalEffect, TermEffect
from tiltcal.effects.calibration_terms import calibration_effect
from tiltcal.effects.curve_coordinates import COORDINATES
from tiltcal.effects.data.labelling_faults import ColumnFault
from tiltcal.effects.parameter import Parameter
from tiltcal.effects.sense import Sense
from tiltcal.effects.sensor.accelerometer import AccTerm
from tiltcal.effects.spans import CoordinateRanges, SpectralLines
from tiltcal.laboratory.scenario import parse_scenario
from tiltcal.setup.tables import angle_channel, built_in_axes

EVERY = pytest.mark.parametrize("cls", CATALOGUE.values(), ids=list(CATALOGUE))
LINES = SpectralLines(tones=(3.3, 7.1), shakes=(5.0,), ripples=(33,))
SPAN = CoordinateRanges(300.0, 50.0, LINES, {"temperature": (-2.0, 3.0)})
SILENT = CoordinateRanges(300.0, 50.0, gears=(100.0,))
ANGLES = {angle_channel(axis) for axis in built_in_axes()}
FOLLOWED = {"temperature", "time", "move", "rate", "frequency", "tilt", "sample", "load moment"}


def names_of(cls):
    return {p.name for p in cls.parameters}


# ----------------------------------------------------------------------------------------- the law


@EVERY
def test_a_twin_by_law_stands_for_itself(cls):
    if cls.same_form_as:
        twin = CATALOGUE[cls.same_form_as]
        assert twin is not cls
        assert not twin.same_form_as
        assert cls.has_column()
        assert twin.has_column()


@EVERY
def test_shapes_are_values_of_shape_parameters(cls):
    for span in (SPAN, SILENT):
        for shape in cls.shapes(span):
            known = {p.name: p for p in cls.parameters if p.is_shape}
            assert set(shape) <= set(known)
            assert all(np.isfinite(value) for value in shape.values())
            assert all(value >= 0 for name, value in shape.items() if known[name].positive)
        tried = [tuple(sorted(shape.items())) for shape in cls.shapes(span)]
        assert len(set(tried)) == len(tried)


@EVERY
def test_a_line_of_time_is_tried_only_where_one_stands_out(cls):
    if cls.spectral_line == "time":
        assert "frequency" in names_of(cls)
        assert cls.shapes(SPAN)
        assert not cls.shapes(SILENT)
    elif cls.spectral_line == "angle":
        assert len(cls.shapes(SPAN)) == len(cls.shapes(SILENT)) + len(LINES.ripples)
    else:
        assert not cls.wander
        assert cls.shapes(SILENT)


@EVERY
def test_a_family_is_of_known_coordinates_slots_and_effects(cls):
    family = cls.family
    assert set(family.reading) | set(family.scale) <= {*COORDINATES, *ANGLES}
    assert set(family.readout) <= {"table_{axis}", *COORDINATES}
    for slot, coordinate in family.tilt:
        assert slot in {"base", "mount", "{axis}_bearing"}
        assert coordinate in {"table_{axis}", *COORDINATES}
    for id in family.effects:
        assert CATALOGUE[id].kinds == cls.kinds
    assert not (family.reading or family.scale) or cls.kinds or cls.axis_wise


@EVERY
def test_a_name_without_a_law_has_curves_that_stand_for_it(cls):
    assert cls.form in ("law", "any", "unknown")
    if cls.form != "law":
        assert cls.family.reading or cls.family.tilt


@EVERY
def test_a_law_that_is_felt_late_follows_temperature(cls):
    if cls.lags_thermometer:
        tilts = tuple(coordinate for _, coordinate in cls.family.tilt)
        followed = {*cls.family.reading, *cls.family.scale, *cls.family.across, *tilts}
        assert cls.needs == "temperature"
        assert followed
        assert followed <= {"temperature", "warming"}


@EVERY
def test_a_harmonic_is_one_of_a_table_axis(cls):
    assert cls.harmonic >= 0
    assert not cls.harmonic or cls.axis_wise
    assert not cls.axis_by_gravity or cls.axis_wise


@EVERY
def test_what_acts_from_an_instant_has_an_instant(cls):
    assert not cls.acts_from_an_instant or "time" in names_of(cls)


@EVERY
def test_a_threshold_is_a_level_that_only_positive_values_make_sense_of(cls):
    if cls.threshold:
        assert not cls.has_column()
        assert all(p.positive for p in cls.parameters)


# ------------------------------------------------------------------------- where and when it shows


@EVERY
def test_an_effect_shows_on_a_table_and_on_none_only_if_it_needs_none(cls):
    by_hand, table = setup_of("handheld", *INSTRUMENT).rig, setup_of("dual", *INSTRUMENT).rig
    assert cls.shows_on(table) != (cls.seen_by_encoder or cls.of_model)
    assert cls.shows_on(by_hand) == (cls.stage != "table" and not cls.on_table)


@EVERY
def test_an_effect_has_sizes_on_every_table(cls):
    for table in ("dual", "three", "four"):
        setup = setup_of(table, *INSTRUMENT)
        for sensor in sensors_for(cls, setup):
            sizes = cls.sizes_on(sensor.axes if sensor else (), setup.rig)
            assert sizes
            assert set(sizes) <= set(plausible(cls.id, setup, sensor).values)


@EVERY
def test_a_frame_convention_is_made_of_sizes(cls):
    sizes = {name for p in cls.parameters for name in p.expand("xyz")}
    assert set(cls.frame_convention) <= sizes


# ----------------------------------------------------------------------------- what it is used for


@pytest.mark.parametrize("kind", ["accelerometer", "inclinometer", "gyro", "fog"])
@pytest.mark.parametrize("term", ["bias", "scale", "cross_axis"])
def test_a_calibration_term_is_one_linear_effect_of_a_kind_of_sensor(term, kind):
    named = [c for c in CATALOGUE.values() if c.calibration_term == term and kind in c.kinds]
    assert len(named) == (0 if (term, kind) == ("cross_axis", "fog") else 1)
    assert calibration_effect(term, kind) is (named[0] if named else None)
    assert all(issubclass(c, TermEffect) and c.linear and c.ordinary for c in named)


def test_a_calibration_term_may_be_the_id_of_an_effect():
    assert calibration_effect("acc_K2", "accelerometer") is CATALOGUE["acc_K2"]
    assert calibration_effect("no such term", "accelerometer") is None


@EVERY
def test_what_is_ordinary_stands_for_itself_and_leaves_the_data_sound(cls):
    if cls.ordinary:
        assert not cls.repair
        assert not cls.acts_from_an_instant
        assert cls.same_form_as in ("", "acc_cross_axis")  # a mounting is there all the same


@EVERY
def test_what_is_repaired_in_the_data_is_not_fitted(cls):
    assert cls.repair in ("", "columns", "samples")
    assert not cls.repair or not cls.has_column()
    assert (cls.repair == "columns") == issubclass(cls, ColumnFault)
    assert not cls.mislabels or cls.stage == "data"
    assert not cls.scatters or cls.random


@pytest.mark.parametrize("axes", ["xyz", "xy", "zx"])
@pytest.mark.parametrize("cls", [c for c in CATALOGUE.values() if issubclass(c, ColumnFault)])
def test_a_column_fault_is_its_matrix(cls, axes):
    sensor = setup_of("dual", *INSTRUMENT).sensor[0].model_copy(update={"axes": tuple(axes)})
    rng = np.random.default_rng(5)
    sense = Sense.at_rest(sensor, 9.8, rng.normal(size=(20, 3)))
    names = [name for p in cls.parameters for name in p.expand(axes)]
    for name in names:
        effect = cls({name: 1.0 if name != "factor" else 57.3})
        reading = sense.true_input()
        expected = reading @ effect.matrix(tuple(axes)).T
        assert effect.apply(reading.copy(), sense, None) == pytest.approx(expected, rel=1e-14)


# ---------------------------------------------------------------------------------------- in words


@EVERY
def test_wording_is_plain(cls):
    assert cls.physics[0].isupper()
    assert cls.physics.endswith(".")
    for words in (cls.title, cls.look, cls.excited_by):
        assert not words.endswith(".")
    assert cls.follows in {"", *FOLLOWED, *ANGLES, angle_channel("{innermost}")}


@EVERY
def test_twins_are_told_apart_by_a_block_or_a_phrase_said_once(cls):
    for other, words in cls.distinguished_by.items():
        assert cls.id not in CATALOGUE[other].distinguished_by
        assert words in DESCRIPTIONS or (" " in words and not words.endswith("."))


# ---------------------------------------------------------------------------------- from elsewhere


class AccK4(AccTerm):
    """An effect that no module of the project knows."""

    id = "acc_K4"
    title = "fourth-order non-linearity"
    parameters = (
        Parameter("k4_{axis}", "ug_g2", (5, 50, 500)),
        Parameter("at", "s", (1, 1, 1), shape=True),
    )
    physics = "A quartic."
    equation = "reading_i += K4 f_i^4"
    excited_by = "both signs of its own force"
    look = "a quartic"

    @classmethod
    def shapes(cls, span):
        return [{"at": 0.0}, {"at": span.duration}]

    def column(self, fi, fp, fo):
        return fi**4


def test_an_effect_that_joins_the_catalogue_is_a_hypothesis_like_any_other(monkeypatch):
    monkeypatch.setitem(CATALOGUE._classes, AccK4.id, AccK4)
    scenario = parse_scenario(
        {
            "schema": 1,
            "site": {"gravity_m_s2": 9.8},
            "rig": {"table": "dual"},
            "sensor": [{"name": "accel", "kind": "accelerometer"}, {"name": "g", "kind": "gyro"}],
            "sequence": [{"action": "rest", "dwell_s": 1.0}],
        }
    )
    found = [h for h in listed_hypotheses(scenario, SPAN) if h.id == AccK4.id]
    assert [h.effect.values["at"] for h in found] == [0.0, 300.0]
    assert all(h.effect.sensor == "accel" and h.textbook for h in found)
    assert found[0].names == ("k4_x", "k4_y", "k4_z")


def test_the_catalogue_is_in_the_order_of_the_chain():
    signal = [c for c in CATALOGUE.values() if issubclass(c, SignalEffect)]
    stages = [
        ("environment", "table", "mount", "sensor", "electronics", "timing", "data").index(c.stage)
        for c in signal
    ]
    assert all(a <= b for a, b in pairwise(stages))
