"""Laws that every effect of the catalogue obeys, whatever its physics."""

from pathlib import Path

import numpy as np
import pytest
from catalogue_cases import (
    STEPS,
    difference,
    largest,
    lively,
    lively_readings,
    plausible,
    sensors_for,
)

from tiltcal.core.units import PARAMETER_UNITS
from tiltcal.effects import CATALOGUE, make_effect, to_file
from tiltcal.effects.base import DelayEffect, SignalEffect, WritingEffect
from tiltcal.effects.data.faults import DataOutlier
from tiltcal.effects.electronics.converter import AdcQuantisation
from tiltcal.effects.parameter import STAGES
from tiltcal.setup.tables import BUILT_IN

FROZEN = Path(__file__).with_name("effect_parameters.txt")
IDS = tuple(CATALOGUE)
RANDOM = tuple(id for id, cls in CATALOGUE.items() if cls.random)
# chance draws nothing
ROUNDING = tuple(id for id, cls in CATALOGUE.items() if issubclass(cls, AdcQuantisation))
WRITING = tuple(id for id, cls in CATALOGUE.items() if issubclass(cls, WritingEffect))
LINEAR = tuple(id for id, cls in CATALOGUE.items() if cls.linear)


def rig_axes(cls, setup):
    return (None, *setup.rig.axis_names) if cls.axis_wise else (None,)


# --------------------------------------------------------------------------------------------------
# identity


@pytest.mark.parametrize("table", STEPS)
@pytest.mark.parametrize("id", IDS)
def test_an_effect_of_no_size_changes_no_reading(id, table, monkeypatch):
    setup, _, _ = lively(table)
    cls = CATALOGUE[id]
    nothing = lively_readings(table, seed=1)
    for sensor in sensors_for(cls, setup):
        for axis in rig_axes(cls, setup):
            # where and when alone are no size
            zero = plausible(id, setup, sensor, axis=axis, size=0.0)
            assert zero.is_identity
            with monkeypatch.context() as patch:
                patch.setattr(cls, "is_identity", False)  # so that the chain does not skip it
                assert largest(difference(lively_readings(table, zero, seed=1), nothing)) == 0


# ------------------------------------------------------------------------------------------- names
# and words


def frozen() -> dict[str, tuple[str, set[str], set[str]]]:
    """id -> stage, parameters, parameters that were added later, of effect_parameters.txt."""
    lines = FROZEN.read_text(encoding="utf-8").splitlines()
    cells = [line.split("|") for line in lines if not line.startswith("#")]
    return {
        id.strip(): (stage.strip(), set(parameters.split()), set(added.split()))
        for id, stage, parameters, added in cells
    }


def test_ids_are_added_to_the_frozen_list_and_none_is_renamed_or_removed():
    assert set(frozen()) == set(IDS)


@pytest.mark.parametrize("id", IDS)
def test_stage_and_parameters_are_those_of_the_frozen_list(id):
    cls = CATALOGUE[id]
    stage, parameters, added = frozen()[id]
    known = [p for p in cls.parameters if not p.tables or p.tables & set(BUILT_IN)]
    assert cls.stage == stage
    assert {p.name + p.suffix for p in known} == parameters | added
    # left out, the effect is as it was before: a size of a linear one adds its own part alone
    assert all(p.is_shape or cls.linear for p in known if p.name + p.suffix in added)


@pytest.mark.parametrize("id", IDS)
def test_an_effect_describes_itself(id):
    cls = CATALOGUE[id]
    assert cls.id == id
    assert cls.stage in STAGES
    for text in (cls.title, cls.physics, cls.equation, cls.source, cls.excited_by, cls.look):
        assert text.strip()
    assert cls.parameters
    for p in cls.parameters:
        assert p.unit in PARAMETER_UNITS
        assert all(size > 0 for size in p.plausible)
    # on a sensor, or on the rig
    assert bool(cls.kinds) == issubclass(cls, SignalEffect | DelayEffect)


@pytest.mark.parametrize("id", IDS)
def test_an_effect_reads_back_from_its_own_file(id):
    setup, _, _ = lively("three")
    cls = CATALOGUE[id]
    sensor = sensors_for(cls, setup)[-1]
    made = plausible(id, setup, sensor, axis="outer" if cls.axis_wise else None)
    names = list(made.values)
    made = type(made)(
        made.values, made.sensor, made.axis, "found", {names[0]: made.values[names[0]] / 7}, True
    )
    table = to_file(made)
    where = {key: table.pop(key, None) for key in ("id", "sensor", "axis", "role", "fit")}
    again = make_effect(where.pop("id"), table, setup, **where)
    assert (again.sensor, again.axis, again.role, again.fit) == (
        made.sensor,
        made.axis,
        "found",
        True,
    )
    assert again.values == pytest.approx(dict(made.values), rel=1e-15)
    assert again.sigmas == pytest.approx(dict(made.sigmas), rel=1e-15)


# ---------------------------------------------------------------------------------------- size and
# linearity


@pytest.mark.parametrize(
    "id", [id for id in IDS if id not in WRITING and not CATALOGUE[id].of_model]
)
def test_a_plausible_size_shows_in_a_recording_that_excites_it(id):
    shown = 0.0
    for table in STEPS:
        setup, _, _ = lively(table)
        for sensor in sensors_for(CATALOGUE[id], setup):
            effect = plausible(id, setup, sensor)
            shown = max(
                shown,
                largest(
                    difference(
                        lively_readings(table, effect, seed=1), lively_readings(table, seed=1)
                    )
                ),
            )
    assert shown > 1e-9


@pytest.mark.parametrize("id", WRITING)
def test_what_is_written_wrongly_changes_the_file_and_not_the_sensors(id):
    setup, course, times = lively("dual")
    effect, drive = plausible(id, setup), course.drive(times["accel"])
    written = [(effect.written(axis, drive), jet.x) for axis, jet in drive.axes.items()]
    changes = [np.abs(wrong - true).max() for wrong, true in written if wrong is not None]
    assert max(*changes, 0.0, np.abs(effect.stamps(drive.time) - drive.time).max()) > 1e-6
    assert (
        largest(
            difference(lively_readings("dual", effect, seed=1), lively_readings("dual", seed=1))
        )
        == 0
    )


@pytest.mark.parametrize("table", STEPS)
@pytest.mark.parametrize("id", LINEAR)
def test_an_effect_that_says_it_is_linear_doubles_with_its_size(id, table):
    """To second order: at a thousandth of the plausible size, a thousandth of the effect at most is
    left over.
    """
    setup, _, _ = lively(table)
    for sensor in sensors_for(CATALOGUE[id], setup):
        none, once, twice = (
            lively_readings(table, plausible(id, setup, sensor, size=s)) for s in (0.0, 1e-3, 2e-3)
        )
        level = np.abs(none["incl"]).max(axis=1) < 1.0  # rad: an arcsine is not smooth at 90 deg
        for reading in (none, once, twice):
            reading["incl"] = reading["incl"][level]
        single, double = difference(once, none), difference(twice, none)
        leftover = {name: double[name] - 2 * single[name] for name in single}
        assert largest(leftover) <= 1e-3 * largest(single) + 1e-12


# --------------------------------------------------------------------------------------------------
# -- chance


def random_cases(id: str):
    """The effect on each sensor, with what it needs beside it. Not on the inclinometer, whose
    arcsine does not add.
    """
    setup, _, _ = lively("placing")
    for sensor in sensors_for(CATALOGUE[id], setup):
        if sensor is None or sensor.kind != "inclinometer":
            beside = (
                [plausible(NOISE[sensor.kind], setup, sensor)]
                if issubclass(CATALOGUE[id], DataOutlier)
                else []
            )
            yield (sensor.name if sensor else "accel"), beside, plausible(id, setup, sensor, part=2)


NOISE = {"accelerometer": "acc_noise", "gyro": "gyr_noise", "fog": "gyr_noise"}


def drawn(effect, *beside, seed=5):
    """What a random effect adds to the readings."""
    return difference(
        lively_readings("placing", *beside, effect, seed=seed),
        lively_readings("placing", *beside, seed=seed),
    )


@pytest.mark.parametrize("id", RANDOM)
def test_noise_off_removes_a_random_effect(id):
    for _, beside, effect in random_cases(id):
        assert largest(drawn(effect, *beside, seed=None)) == 0


@pytest.mark.parametrize("id", RANDOM)
def test_the_same_seed_repeats_and_another_does_not(id):
    for name, beside, effect in random_cases(id):
        first, again, other = (drawn(effect, *beside, seed=s) for s in (5, 5, 6))
        assert largest(difference(first, again)) == 0
        assert id in ROUNDING or largest(difference(first, other), name) > 0


@pytest.mark.parametrize("id", [id for id in RANDOM if id not in ROUNDING])
def test_another_effect_does_not_change_what_a_random_one_draws(id):
    setup, _, _ = lively("placing")
    bias = {"accel": "acc_bias", "gyro": "gyr_bias", "fog": "fog_bias", "enc": "enc_bias"}
    for name, beside, effect in random_cases(id):
        alone = drawn(effect, *beside)
        others = [plausible(bias[name], setup, setup.named(name))]
        if id in ("data_jitter", "table_index_error"):  # what is drawn later simply adds
            others.append(plausible(NOISE[setup.named(name).kind], setup, setup.named(name)))
        for other in others:
            assert largest(alone, name) > 0
            np.testing.assert_allclose(
                drawn(effect, other, *beside)[name],
                alone[name],
                rtol=0,
                atol=1e-9 * largest(alone, name) + 1e-14,
            )


def test_random_effects_of_two_axes_draw_differently():
    setup, _, _ = lively("dual")
    outer, inner = (
        drawn_on("dual", plausible("table_index_error", setup, axis=axis))
        for axis in ("outer", "inner")
    )
    assert largest(difference(outer, inner)) > 0.1 * largest(outer)


def drawn_on(table, effect):
    return difference(lively_readings(table, effect, seed=5), lively_readings(table, seed=5))
