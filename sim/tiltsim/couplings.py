"""Equality constraints of a user's own model: which joints each of them ties to each other."""

from collections.abc import Iterator

import mujoco

from tiltcal.core.errors import TiltcalError

EQ, WRAP = mujoco.mjtEq, mujoco.mjtWrap
POINTS = (EQ.mjEQ_CONNECT, EQ.mjEQ_WELD)


def require_tied_joints_read(model: "mujoco.MjModel", mapped: set[int], subject: str) -> None:
    """Refuse a constraint by which a joint moves whose place no readout states.

    Where all the joints that a constraint ties are read, it says nothing new; where none is, all of
    them stay at the model's reference.

    Args:
        model: compiled.
        mapped: numbers of the joints behind an axis.
        subject: of the message.

    Raises:
        TiltcalError: a constraint ties a joint with an axis to one without.
    """
    for k in range(model.neq):
        tied = _tied(model, k) if model.eq_active0[k] else set()
        read, unread = sorted(tied & mapped), sorted(tied - mapped)
        if read and unread:
            first, other = (model.joint(j).name or f"number {j}" for j in (read[0], unread[0]))
            kind = mujoco.mjtEq(model.eq_type[k]).name.removeprefix("mjEQ_").lower()
            raise TiltcalError(
                subject,
                found=f"a {kind} constraint (of URDF: mimic) by which joint '{other}', which has no"
                f" axis, moves with joint '{first}'",
                need="a readout of every joint that moves",
                do=f"map '{other}' in [rig.axes] too and record or work out its column; or take the"
                " constraint out of the model, and the joint stays at the model's reference",
            )


def _tied(model: "mujoco.MjModel", constraint: int) -> set[int]:
    """Numbers of the joints whose places a constraint relates."""
    kind = mujoco.mjtEq(model.eq_type[constraint])
    pair = int(model.eq_obj1id[constraint]), int(model.eq_obj2id[constraint])
    there = [number for number in pair if number >= 0]
    if kind == EQ.mjEQ_JOINT:
        return set(there)
    if kind == EQ.mjEQ_TENDON:
        return set().union(*(_of_tendon(model, number) for number in there))
    if kind in POINTS:
        of_sites = model.eq_objtype[constraint] == int(mujoco.mjtObj.mjOBJ_SITE)
        bodies = [int(model.site_bodyid[n]) if of_sites else n for n in there]
        return _apart([set(_above(model, body)) for body in bodies])
    return set()  # flexes have no joints


def _of_tendon(model: "mujoco.MjModel", tendon: int) -> set[int]:
    """Joints that change the length of a tendon."""
    first = int(model.tendon_adr[tendon])
    wraps = range(first, first + int(model.tendon_num[tendon]))
    kinds = {k: mujoco.mjtWrap(model.wrap_type[k]) for k in wraps}
    fixed = {int(model.wrap_objid[k]) for k in wraps if kinds[k] == WRAP.mjWRAP_JOINT}
    sites = [int(model.wrap_objid[k]) for k in wraps if kinds[k] == WRAP.mjWRAP_SITE]
    return fixed | _apart([set(_above(model, int(model.site_bodyid[s]))) for s in sites])


def _apart(paths: list[set[int]]) -> set[int]:
    """Joints that move some of these bodies and not all alike."""
    return {j for path in paths for j in path if not all(j in other for other in paths)}


def _above(model: "mujoco.MjModel", body: int) -> Iterator[int]:
    """Joints between the world and a body, its own ones too."""
    while body > 0:
        first = int(model.body_jntadr[body])
        yield from range(first, first + int(model.body_jntnum[body]))
        body = int(model.body_parentid[body])
