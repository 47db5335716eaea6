"""A line of names that has one too few or too many for the columns."""

import tomllib

import numpy as np
import pytest

from tiltcal.recordings.proposal.propose import propose_mapping

N = 900
RNG = np.random.default_rng(4)
FACES = np.vstack([np.eye(3), -np.eye(3)])[np.arange(N) * 6 // N]
FORCE = 9.8 * FACES + RNG.normal(0, 0.01, (N, 3))
WARM = 25 + np.cumsum(RNG.normal(0, 0.01, N))
TIME = 1.4e9 + np.arange(N) / 50


def proposal_of(path, header, *columns, separator=","):
    rows = [separator.join(f"{v:.14g}" for v in row) for row in zip(*columns, strict=True)]
    path.write_text("\n".join([header, *rows]) + "\n")
    return propose_mapping(path)


def columns_of(proposal):
    return {c["from"]: c["to"] for c in tomllib.loads(proposal.toml())["column"]}


@pytest.mark.parametrize("separator", [",", " "])
def test_a_first_column_without_a_name_is_shown_by_the_times_after_it(separator, tmp_path):
    header = separator.join(["timestamp", "temp", "acc_x", "acc_y", "acc_z"])
    proposal = proposal_of(
        tmp_path / "a.txt", "# " + header, np.arange(N), TIME, WARM, *FORCE.T, separator=separator
    )
    assert any("line 1 holds 5 names for 6 columns" in doubt for doubt in proposal.doubts)
    assert proposal.time[""].channel.source == 2
    assert columns_of(proposal) == {
        4: "accel_x_m_s2", 5: "accel_y_m_s2", 6: "accel_z_m_s2", 3: "temperature_degC",
    }  # fmt: skip


def test_names_on_the_other_side_of_the_time_are_not_given(tmp_path):
    # the missing name is before or after `temp`: which of the two columns it names is not shown
    proposal = proposal_of(
        tmp_path / "a.csv", "temp,time,acc_z,acc_y,acc_x", WARM + 5, WARM, TIME, *FORCE.T[::-1]
    )
    assert columns_of(proposal) == {4: "accel_z_m_s2", 5: "accel_y_m_s2", 6: "accel_x_m_s2"}


def test_a_name_missing_after_the_time_leaves_the_names_after_it_open(tmp_path):
    proposal = proposal_of(
        tmp_path / "a.csv", "temp,time,acc_x,acc_y,acc_z", WARM, TIME, RNG.normal(size=N), *FORCE.T
    )
    found = columns_of(proposal)
    assert found[1] == "temperature_degC"
    assert {k for k, to in found.items() if to.startswith("accel")} <= {4, 5, 6}
    assert any("accel: that its columns are x, y and z" in doubt for doubt in proposal.doubts)


def test_a_name_too_many_before_the_time_is_seen(tmp_path):
    proposal = proposal_of(tmp_path / "a.csv", "id,t,acc_x,acc_y,acc_z", TIME, *FORCE.T)
    assert any("line 1 holds 5 names for 4 columns" in doubt for doubt in proposal.doubts)
    assert columns_of(proposal) == {2: "accel_x_m_s2", 3: "accel_y_m_s2", 4: "accel_z_m_s2"}
    assert proposal.time[""].channel.source == 1


def test_without_a_proof_columns_go_by_number(tmp_path):
    # both columns that may be the time run forward
    proposal = proposal_of(
        tmp_path / "a.csv", "time,acc_x,acc_y,acc_z", np.arange(N) / 50, TIME, *FORCE.T
    )
    assert any("names for 5 columns: columns go by number" in d for d in proposal.doubts)
    assert all(isinstance(source, int) for source in columns_of(proposal))
    assert any("x, y and z in this order" in doubt for doubt in proposal.doubts)


@pytest.mark.parametrize(("header_end", "row_end"), [("", ","), (",", ""), (",", ",")])
def test_a_separator_at_the_end_of_lines_is_no_name(header_end, row_end, tmp_path):
    rows = [f"{t:.3f},{x:.4f},{y:.4f},{z:.4f}{row_end}" for t, (x, y, z) in zip(TIME, FORCE)]
    path = tmp_path / "a.csv"
    path.write_text("\n".join([f"t,acc_x,acc_y,acc_z{header_end}", *rows]) + "\n")
    proposal = propose_mapping(path)
    assert columns_of(proposal) == {f"acc_{a}": f"accel_{a}_m_s2" for a in "xyz"}
    assert not any("names for" in doubt for doubt in proposal.doubts)
