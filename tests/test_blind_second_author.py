"""The second author's physics and ordinary recordings: what is concealed can be seen and has no
listed form; what is ordinary conceals nothing.
"""

from dataclasses import replace

import numpy as np
import pytest
from blind.cases import _clean, _draw, make
from blind.catalogue import listed, unlisted
from blind.files import write_recording
from blind.judge import expected
from blind.laboratory import KINDS, Lab, Noise, draw
from blind.nuisance import Nuisance
from blind.oracle import Oracle
from blind.second_author import second_author
from blind.second_author_nulls import NULLS, SEEN_SIGMA
from blind.second_author_terms import by_dwell, heat, hinge, total_rate, way
from blind.spec import Spec
from blind.world import Past, felt, readings
from statistics_helpers import rng_of

from tiltcal.effects import CATALOGUE

COORDINATES = {
    *("table_outer", "table_middle", "table_inner", "tilt", "rate", "time"),
    *("temperature", "frequency", "sample", "move"),
}
STAGES = {"environment", "table", "mount", "sensor", "electronics", "timing", "data"}
DRAWN_IN = ("dual_tumble", "three_rates", "placing_sweep")
LABS, TRIES = 12, 6


def every_spec() -> dict[str, Spec]:
    return {spec.id: spec for kind in KINDS for spec in second_author(draw(rng_of(kind), kind, 1))}


def quiet(lab: Lab, nuisance: Nuisance | None) -> Lab:
    """The laboratory with one nuisance and white noise besides."""
    return replace(lab, noise=Noise(0.0, 1, 0.0, 0.0, 0.0, 0.0, 1e-9, nuisance))


# --------------------------------------------------------------------------------------------------
# unlisted physics


def test_there_are_many_of_all_stages_and_none_is_listed_or_the_first_authors():
    specs = every_spec()
    first = {s.id for kind in KINDS for s in unlisted(draw(rng_of(kind), kind, 1))}
    names = {s.id for kind in KINDS for s in listed(draw(rng_of(kind), kind, 1))}
    assert len(specs) >= 25
    assert not set(specs) & (first | names | set(CATALOGUE))
    assert {s.stage for s in specs.values()} >= {"environment", "table", "mount", "sensor"}
    for spec in specs.values():
        assert not spec.listed
        assert spec.where
        assert set(spec.where) <= COORDINATES, spec.id
        assert spec.stage in STAGES


def test_every_one_can_be_drawn_and_lies_outside_what_may_be_adjusted_or_is_listed():
    left, seen = set(every_spec()), {}
    for n in range(LABS):
        kind = DRAWN_IN[n % len(DRAWN_IN)]
        rng = np.random.default_rng([n, 3])
        lab = draw(rng, kind, 1)
        oracle = Oracle(lab, rng)
        for spec in second_author(lab):
            tries = TRIES if spec.id in left else 0
            draws = (_draw(rng, oracle, spec, "unlisted") for _ in range(tries))
            hidden = next((h for h in draws if h), None)
            if hidden is None:
                continue
            signal = oracle.signal([hidden.physics])[:, :, None]
            r = oracle.residual(signal)
            share = float((r**2).sum() / (oracle.white(signal) ** 2).sum())
            nearest = min(hidden.found.left.values(), default=np.inf) / hidden.found.lam
            seen[spec.id] = (hidden.found.lam, share, nearest)
            left.discard(spec.id)
        if not left:
            break
    assert not left
    assert min(lam for lam, _, _ in seen.values()) >= 60
    assert np.median([lam for lam, _, _ in seen.values()]) > 200
    assert max(lam for lam, _, _ in seen.values()) < 10**3.8 * 1.5
    assert min(share for _, share, _ in seen.values()) > 0.005
    assert min(nearest for _, _, nearest in seen.values()) >= 0.2


def test_memories_are_of_the_past_only():
    """What happens later changes nothing before it."""
    lab = draw(rng_of("past"), "placing_sweep", 1)
    half = len(lab.track.moves) // 2
    cut = lab.track.moves[half].start_s
    moved = tuple(
        m if m.start_s < cut else replace(m, from_rad=m.to_rad, to_rad=m.from_rad)
        for m in lab.track.moves
    )
    other = replace(lab, track=replace(lab.track, moves=moved))
    t = np.linspace(1.0, cut - 0.5, 60)
    for spec in second_author(lab):
        shape = spec.shapes(rng_of(spec.id), lab)[0]
        p = np.full(len(spec.names), spec.plausible * spec.unit)
        told = []
        for one in (lab, other):
            own = next(s for s in second_author(one) if s.id == spec.id)
            told.append(readings(one, [own.physics(p, shape)], t, Past(one)))
        assert told[0] == pytest.approx(told[1], abs=1e-9), spec.id


def test_the_courses_of_history_are_what_they_are_called():
    lab = draw(rng_of("history"), "placing_sweep", 1)
    past = Past(lab)
    gone = sum(abs(m.to_rad - m.from_rad) for m in lab.track.moves)
    assert way(past)[-1] == pytest.approx(gone, rel=1e-3)
    assert total_rate(past).max() == pytest.approx(np.abs(past.state.w[:, 1]).max(), rel=1e-2)
    warm = heat(past, 10.0)
    assert 0 <= warm.min() < warm.max() < (total_rate(past) ** 2).max()
    numbers = np.arange(len(lab.track.dwells), dtype=float)
    begun = by_dwell(past, numbers, 1e-6)
    middle = np.array([(a + b) / 2 for a, b in lab.track.dwells])
    assert np.interp(middle, past.grid, begun) == pytest.approx(numbers)
    assert hinge(np.array([-1.0, 1.0]), 1e-3) == pytest.approx([0, 1])


# --------------------------------------------------------------------------------------------------
# ordinary recordings


def nuisance_of(name: str, lab: Lab) -> Nuisance:
    made = NULLS[name](rng_of(name), lab)
    assert made is not None
    return made


@pytest.mark.parametrize("name", sorted(NULLS))
def test_a_nuisance_adds_nothing_of_its_own(name):
    lab = draw(rng_of("null"), "placing_sweep", 1)
    own = nuisance_of(name, lab)
    t = np.arange(0, 400, dtype=float) * 0.04 + 20
    if own.white and name != "student":
        nothing = np.zeros((len(t), len(lab.channels)))
        assert (own.white(rng_of("w"), lab, t, nothing) == 0).all()
    rows = _clean(rng_of("x"), quiet(lab, own), ())
    assert rows.y == pytest.approx(readings(lab, (), rows.t, Past(lab)), abs=1e-9)
    assert (np.diff(rows.t) > 0).all()
    assert own.stamps or own.logged or own.empty or own.white or own.coarse


@pytest.mark.parametrize("kind", ["dual_tumble", "six_any"])
def test_an_ordinary_case_has_no_effect_and_is_the_same_every_time(kind):
    a, b = (make(kind, "null", 1, [7, 1, 2], author="second") for _ in range(2))
    assert (a.rows.y == b.rows.y).all()
    assert a.truth["effects"] == []
    assert a.truth["nuisance"].startswith("n_")
    assert expected(a.truth) == (("match", "cannot_tell") if kind == "six_any" else ("match",))
    other = make(kind, "null", 1, [7, 1, 2])
    assert other.truth["nuisance"] is None


@pytest.fixture(scope="module")
def white():
    """Name -> what a nuisance makes of white noise, stamps, laboratory."""
    lab = draw(rng_of("white"), "dual_tumble", 1)
    t = np.arange(0, lab.track.end_s, 1 / lab.rate_hz)
    e = rng_of("e").standard_normal((len(t), 3))

    def made(name: str) -> np.ndarray:
        own = nuisance_of(name, lab)
        assert own.white
        return own.white(rng_of("made"), lab, t, e.copy())

    return made, e, t, lab


def test_sizes_of_the_noise_follow_what_they_are_said_to_follow(white):
    made, e, t, lab = white
    assert sorted((made("unequal") / e).mean(0)) == pytest.approx([1, 1, 3])
    growth = made("growing") / e
    assert growth[[0, -1], 0] == pytest.approx([1, 2], rel=1e-2)
    state = felt(lab, (), t, Past(lab))
    still = lab.track.since_move(t)[0] > 0
    by_rate, by_load, loud = (made(n)[:, 0] / e[:, 0] for n in ("of_rate", "of_load", "bursts"))
    assert by_rate[still] == pytest.approx(1, abs=1e-2)
    assert by_rate.max() > 1.5
    level = np.hypot(*state.f[:, :2].T) / lab.gravity
    assert by_load == pytest.approx(1 + 1.5 * level)
    assert loud[still] == pytest.approx(1)
    assert 3 <= loud.max() <= 6
    warm = made("of_temperature")[:, 0] / e[:, 0]
    assert warm[np.argmax(state.T)] == pytest.approx(warm.max())


def test_kinds_of_the_noise_are_what_they_are_called(white):
    made, e, _t, _lab = white
    n = len(e)
    x = made("correlated")[:, 1]
    assert 0.2 - 4 / np.sqrt(n) < np.corrcoef(x[1:], x[:-1])[0, 1] < 0.4 + 4 / np.sqrt(n)
    assert x.std() == pytest.approx(1, abs=4 / np.sqrt(n))
    shared = np.corrcoef(made("common").T)[np.triu_indices(3, 1)]
    assert 0.35 < max(shared) < 0.85
    assert sorted(shared)[1] < 0.1
    tails = made("student").ravel()
    assert 4.5 < np.abs(tails).max() <= 6
    assert np.mean(tails**4) / np.mean(tails**2) ** 2 > 4  # of the normal: 3


def test_stamps_are_true_or_rounded_so_finely_that_it_hardly_shows():
    lab = draw(rng_of("stamps"), "placing_sweep", 1)
    t = np.arange(0, lab.track.end_s, 0.04)
    for name in ("ticking", "jittered"):
        own = nuisance_of(name, lab)
        assert own.stamps
        assert own.written is None
        assert 1e-4 < np.abs(own.stamps(rng_of("s"), t) - t).max() < 0.04
    own = nuisance_of("rounded", lab)
    assert own.stamps
    assert own.written
    taken = own.stamps(rng_of("s"), t)
    late = own.written(taken) - taken
    assert np.abs(late).max() > 1e-6
    slope = np.gradient(felt(lab, (), taken, Past(lab)).f, taken, axis=0)
    moving = np.abs(slope).max(1) > 0.05 * np.abs(slope).max()
    error = slope[moving] * late[moving, None]
    assert np.sqrt((error**2).mean(0)).max() < 1.1 * SEEN_SIGMA * lab.sensors[0].sigma


def test_cells_rows_and_digits_go_missing_as_they_are_said_to(tmp_path):
    lab = draw(rng_of("cells"), "dual_tumble", 1)
    cells = nuisance_of("sparse", lab).empty(rng_of("c"), 4000, 3).mean(0)
    assert sorted(cells > 0) == [False, False, True]
    assert 0.15 < cells.max() < 0.55
    block = nuisance_of("blocks", lab).empty(rng_of("c"), 4000, 3)
    assert (block.all(1) == block.any(1)).all()
    assert 40 <= block.any(1).sum() <= 480
    t = np.arange(0, lab.track.end_s, 0.04)
    kept = t[nuisance_of("pause", lab).logged(t)]
    assert 4 < np.diff(kept).max() < 12.1
    assert (np.diff(kept) > 0.05).sum() == 1
    steps = {}
    for name in ("digits", "bursts"):
        own = quiet(lab, nuisance_of(name, lab))
        write_recording(tmp_path / "r.csv", own, _clean(rng_of("x"), own, ()), rng_of("w"))
        cell = (tmp_path / "r.csv").read_text().splitlines()[5].split(",")[3]
        steps[name] = len(cell.partition(".")[2])
    assert steps["digits"] == steps["bursts"] - 1
