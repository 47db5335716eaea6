"""Stated uncertainties of the references: the ``[[budget]]`` tables of a scenario."""

from typing import Literal

from pydantic import BaseModel, ConfigDict


class SourceTable(BaseModel):
    """One ``[[budget]]``: a source of uncertainty that is not in the record's noise, with its size.

    An effect of the catalogue, or gravity, latitude, heading, fog_axis; each parameter with its
    unit is a line of the budget.
    """

    model_config = ConfigDict(extra="allow", frozen=True, use_attribute_docstrings=True)

    id: str
    """Effect of the catalogue, or `gravity`, `latitude`, `heading`, `fog_axis`."""
    sensor: str | None = None
    """Sensor that it acts on, where there is a choice."""
    axis: str | None = None
    """Table axis that it acts on, where there is a choice."""
    distribution: Literal["normal", "rectangular", "expanded"] = "normal"
    """What the sizes are: a standard uncertainty, a half-width, or U at k = 2."""
    assumed: bool = False
    """It stands in the budget only: neither fit nor verdict count with it."""
