"""A check of a log, and what it finds."""

from abc import ABC, abstractmethod
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import ClassVar, Literal

from tiltcal.core.arrays import Index
from tiltcal.data_quality.log import Log

SHOWN = 3  # rows that a statement names
Answer = Literal["refused", "suspect", "note"]
"""What a calibration makes of a finding: no result, a failed test, or a passed one that says it."""


@dataclass(frozen=True)
class Finding:
    """A fault of a log.

    Args:
        kind: name of the check that found it.
        columns: where; ``time_s`` for stamps.
        rows: the rows it stands in, from 0, (m,).
        statement: one sentence, the same wherever it is printed.
        count: of rows or events; the number of rows unless given.
        size: what it measures, in the unit of the column, by name.
        sigma: standard uncertainty of these.
        repair: name of the repair that mends it; empty where there is none.
    """

    kind: str
    columns: tuple[str, ...]
    rows: Index
    statement: str
    count: int = -1
    size: Mapping[str, float] = field(default_factory=dict)
    sigma: Mapping[str, float] = field(default_factory=dict)
    repair: str = ""

    def __post_init__(self) -> None:
        if self.count < 0:
            object.__setattr__(self, "count", len(self.rows))

    @property
    def column(self) -> str:
        """The first of the columns."""
        return self.columns[0]

    def with_repair(self) -> str:
        """The statement, and the repair that may be asked for."""
        return f"{self.statement}; --repair {self.repair}" if self.repair else self.statement

    def as_json(self) -> dict[str, object]:
        """As `tiltcal import --json` prints it; rows count from 1."""
        return {
            "kind": self.kind,
            "column": self.column,
            "columns": list(self.columns),
            "count": self.count,
            "rows": [int(r) + 1 for r in self.rows[:SHOWN]],
            "statement": self.statement,
            "repair": self.repair,
        }


class Check(ABC):
    """One kind of fault: how it is looked for, and how it is repaired."""

    name: ClassVar[str]
    """One word, which names the findings."""
    test: ClassVar[str]
    """Ending of the name of a calibration's test: ``not frozen``."""
    answer: ClassVar[Answer] = "suspect"
    repair: ClassVar[str] = ""
    """Name of the repair for ``--repair``; empty: there is none."""
    looks_at: ClassVar[str]
    """For the page of the checks: readings, stamps, angles of the table ..."""
    finds: ClassVar[str]
    """The size at which it is certain to find the fault."""
    is_certain: ClassVar[bool] = False
    """Whether its repair is certain: the checks after it, and a diagnosis, see it repaired."""
    explains: ClassVar[bool] = False
    """Whether the checks after it leave the columns alone."""

    def find(self, log: Log) -> list[Finding]:
        """What it finds."""
        return list(self._find(log))

    def finding(
        self,
        columns: tuple[str, ...],
        rows: Index,
        statement: str,
        *,
        count: int = -1,
        size: Mapping[str, float] | None = None,
        sigma: Mapping[str, float] | None = None,
    ) -> Finding:
        """A finding of this check; the arguments are those of ``Finding``. rows: (m,)."""
        return Finding(
            self.name, columns, rows, statement, count, size or {}, sigma or {}, self.repair
        )

    def repaired(self, log: Log, findings: Sequence[Finding]) -> tuple[Log, str]:
        """The log with what was found repaired, and what was done; itself where nothing can be."""
        return self._repair(log, findings)

    @abstractmethod
    def _find(self, log: Log) -> Iterator[Finding]: ...

    def _repair(self, log: Log, findings: Sequence[Finding]) -> tuple[Log, str]:
        del findings
        return log, ""


class Emptying(Check):
    """A check whose readings become missing ones."""

    is_certain = True

    def _repair(self, log: Log, findings: Sequence[Finding]) -> tuple[Log, str]:
        rows: dict[str, Index] = {}
        for f in findings:
            for column in f.columns:
                rows[column] = f.rows
        done = [f"{len(r)} values of {name} emptied" for name, r in rows.items()]
        return log.emptied(rows), ", ".join(done)


def in_rows(rows: Index) -> str:
    """Words for where: ``3 times, in data rows 5, 6, 7``. rows: from 0, (m,)."""
    shown = ", ".join(str(r + 1) for r in rows[:SHOWN]) + (", ..." if len(rows) > SHOWN else "")
    if len(rows) == 1:
        return f"once, in data row {shown}"
    return f"{len(rows)} times, in data rows {shown}"


def in_words(names: Sequence[str]) -> str:
    """``a``, ``a and b``, ``a, b and c``."""
    return names[0] if len(names) == 1 else f"{', '.join(names[:-1])} and {names[-1]}"
