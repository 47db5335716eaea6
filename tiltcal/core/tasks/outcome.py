"""What became of a task, and what it may use."""

from dataclasses import dataclass
from typing import Any, Literal

from tiltcal.core.errors import TiltcalError

Fault = Literal["time", "memory", "ended"]
"""A task took too long, took too much memory, or its process ended."""


@dataclass(frozen=True)
class Limits:
    """What one task may use.

    Args:
        seconds: of wall time.
        memory_mib: of private memory of its process, MiB.
    """

    seconds: float = 3600.0
    memory_mib: int = 4096

    def __post_init__(self) -> None:
        if not (self.seconds > 0 and self.memory_mib > 0):
            raise TiltcalError(
                "limits of a task",
                found=f"{self.seconds:g} s and {self.memory_mib} MiB",
                need="both above 0",
                do="correct them",
            )


@dataclass(frozen=True)
class Outcome:
    """What became of a task.

    Args:
        value: what it returned.
        error: what it raised, as text; None when it returned.
        refusal: that error itself, where it is one of this package.
        fault: why its process had to go; None where it stayed.
        seconds: of wall time.
    """

    value: Any = None
    error: str | None = None
    refusal: TiltcalError | None = None
    fault: Fault | None = None
    seconds: float = 0.0

    def failure(self, limits: Limits) -> str | None:
        """Why there is no value, as text; None where there is one."""
        if self.fault == "time":
            return f"it took more than {limits.seconds:g} s"
        if self.fault == "memory":
            return f"it took more than {limits.memory_mib} MiB"
        return self.error

    def require(self, subject: str, limits: Limits) -> None:
        """Refuse an outcome without a value.

        Raises:
            TiltcalError: that of the task, or that it has no value.
        """
        if self.refusal is not None:
            raise self.refusal
        if (failure := self.failure(limits)) is not None:
            raise TiltcalError(
                subject,
                found=f"no result: {failure}",
                need="an answer, and enough time and memory",
                do="run it with -j 1 to see why",
            )

    @classmethod
    def raised(cls, error: Exception) -> "Outcome":
        """Of an exception: messages of this package as they are, any other with its kind."""
        if isinstance(error, TiltcalError):
            return cls(error=str(error), refusal=error)
        return cls(error=f"{type(error).__name__}: {error}")
