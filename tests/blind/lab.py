"""A laboratory behind a command: ``python -m blind.lab CASE.json SEQUENCE.csv RECORDING.csv`` runs
a sequence on a concealed table.

CASE.json holds no physics, only the numbers that the concealed case is drawn from: ``conceal``
draws one whose first recording is poor (a few poses of a tumble, a placing sweep of a quarter turn)
and leaves more than one name possible.
"""

import hashlib
import json
import sys
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from blind import cases
from blind.cases import Hidden
from blind.catalogue import bound, listed, settled
from blind.faults import Rows
from blind.files import write_recording, write_scenario
from blind.judge import CONTAINED
from blind.laboratory import Lab, draw, mean_temperature, room
from blind.motion import Plan, Track
from blind.oracle import Found, Oracle
from blind.rotations import DEG
from blind.spec import Shape, Spec
from blind.steps import COMING, mount_of, read_steps, track_of
from blind.world import Physics

KINDS = ("dual_tumble", "placing_sweep")
TRIES = 400
LEAST, MOST = 100.0, 5e4  # non-centrality in the first recording
CLEAR = 50.0  # separated non-centrality on a rich sequence: nobody could miss it
# and this share of the signal: no law has its textbook form to a thousandth, and no diagnosis
# should count on it
UNLIKE = 0.005


@dataclass(frozen=True)
class Concealed:
    """A laboratory with something in it.

    Attributes:
        lab: as the first recording had it.
        hidden: what is concealed.
        first: its rows.
        key: what it was drawn from.
    """

    lab: Lab
    hidden: Hidden
    first: Rows
    key: tuple[int, ...]


def poor(rng: np.random.Generator, kind: str) -> Track:
    """A first sequence that tells little: one circle, one corner of the sphere, or a quarter
    turn.
    """
    rate, dwell = rng.uniform(15, 30) * DEG, rng.uniform(2.5, 3.5)
    if kind == "placing_sweep":
        up = np.arange(0, 90 + 1e-6, 5.0)
        return _through(
            [[a] for a in (up if rng.random() < 0.5 else [*up, *up[::-1]])], rate, dwell
        )
    way = rng.integers(3)
    if way == 0:  # the outer circle at one inner angle
        inner = float(rng.choice([0.0, 30.0, 45.0]))
        return _through([[a, inner] for a in np.arange(0, 360 + 1e-6, 15.0)], rate, dwell)
    if way == 1:  # few inner angles, one direction
        poses = [[a, b] for b in (0.0, 90.0) for a in np.arange(0, 360, 30.0)]
        return _through(poses, rate, dwell)
    # half of the sphere
    poses = [
        [a, b] for a in (0.0, 45.0, 90.0, 135.0) for b in (0.0, 60.0, 120.0, 180.0, 240.0, 300.0)
    ]
    return _through(poses, rate, dwell)


def rich() -> Track:
    """What would tell nearly everything: tilts and turns over the whole circle in both orders,
    turns at two rates, a rest.
    """
    tilts, turns = np.arange(0, 360, 45.0), np.arange(0, 360, 60.0)
    poses = [[a, b] for k, a in enumerate(tilts) for b in (turns if k % 2 else turns[::-1])]
    return _through([*poses, *poses[::-1], [360.0, 0.0], [0.0, 360.0], [0.0, 0.0]], 40 * DEG, 3.0)


def _through(poses: Sequence[Sequence[float]], rate: float, dwell: float) -> Track:
    # play and friction know where the first pose was come to from
    plan = Plan([(x - COMING) * DEG for x in poses[0]])
    for pose in poses:
        plan.go({k: x * DEG for k, x in enumerate(pose)}, rate)
        plan.dwell(dwell)
    return plan.track()


class Blindfolded(Oracle):
    """Draws like an oracle and asks for no rivals: the case has been judged before."""

    def judge(
        self, spec: Spec, shape: Shape, physics: Physics, beside: Sequence[np.ndarray] = ()
    ) -> Found:
        """How far it stands out, and nothing else."""
        r = self.residual(self.signal([physics])[:, :, None])[:, 0]
        return Found(float(r @ r), 0.0, {}, {})


def conceal(kind: str, key: Sequence[int]) -> Concealed:
    """Draw until a case is ambiguous at first and would not be after a rich sequence. ``key`` of
    the answer: with the try.

    Raises:
        RuntimeError: no draw gave one.
    """
    for attempt in range(TRIES):
        case = drawn(kind, [*key, attempt], Oracle)
        if (
            case
            and case.hidden.found.inseparable
            and LEAST < case.hidden.found.lam < MOST
            and _clear(case)
        ):
            return case
    raise RuntimeError(f"{kind} {list(key)}: no case is ambiguous")


def drawn(kind: str, key: Sequence[int], judge: type[Oracle]) -> Concealed | None:
    """One draw; None where it cannot be seen."""
    rng = np.random.default_rng([*key, KINDS.index(kind)])
    lab = draw(rng, kind, 1)
    if lab.sensors[0].kind != "accelerometer":
        return None
    track = poor(rng, kind)
    lab = replace(lab, track=track, room=room(rng, track.end_s), past={})
    lab = replace(lab, T0=mean_temperature(lab))
    specs = [s for s in listed(lab) if s.drawn and s.later == "same"]
    hidden = cases._draw(rng, judge(lab, rng), cases._pick(rng, specs), "single")
    if hidden is None:
        return None
    return Concealed(
        lab, hidden, cases._noisy(rng, lab, cases._clean(rng, lab, [hidden.physics])), tuple(key)
    )


def _clear(case: Concealed) -> bool:
    """Whether a rich sequence leaves one name only of those that the first one leaves."""
    if case.hidden.spec.id in CONTAINED:
        return False
    rng, lab, hidden = np.random.default_rng(case.key), case.lab, case.hidden
    up = [[a] for a in np.arange(0, 361, 15.0)]
    track = (
        rich() if len(lab.axes) > 1 else _through([*up, *up[::-1], [360.0], [0.0]], 30 * DEG, 3.0)
    )
    other = replace(lab, track=track, room=replace(room(rng, track.end_s), mean=lab.T0), past={})
    oracle = Oracle(other, rng)
    spec, shape = bound(hidden.spec, other), settled(hidden.spec, hidden.shape)
    signal = oracle.residual(oracle.signal([spec.physics(hidden.p, shape)])[:, :, None])[:, 0]
    for rival in listed(other):
        if rival.id in hidden.found.inseparable:
            grid = oracle.shapes(rival)
            columns = [oracle.residual(oracle.columns(rival, s)) for s in grid] + oracle.alike(
                rival, grid, shape
            )
            if oracle.left_by(columns, signal) < max(CLEAR, UNLIKE * float(signal @ signal)):
                return False
    return True


def record(case: Concealed, sequence: Path, recording: Path) -> None:
    """Run a sequence file and write the recording."""
    rows = read_steps(sequence)
    words, R = mount_of(rows)
    track = track_of(rows, len(case.lab.axes))
    digest = hashlib.sha256(sequence.read_bytes()).digest()
    rng = np.random.default_rng([*case.key, *digest[:8]])
    mount = tuple(tuple(float(x) for x in row) for row in R)
    other = replace(case.lab, track=track, room=room(rng, track.end_s), mount=mount, past={})
    other = replace(other, room=replace(other.room, mean=case.lab.T0 + rng.uniform(-1, 1)))
    spec = bound(case.hidden.spec, other)
    hooks = [spec.physics(case.hidden.p, settled(spec, case.hidden.shape))]
    write_recording(
        recording, other, cases._noisy(rng, other, cases._clean(rng, other, hooks)), rng
    )
    if words != "identity":
        recording.write_text(
            f"# mount: {words}\n" + recording.read_text(encoding="utf-8"), encoding="utf-8"
        )


def write_case(folder: Path, kind: str, key: Sequence[int]) -> Concealed:
    """What an honest user has (scenario and first recording), and the numbers of the case."""
    return lay_out(folder, kind, conceal(kind, key))


def lay_out(folder: Path, kind: str, case: Concealed) -> Concealed:
    """The files of a case."""
    folder.mkdir(parents=True, exist_ok=True)
    rng = np.random.default_rng([*case.key, 7])
    write_recording(folder / "first.csv", case.lab, case.first, rng)
    write_scenario(folder / "scenario.toml", case.lab)
    (folder / "case.json").write_text(
        json.dumps({"kind": kind, "key": list(case.key)}) + "\n", encoding="utf-8"
    )
    return case


def main(arguments: Sequence[str]) -> int:
    """Exit status 0: recorded; 2: the sequence asks for what this laboratory cannot do."""
    case_file, sequence, recording = (Path(a) for a in arguments)
    told = json.loads(case_file.read_text(encoding="utf-8"))
    case = drawn(told["kind"], told["key"], Blindfolded)
    if case is None:
        print(f"laboratory: {case_file.name} holds no case", file=sys.stderr)
        return 2
    try:
        record(case, sequence, recording)
    except ValueError as error:
        print(f"laboratory: {error}", file=sys.stderr)
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
