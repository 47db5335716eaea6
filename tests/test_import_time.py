"""The time of foreign logs: columns by their names, repeated and coarse stamps, local dates, rates
in a line of text.
"""

from datetime import datetime, timedelta

import numpy as np
import pytest

from tiltcal.cli import main
from tiltcal.recordings.foreign_files import import_file
from tiltcal.recordings.mapping import load_mapping, parse_mapping
from tiltcal.recordings.proposal.propose import propose_mapping
from tiltcal.recordings.proposal.time_axis import stated_rate, usual_step

N = 1200
FORCE = np.tile([0.3, -0.2, 9.8], (N, 1)) + np.random.default_rng(8).normal(0, 0.02, (N, 3))


def log(path, name, stamps, before=()):
    """A log of an accelerometer whose first column is the time."""
    rows = [f"{t},{x:.5f},{y:.5f},{z:.5f}" for t, (x, y, z) in zip(stamps, FORCE, strict=True)]
    path.write_text("\n".join([*before, f"{name},acc_x,acc_y,acc_z", *rows]) + "\n")
    return path


def found_in(proposal):
    return {f.kind: f for f in proposal.findings}


@pytest.mark.parametrize("name", ["stamp", "time_s", "t"])
@pytest.mark.parametrize("zero", [0.0, 1593335798.0])
def test_a_column_named_as_time_is_the_time_though_stamps_repeat(name, zero, tmp_path):
    times = zero + np.arange(N) / 50
    times[3::4] = times[2::4]
    path = log(tmp_path / "a.csv", name, [f"{t:.6f}" for t in times])
    proposal = propose_mapping(path)
    assert 'unit = "s"' in proposal.toml()
    repeated = found_in(proposal)["time_repeated"]
    assert (repeated.count, repeated.repair) == (N // 4, "drop_repeated_time")
    assert "# found: time_s: a stamp is repeated, 300 times" in proposal.toml()
    mapping = parse_mapping('repair = ["drop_repeated_time"]\n' + proposal.toml(), "m")
    recording = import_file(path, mapping).recording.require_increasing()
    assert len(recording) == N * 3 // 4


def test_a_named_column_that_goes_back_everywhere_or_never_moves_is_no_time(tmp_path):
    for stamps in (np.zeros(N), np.random.default_rng(1).normal(size=N), np.arange(N) > 600):
        path = log(tmp_path / "a.csv", "time", [f"{t:.3f}" for t in np.asarray(stamps, float)])
        assert propose_mapping(path).time[""].channel is None


def test_the_usual_step_is_the_mean_where_most_stamps_repeat():
    assert usual_step(np.floor(np.arange(3001) / 60)) == pytest.approx(1 / 60)
    assert usual_step(np.array([0, 1, 1, 2, 3, 9.0])) == 1.0
    assert usual_step(np.zeros(5)) == 0.0


@pytest.mark.parametrize("numbers", [False, True])
def test_stamps_of_whole_seconds_are_spread_on_request(numbers, tmp_path):
    start = datetime(2018, 1, 21, 13, 26)
    stamps = [int(k / 60) if numbers else start + timedelta(seconds=k // 60) for k in range(N)]
    path = log(tmp_path / "a.csv", "time", stamps)
    proposal = propose_mapping(path)
    assert found_in(proposal)["time_coarse"].repair == "spread_time"
    assert "rows at even times between them are 60 Hz; --repair spread_time" in proposal.toml()
    assert "drop_repeated_time" not in proposal.toml()
    assert proposal.time[""].rate == pytest.approx(60, rel=0.06)
    (tmp_path / "m.toml").write_text(proposal.toml())
    mapping = load_mapping(tmp_path / "m.toml").model_copy(update={"repair": ("spread_time",)})
    imported = import_file(path, mapping)
    assert {f.kind for f in imported.findings} == {"time_coarse"}
    np.testing.assert_allclose(np.diff(imported.recording.time), 1 / 60, rtol=1e-6)


def dates(form, start, mark="."):
    """Dates at 50 Hz as a logger writes them."""
    for k in range(N):
        when = start + timedelta(milliseconds=20 * k)
        yield when.strftime(form) + f"{mark}{when.microsecond // 1000:03d}"


@pytest.mark.parametrize(
    ("form", "start", "unit"),
    [
        ("%d/%m/%Y %H:%M:%S", datetime(2024, 12, 21, 17, 41), "dmy"),
        ("%m/%d/%Y %H:%M:%S", datetime(2024, 12, 21, 17, 41), "mdy"),
        ("%d.%m.%Y %H:%M:%S", datetime(2024, 12, 1, 17, 41), "dmy"),
        ("%d/%m/%Y %H:%M:%S", datetime(2024, 11, 12, 23, 59, 50), "dmy"),
        ("%d/%m/%Y %H:%M:%S", datetime(2024, 11, 12, 17, 41), "?"),
        ("%d-%m-%Y %H:%M:%S", datetime(2024, 11, 12, 17, 41), "?"),
        ("%Y/%m/%d %H:%M:%S", datetime(2024, 12, 1, 17, 41), "iso"),
    ],
)
def test_dates_with_the_year_last_are_read_where_their_order_is_known(form, start, unit, tmp_path):
    path = log(tmp_path / "a.csv", "Timestamp", dates(form, start))
    text = propose_mapping(path).toml()
    assert f'unit = "{unit}"' in text
    assert ("the order of day and month in " in text) == (unit == "?")
    mapping = parse_mapping(text.replace('"?"', '"dmy"'), "m")
    recording = import_file(path, mapping).recording
    np.testing.assert_allclose(np.diff(recording.time), 0.02, atol=1e-6)
    zero = float(recording.metadata["time zero"].removesuffix(" s"))
    seconds = (start - datetime(1970, 1, 1)).total_seconds()
    assert zero + recording.time[0] == pytest.approx(seconds, abs=1e-3)


def test_a_local_date_under_iso_is_refused_with_the_units_that_read_it(tmp_path, capsys):
    path = log(tmp_path / "a.csv", "when", dates("%d/%m/%Y %H:%M:%S", datetime(2024, 12, 21)))
    mapping = '[time]\ncolumn = "when"\nunit = "iso"\n[[column]]\nfrom = "acc_x"\nto = "a_x_g"\n'
    (tmp_path / "m.toml").write_text(mapping)
    words = ["import", str(path), "--map", str(tmp_path / "m.toml"), "-o", str(tmp_path / "r.csv")]
    assert main(words) == 2
    assert "time.unit to iso, dmy or mdy" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("line", "rate"),
    [
        (
            "--- Data File Created By Logger v6 date format d/MM/yyyy at 60 Hz  Filter Normal ---",
            60,
        ),
        ("# recorded at 0.4 kHz", 400),
        ("low pass filter at 60 Hz", None),
        ("sampled at 60 Hz, stored at 30 Hz", None),
        ("mains 50 Hz", None),
    ],
)
def test_a_rate_in_a_line_of_text_is_taken_with_the_line_as_its_reason(line, rate, tmp_path):
    stated = stated_rate({}, ["first", line])
    assert (None if stated is None else stated.rate) == rate
    path = tmp_path / "a.csv"
    rows = [f"{x:.5f},{y:.5f},{z:.5f}" for x, y, z in FORCE]
    path.write_text("\n".join([line, "acc_x,acc_y,acc_z", *rows]) + "\n")
    time = propose_mapping(path).time[""]
    assert time.rate == rate
    assert rate is None or "line 1 states 'at " in time.reason


@pytest.mark.parametrize(("unit", "factor"), [("ns", 1e9), ("us", 1e6), ("ms", 1e3)])
def test_findings_of_a_proposal_are_in_seconds(unit, factor, tmp_path):
    times = np.arange(N) / 50
    times[600:] += 2.0
    counts = 1_700_000_000 * int(factor) + np.round(times * factor).astype(np.int64)
    path = log(tmp_path / "a.csv", f"stamp_{unit}", counts)
    gap = found_in(propose_mapping(path))["gap"]
    assert "about 100 samples are missing at 0.02 s a sample" in gap.statement
