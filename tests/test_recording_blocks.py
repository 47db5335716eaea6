"""Blocks: every one can be done on its table, and one place has the words."""

import pytest

from tiltcal.design.recording_blocks import (
    DESCRIPTIONS,
    REMOUNT,
    TableLimits,
    candidates,
    describe_block,
    within,
)
from tiltcal.setup.schedule import build_schedule
from tiltcal.setup.sequence_files import sequence_text
from tiltcal.setup.setup import Rig

FREE = {"outer": (0.0, 360.0), "middle": (0.0, 360.0), "inner": (0.0, 360.0)}


def table_of(kind: str, **more: object) -> TableLimits:
    rig = Rig(table=kind)  # type: ignore[arg-type]
    return TableLimits(rig, {n: FREE[n] for n in rig.axis_names}, **more)  # type: ignore[arg-type]


@pytest.mark.parametrize("kind", ["vertical", "placing", "dual", "three"])
def test_every_block_can_be_written_for_its_table(kind: str) -> None:
    table = table_of(kind)
    blocks = list(candidates(table))
    assert len({b.name for b in blocks}) == len(blocks)
    for block in blocks:
        assert sequence_text(block.steps, table.rig)
        assert 20 < block.seconds(table.rig) < 600
        assert "{" not in block.description


def test_a_narrow_reach_is_kept_by_the_blocks_that_are_left() -> None:
    table = TableLimits(
        Rig(table="placing"), {"outer": (-45.0, 45.0)}, visited=((-45.0,), (0.0,), (45.0,))
    )
    kept = [b for b in candidates(table) if within(b, table)]
    assert {"circle outer", "reverse outer", "spin outer", "repeat"} <= {b.name for b in kept}
    for block in kept:
        assert all(-45 <= s.angles_deg.get("outer", 0.0) <= 45 for s in block.steps)


def test_a_block_out_of_reach_is_known() -> None:
    wide = next(b for b in candidates(table_of("placing")) if b.name == "circle outer")
    assert not within(wide, TableLimits(Rig(table="placing"), {"outer": (0.0, 90.0)}))


def test_flipped_poses_are_the_same_attitude_of_the_body() -> None:
    import numpy as np

    from tiltcal.core.frames import rotation

    flip = next(b for b in candidates(table_of("dual")) if b.name == "flip")
    up = []
    for step in flip.steps:
        R = rotation("x", np.radians(step.angles_deg.get("outer", 0.0))) @ rotation(
            "z", np.radians(step.angles_deg.get("inner", 0.0))
        )
        up.append(R.T @ [0, 0, 1])
    np.testing.assert_allclose(up[::2], up[1::2], atol=1e-12)


def test_remounting_costs_its_time() -> None:
    table = table_of("placing")
    blocks = {b.name: b for b in candidates(table)}
    remount = blocks["remount Rz(180)"]
    assert remount.remounts == 1
    start, end = build_schedule(remount.steps, table.rig).times
    assert remount.seconds(table.rig) == end - start + REMOUNT


def test_the_words_of_a_tie_breaker_are_those_of_a_block() -> None:
    from tiltcal.design.identifiability import tie_breaker

    assert tie_breaker("table_backlash", "table_encoder_2rev") == describe_block("reverse")
    assert tie_breaker("acc_K2", "acc_K3") == describe_block("tumble")
    assert tie_breaker("table_encoder_eccentricity", "acc_K3") == describe_block("remount")
    assert tie_breaker("data_latency", "acc_bandwidth") == describe_block("ramp")
    assert "{" not in "".join(describe_block(kind) for kind in DESCRIPTIONS)
