"""Results as tables: for pandas, Arrow and notebooks."""

from collections.abc import Mapping, Sequence
from html import escape
from typing import TYPE_CHECKING, Any

import numpy as np

from tiltcal.core.optional_library import library

if TYPE_CHECKING:
    import pyarrow as pa

Column = Sequence[Any] | np.ndarray[Any, Any]
SHOWN = 8  # rows that a notebook shows of a longer table


class Tabular:
    """A result whose content is a table.

    A subclass states ``as_columns`` and, where the rows do not state all, ``headline``.
    """

    def as_columns(self) -> Mapping[str, Column]:
        """Name -> values of each column, all of one length."""
        raise NotImplementedError

    def headline(self) -> str:
        """One line for what the rows do not state."""
        return type(self).__name__

    def to_arrow(self) -> "pa.Table":
        """The table for Arrow: Polars, DuckDB, Parquet."""
        import pyarrow as pa

        return pa.table({name: pa.array(list(v)) for name, v in self.as_columns().items()})

    def to_pandas(self) -> Any:
        """The table as a pandas.DataFrame.

        Raises:
            TiltcalError: pandas is not installed.
        """
        library("pandas", "pandas", "to_pandas")
        return self.to_arrow().to_pandas()

    def _repr_html_(self) -> str:
        """The head of the table, for notebooks."""
        columns = self.as_columns()
        rows = max((len(values) for values in columns.values()), default=0)
        head = "".join(f"<th>{escape(name)}</th>" for name in columns)
        body = "".join(
            "<tr>" + "".join(f"<td>{_cell(v[k])}</td>" for v in columns.values()) + "</tr>"
            for k in range(min(rows, SHOWN))
        )
        more = f"<p>first {SHOWN} of {rows} rows</p>" if rows > SHOWN else ""
        return (
            f"<p>{escape(self.headline())}</p><table><thead><tr>{head}</tr></thead>"
            f"<tbody>{body}</tbody></table>{more}"
        )


def _cell(value: Any) -> str:
    """A value as the text of a cell; empty where there is none."""
    if value is None or (isinstance(value, float) and np.isnan(value)):
        return ""
    return f"{value:.6g}" if isinstance(value, float) else escape(str(value))
