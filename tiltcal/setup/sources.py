"""Stated uncertainties of the references: the ``[[budget]]`` tables of a scenario."""

from typing import Literal

from pydantic import BaseModel, ConfigDict


class SourceTable(BaseModel):
    """One ``[[budget]]``: a source of uncertainty that is not in the record's noise, with its size.

    An effect of the catalogue, or gravity, latitude, heading, fog_axis; each parameter with its
    unit is a line of the budget.
    ``distribution`` states what the size is: a standard uncertainty (normal), a half-width
    (rectangular), or U at k = 2 (expanded). What is ``assumed`` stands in the budget only: neither
    fit nor verdict count with it.
    """

    model_config = ConfigDict(extra="allow", frozen=True)

    id: str
    sensor: str | None = None
    axis: str | None = None
    distribution: Literal["normal", "rectangular", "expanded"] = "normal"
    assumed: bool = False
