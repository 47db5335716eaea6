"""How much memory a foreign file may take; asked before anything is allocated."""

from dataclasses import dataclass

from tiltcal.core.errors import TiltcalError

GIGABYTE = 1e9


@dataclass(frozen=True)
class ReadBudget:
    """The limit.

    Args:
        gigabytes: of the values of one file, as they are expanded.
    """

    gigabytes: float = 4.0

    def require(self, size: float, source: str) -> None:
        """Refuse what is larger.

        Args:
            source: of the file, for the message.
            size: bytes that the file states, or that it cannot take less than.

        Raises:
            TiltcalError: it is above the limit.
        """
        if size > self.gigabytes * GIGABYTE:
            raise TiltcalError(
                f"foreign recording {source}",
                found=f"{size / GIGABYTE:.3g} GB of values",
                need=f"at most {self.gigabytes:g} GB",
                do="cut the file, or allow more with --memory-gb",
            )
