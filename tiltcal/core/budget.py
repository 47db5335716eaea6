"""The budget of one command: how many rows, bytes and seconds its work may take. It is checked
before the work begins, and before anything is allocated.
"""

import os
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass

from tiltcal.core.errors import TiltcalError

ROWS = "TILTCAL_ALLOW_ROWS"
MEMORY = "TILTCAL_ALLOW_MEMORY_MIB"
HOURS = "TILTCAL_ALLOW_HOURS"


@dataclass(frozen=True)
class WorkBudget:
    """What the work of one command may take.

    Args:
        rows: of a recording.
        memory_mib: at the same time, MiB.
        hours: of computing, as estimated.
    """

    rows: float = 100e6
    memory_mib: float = 2048.0
    hours: float = 240.0

    @classmethod
    def allowed(cls) -> "WorkBudget":
        """That of this process: the default, or what was allowed."""
        base = cls()
        return cls(
            _stated(ROWS, base.rows), _stated(MEMORY, base.memory_mib), _stated(HOURS, base.hours)
        )


def allow(
    rows: float | None = None, memory_mib: float | None = None, hours: float | None = None
) -> None:
    """Allow this process, and those it starts, more than the default.

    Raises:
        TiltcalError: it is not a positive number.
    """
    for name, option, amount in (
        (ROWS, "--allow-rows", rows),
        (MEMORY, "--allow-memory", memory_mib),
        (HOURS, "--allow-hours", hours),
    ):
        if amount is None:
            continue
        if not 0 < amount < float("inf"):
            raise TiltcalError(
                option, found=f"{amount:g}", need="a number above 0", do="correct it"
            )
        os.environ[name] = repr(float(amount))


@contextmanager
def restoring() -> Iterator[None]:
    """What is allowed within is not allowed afterwards."""
    before = {name: os.environ.get(name) for name in (ROWS, MEMORY, HOURS)}
    try:
        yield
    finally:
        for name, amount in before.items():
            if amount is None:
                os.environ.pop(name, None)
            else:
                os.environ[name] = amount


def require_within(
    subject: str, *, rows: float = 0.0, size: float = 0.0, seconds: float = 0.0, less: str
) -> None:
    """Refuse work that is over the budget, before it begins.

    Args:
        subject: whose work it is, for the message.
        rows: of a recording.
        size: bytes in memory at the same time.
        seconds: of computing.
        less: how to ask for less, as an imperative.

    Raises:
        TiltcalError: stating the rows, the bytes and the seconds that it would be.
    """
    budget = WorkBudget.allowed()
    over = [
        (rows > budget.rows, f"--allow-rows {rows:.0f}", f"{budget.rows:g} rows"),
        (
            size > budget.memory_mib * 2**20,
            f"--allow-memory {size / 2**20:.0f}",
            f"{budget.memory_mib:g} MiB",
        ),
        (
            seconds > 3600 * budget.hours,
            f"--allow-hours {seconds / 3600:.0f}",
            f"{budget.hours:g} h",
        ),
    ]
    options = [option for exceeds, option, _ in over if exceeds]
    if options or any(amount != amount for amount in (rows, size, seconds)):
        reachable = rows < 1e12 and size < 1e15 and seconds < 1e10
        raise TiltcalError(
            subject,
            found=f"work of {_amounts(rows, size, seconds)}",
            need="at most " + " and ".join(most for exceeds, _, most in over if exceeds),
            do=f"{less}, or allow it with {' '.join(options)}" if reachable else less,
        )


def _amounts(rows: float, size: float, seconds: float) -> str:
    """What the work would be, as text."""
    text = [f"{rows:.4g} rows"] if rows else []
    if size:
        text.append(f"{size:.4g} bytes ({size / 2**30:.3g} GiB)")
    if seconds:
        text.append(f"about {seconds / 3600:.3g} h")
    return ", ".join(text)


def _stated(name: str, default: float) -> float:
    """An amount from the environment; the default where nothing is stated.

    Raises:
        TiltcalError: it is not a positive number.
    """
    text = os.environ.get(name, "")
    if not text:
        return default
    try:
        amount = float(text)
    except ValueError:
        amount = 0.0
    if not amount > 0:
        raise TiltcalError(
            f"variable {name}", found=f"'{text}'", need="a number above 0", do="correct it"
        )
    return amount
