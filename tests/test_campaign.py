"""Campaigns: fields by path, the design, seeds, statistics and sensitivity of known results."""

import json
from dataclasses import replace

import numpy as np
import pyarrow.parquet as pq
import pytest
from scenario_files import BENCH_SCENARIO, EFFECTS, HEAD, SEQUENCE

from tiltcal.cli import main
from tiltcal.core.errors import TiltcalError
from tiltcal.core.units import ARCSEC
from tiltcal.validation.campaign.campaign_file import Campaign, CampaignTable, load_campaign
from tiltcal.validation.campaign.campaign_runs import Recorded, content_of, runs_of
from tiltcal.validation.campaign.factors import Factor, with_fields
from tiltcal.validation.campaign.points import count_of, points_of
from tiltcal.validation.campaign.summary import sensitivity_of
from tiltcal.validation.run_statistics import statistics_of
from tiltcal.validation.runs import ParameterRow, Row

DOCUMENT = {
    "seed": 7,
    "site": {"latitude_deg": 40.0},
    "sensor": [{"name": "accel", "rate_hz": 50}, {"name": "incl", "rate_hz": 10}],
    "effect": [
        {"id": "acc_bias", "sensor": "accel", "bias_x_ug": 1.0},
        {"id": "acc_bias", "sensor": "incl", "bias_x_ug": 2.0},
    ],
    "method": [{"name": "six_position", "runs": 3, "accept": {"better_by": 5}}],
}
CAMPAIGN = """\
schema = 1
scenario = "bench.toml"
name = "bias and noise"
runs = 2
[[factor]]
field = "effect.acc_bias.bias_x_ug"
start = 0
stop = 3000
count = 2
[[factor]]
name = "noise"
[[factor.level]]
label = "loud"
set = { "effect.acc_noise.white_ug_rthz" = 100 }
[[factor.level]]
label = "usual"
set = {}
"""


def campaign(*factors: dict, document=DOCUMENT, **keys) -> Campaign:
    table = {"schema": 1, "scenario": "s.toml", "factor": list(factors)} | keys
    return Campaign(CampaignTable.model_validate(table), document)


def uniform(field: str, low: float = 0.0, high: float = 1.0) -> dict:
    return {"field": field, "distribution": "uniform", "low": low, "high": high}


# -- fields ---------------------------------------------------------------------------------------


def test_a_field_is_found_by_number_name_or_id_and_the_rest_stays_as_it_was():
    found = with_fields(
        DOCUMENT,
        {
            "site.latitude_deg": 50.0,
            "sensor.incl.rate_hz": 20,
            "sensor.1.rate_hz": 100,
            "effect.acc_bias[incl].bias_x_ug": 9.0,
            "effect.acc_K2.k2_x_ug_g2": 30.0,
            "effect.acc_noise[accel].white_ug_rthz": 4.0,
            "sequence": [{"action": "rest"}],
        },
    )
    assert found["site"] == {"latitude_deg": 50.0}
    assert [s["rate_hz"] for s in found["sensor"]] == [100, 20]
    assert found["effect"] == [
        DOCUMENT["effect"][0],
        {"id": "acc_bias", "sensor": "incl", "bias_x_ug": 9.0},
        {"id": "acc_K2", "k2_x_ug_g2": 30.0},
        {"id": "acc_noise", "sensor": "accel", "white_ug_rthz": 4.0},
    ]
    assert found["sequence"] == [{"action": "rest"}]
    assert DOCUMENT["site"] == {"latitude_deg": 40.0}
    assert len(DOCUMENT["effect"]) == 2


@pytest.mark.parametrize(
    ("path", "words"),
    [
        ("sight.latitude_deg", "no such part at 'sight'"),
        ("effect.acc_bias.bias_x_ug", "2 parts of this name at 'acc_bias'"),
        ("sensor.gyro.rate_hz", "choose one of 1, accel, 2, incl"),
        ("site.latitude_deg.more", "a value that has no parts at 'more'"),
        ("site.latitude_deg.more.yet", "a value that has no parts at 'more'"),
        ("sensor.rate_hz", "a list of parts at 'rate_hz'"),
    ],
)
def test_a_path_that_leads_nowhere_is_one_message(path, words):
    with pytest.raises(TiltcalError) as refused:
        with_fields(DOCUMENT, {path: 1.0})
    assert words in str(refused.value)


# -- factors and points ---------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("factor", "words"),
    [
        ({"field": "a"}, "give one of values, start, level and distribution"),
        ({"field": "a", "values": [1], "start": 2.0}, "give one of values"),
        ({"values": [1]}, "give field"),
        ({"field": "a", "start": 1.0}, "start needs stop and count"),
        ({"field": "a", "start": 0.0, "stop": 9.0, "count": 3, "log": True}, "log needs"),
        (uniform("a", 2.0, 1.0), "uniform needs low below high"),
        (uniform("a") | {"distribution": "loguniform"}, "loguniform needs low above 0"),
        (uniform("a", 0.5, 2.0) | {"distribution": "integer"}, "integer needs whole numbers"),
        ({"field": "a", "distribution": "normal", "mean": 1.0}, "normal needs mean and sigma"),
        ({"level": [{"label": "x", "set": {}}]}, "give name"),
        ({"field": "a", "values": [1], "colour": "red"}, "Extra inputs"),
    ],
)
def test_a_factor_that_says_too_much_or_too_little_is_refused(factor, words):
    with pytest.raises(ValueError, match=words):
        Factor.model_validate(factor)


def test_levels_and_quantiles_are_what_was_asked_for():
    ends = {"field": "a", "start": 1.0, "stop": 100.0, "count": 3}
    assert [v for v, _ in Factor.model_validate(ends).levels()] == [1.0, 50.5, 100.0]
    assert [v for v, _ in Factor.model_validate(ends | {"log": True}).levels()] == pytest.approx(
        [1.0, 10.0, 100.0]
    )
    p = np.array([0.0, 0.5, 0.975])
    loguniform = uniform("a", 1.0, 100.0) | {"distribution": "loguniform"}
    np.testing.assert_allclose(Factor.model_validate(loguniform).quantiles(p)[:2], [1.0, 10.0])
    integer = Factor.model_validate(uniform("a", 1.0, 4.0) | {"distribution": "integer"})
    drawn = integer.quantiles((np.arange(8) + 0.5) / 8)
    assert [integer.value_of(x) for x in drawn] == [1, 1, 2, 2, 3, 3, 4, 4]
    assert isinstance(integer.value_of(drawn[0]), int)
    normal = {"field": "a", "distribution": "normal", "mean": 3.0, "sigma": 2.0}
    np.testing.assert_allclose(
        Factor.model_validate(normal).quantiles(p)[1:], [3.0, 3.0 + 2 * 1.959964], rtol=1e-6
    )


def test_points_of_a_grid_are_all_combinations_and_share_their_seeds():
    found = campaign(
        {"field": "site.latitude_deg", "values": [0.0, 60.0]},
        {"field": "sensor.accel.rate_hz", "values": [10, 20, 30]},
        runs=2,
    )
    points = list(points_of(found))
    assert len(points) == count_of(found) == 6
    assert [list(p.values.values()) for p in points] == [
        [a, b] for a in (0.0, 60.0) for b in (10, 20, 30)
    ]
    assert all(
        p.document["sensor"][0]["rate_hz"] == p.values["sensor.accel.rate_hz"] for p in points
    )
    runs = list(runs_of(found))
    assert [r.seed for r in runs] == [7, 8] * 6
    assert len({r.key for r in runs}) == 12


def test_the_design_exchanges_one_factor_at_a_time():
    found = campaign(
        uniform("site.latitude_deg", 10.0, 20.0),
        uniform("site.height_m", -1.0, 1.0),
        samples=8,
        runs=3,
    )
    points = list(points_of(found))
    assert len(points) == count_of(found) == 8 * 4
    x = {
        (p.matrix, p.sample): (p.values["site.latitude_deg"], p.values["site.height_m"])
        for p in points
    }
    for j in range(8):
        a, b = x["A", j], x["B", j]
        assert x["AB1", j] == (b[0], a[1])
        assert x["AB2", j] == (a[0], b[1])
    # evenly spread: one value in each eighth
    lat = np.array([x["A", j][0] for j in range(8)])
    assert sorted((lat - 10.0) * 8 // 10) == list(range(8))
    seeds = {}
    for run in runs_of(found):
        seeds.setdefault((run.point.matrix, run.point.sample), []).append(run.seed)
    assert all(seeds["A", j] == seeds["AB1", j] == seeds["AB2", j] for j in range(8))
    every = [s for m in "AB" for j in range(8) for s in seeds[m, j]]
    assert len(set(every)) == len(every) == 48


def test_a_run_is_known_by_what_it_depends_on():
    def key(**changes):
        return content_of(DOCUMENT | changes)

    method = DOCUMENT["method"][0]
    assert key() == key(seed=9) == key(about="words")
    assert key() == key(method=[method | {"runs": 50, "accept": {"better_by": 9}}])
    assert key() != key(method=[method | {"options": {"order": 2}}])
    assert key() != key(site={"latitude_deg": 41.0})


# -- statistics -----------------------------------------------------------------------------------


def row(
    seed: int, error: float, sigma: float = 1.0, verdict: str = "good", tilt: float = 1.0
) -> Row:
    p = ParameterRow("accel.bias_x", "m_s2", 5.0 + error, sigma, 5.0)
    return Row(
        "s", "m", seed, verdict, 1, (p,), (error / sigma) ** 2, 1, 2.0, tilt * ARCSEC, 1.0, 3.0
    )


def test_statistics_of_known_errors():
    errors = [-3.0, -1.0, 0.0, 1.0, 2.0]
    rows = [row(k, e, verdict="good" if k else "suspect") for k, e in enumerate(errors)]
    found = statistics_of(rows, 0.9)
    p = found["parameters"]["accel.bias_x"]
    assert p["mean_error"] == pytest.approx(-0.2)
    assert p["rms_error"] == pytest.approx(np.sqrt(3.0))
    assert p["sd_over_sigma"]["value"] == pytest.approx(np.std(errors, ddof=1))
    assert p["coverage_95"]["count"] == 3  # within 1.96
    # Wilson's interval of 3 in 5, by hand
    z, n, share = 1.959964, 5, 0.6
    middle = (share + z**2 / (2 * n)) / (1 + z**2 / n)
    half = z / (1 + z**2 / n) * np.sqrt(share * (1 - share) / n + z**2 / (4 * n**2))
    assert p["coverage_95"]["interval_95"] == pytest.approx(
        [middle - half, middle + half], rel=1e-5
    )
    assert {v: s["count"] for v, s in found["verdicts"].items()} == {"good": 4, "suspect": 1}


def test_sensitivity_of_a_sum_with_noise_and_an_interaction():
    """y = 3 x1 + x2 + 2 x1 x2 + noise with x uniform in -1 ... 1 and noise of variance 1.

    Variances: 9/3, 1/3, 4/9 and 1; the noise is in no factor's index.
    """
    found = campaign(
        uniform("site.a", -1.0, 1.0), uniform("site.b", -1.0, 1.0), uniform("site.c"), samples=4096
    )
    noise = np.random.default_rng(3).normal(size=2 * 4096)
    finished = []
    for run in runs_of(found):
        x1, x2 = run.point.values["site.a"], run.point.values["site.b"]
        y = 3 * x1 + x2 + 2 * x1 * x2 + noise[run.seed - 7]
        finished.append((run, Recorded((row(run.seed, y, tilt=10.0 + y),), None, 0.0)))
    indices = sensitivity_of(found, finished, 0)["tilt_after_arcsec"]
    total = 3 + 1 / 3 + 4 / 9 + 1
    expected = {"site.a": (3, 3 + 4 / 9), "site.b": (1 / 3, 1 / 3 + 4 / 9), "site.c": (0, 0)}
    for factor, (first, all_of_it) in expected.items():
        for name, value in (("first_order", first), ("total", all_of_it)):
            index = indices[name][factor]
            low, high = index["interval_95"]
            # four standard errors by the interval that is printed
            allowed = 2 * (high - low) + 1e-9
            assert index["value"] == pytest.approx(value / total, abs=allowed), (name, factor)
            assert high - low < 0.15


def test_without_a_result_there_are_no_indices():
    found = campaign(uniform("site.a"), samples=4)
    finished = [(run, Recorded((row(run.seed, 1.0),), None, 0.0)) for run in runs_of(found)]
    assert sensitivity_of(found, finished, 0)["tilt_after_arcsec"] == {"reason": "it never varies"}
    run, recorded = finished[5]
    finished[5] = run, Recorded((replace(recorded.rows[0], error="no light"),), None, 0.0)
    reason = sensitivity_of(found, finished, 0)["tilt_after_arcsec"]["reason"]
    assert reason == "1 of 12 points have no such result"


# -- the command ----------------------------------------------------------------------------------


@pytest.fixture
def bench(here):
    (here / "bench.toml").write_text(BENCH_SCENARIO)
    (here / "c.toml").write_text(CAMPAIGN)
    return here


def test_a_campaign_writes_rows_a_summary_and_a_report(bench, capsys):
    assert main(["campaign", "c.toml", "-o", "out", "-j", "2"]) == 0
    said = capsys.readouterr().out
    assert "8 of 8 runs" in said
    table = pq.read_table(bench / "out" / "results.parquet")
    assert table.column("acc_bias.bias_x_ug").to_pylist() == [0.0] * 4 + [3000.0] * 4
    assert table.column("noise").to_pylist() == ["loud", "loud", "usual", "usual"] * 2
    assert table.column("seed").to_pylist() == [5, 6] * 4
    assert "seconds" not in table.schema.names
    truth = np.array(table.column("accel.bias_x_truth_m_s2"))
    np.testing.assert_allclose(truth, np.repeat([0.0, 3000e-6 * 9.80665], 4), rtol=1e-12)
    about = json.loads(table.schema.metadata[b"tiltcal"])
    assert about["campaign"]["name"] == "bias and noise"
    assert len(about["scenario_sha256"]) == 64
    summary = json.loads((bench / "out" / "results.summary.json").read_text())
    assert [c["values"]["noise"] for c in summary["cells"]] == ["loud", "usual"] * 2
    bound = [c["methods"]["six_position"]["tilt_arcsec"]["bound_rms"] for c in summary["cells"]]
    assert bound[0] / bound[1] == pytest.approx(2.0, rel=0.1)
    page = (bench / "out" / "results.html").read_text()
    assert "bias and noise" in page
    assert "NEES against chi-square" in page
    assert 'src="http' not in page


def test_a_run_of_a_campaign_is_that_of_verify_with_its_seed(bench, capsys):
    vary = ["--effect", "acc_bias.bias_y_ug=-1500:0:2", "--seeds", "3"]
    assert main(["sweep", "bench.toml", *vary, "-o", "s.parquet"]) == 0
    capsys.readouterr()
    method = '[[method]]\nname = "six_position"\nruns = 3\n'
    (bench / "three.toml").write_text(HEAD + EFFECTS + SEQUENCE + method)
    assert main(["verify", "three.toml", "-o", "v"]) == 0
    one = pq.read_table(bench / "s.parquet").slice(0, 3)
    other = pq.read_table(bench / "v" / "runs.parquet")
    shared = [n for n in other.schema.names if n != "seconds"]
    assert one.select(shared).to_pylist() == other.select(shared).to_pylist()


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (("bench.toml", "nowhere.toml"), "nowhere.toml: found no such file"),
        (("runs = 2", "runs = 0"), "runs: Input should be greater than or equal to 1"),
        (("runs = 2", "samples = 3"), "samples: give a power of 2"),
        (("acc_bias.bias_x_ug", "acc_bias.bias_w_ug"), "factor acc_bias.bias_w_ug = 0.0"),
        (("effect.acc_noise", "sensor.gyro"), "field sensor.gyro.white_ug_rthz: found no parts"),
        (("= 100", "= 'much'"), "factor noise = loud"),
    ],
)
def test_a_wrong_campaign_is_refused_before_the_first_run(bench, capsys, change, words):
    (bench / "c.toml").write_text(CAMPAIGN.replace(*change))
    assert main(["campaign", "c.toml", "-o", "out"]) == 2
    assert words in capsys.readouterr().err
    assert not (bench / "out" / "results.journal").exists()


def test_a_program_needs_permission(bench, capsys):
    program = 'command = ["python", "x.py"]'
    (bench / "bench.toml").write_text(BENCH_SCENARIO.replace('name = "six_position"', program))
    assert main(["campaign", "c.toml", "-o", "out"]) == 2
    assert "add --allow-commands" in capsys.readouterr().err


def test_a_scenario_without_a_method_is_refused(bench, capsys):
    (bench / "bench.toml").write_text(HEAD + EFFECTS + SEQUENCE)
    assert main(["campaign", "c.toml", "-o", "out"]) == 2
    assert "found no [[method]]" in capsys.readouterr().err


@pytest.mark.parametrize(
    "words", ["acc_K2.k2_x_ug_g2", "acc_K2.k2_x_ug_g2=0:1", "a=0:x:3", "a=0:1:0"]
)
def test_a_range_is_start_stop_and_count(bench, capsys, words):
    assert (bench / "bench.toml").exists()
    assert main(["sweep", "bench.toml", "--effect", words, "-o", "x.parquet"]) == 2
    assert "need PATH=START:STOP:COUNT" in capsys.readouterr().err


def test_every_run_may_have_an_instrument_of_its_own(bench):
    """Grades draw an instrument by their seed."""
    grades = BENCH_SCENARIO.replace("seed = 5", 'seed = 5\ngrade = "mid_mems"')
    (bench / "bench.toml").write_text(grades.replace(EFFECTS, ""))
    (bench / "c.toml").write_text(
        'schema = 1\nscenario = "bench.toml"\nsamples = 4\n[[factor]]\nfield = "grade_seed"\n'
        'distribution = "integer"\nlow = 1\nhigh = 1000000\n'
    )
    assert main(["campaign", "c.toml", "-o", "out"]) == 0
    table = pq.read_table(bench / "out" / "results.parquet")
    truth = table.column("accel.bias_x_truth_m_s2").to_pylist()
    seeds = table.column("grade_seed").to_pylist()
    assert len(set(seeds)) == len(set(truth)) == 8
    assert all(s % 1 == 0 for s in seeds)


def test_a_method_that_fails_is_a_row_and_is_named(bench, capsys):
    (bench / "bench.toml").write_text(BENCH_SCENARIO.replace("six_position", "two_position"))
    assert main(["campaign", "c.toml", "-o", "out"]) == 0
    said = capsys.readouterr().out
    assert said.count("no result: two_position") == 8
    table = pq.read_table(bench / "out" / "results.parquet")
    assert set(table.column("verdict").to_pylist()) == {"error"}
    assert all(table.column("error").to_pylist())


def test_a_campaign_names_its_scenario_from_its_own_folder(here):
    (here / "below").mkdir()
    (here / "below" / "bench.toml").write_text(BENCH_SCENARIO)
    (here / "below" / "c.toml").write_text(CAMPAIGN)
    assert load_campaign(here / "below" / "c.toml").document["name"] == "bench"
