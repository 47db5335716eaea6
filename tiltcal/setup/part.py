"""What every part of a scenario file is: frozen, and strict about its keys."""

from functools import cached_property

from pydantic import BaseModel, ConfigDict


class StrictTable(BaseModel):
    """A frozen part of a scenario; unknown keys are errors."""

    model_config = ConfigDict(
        extra="forbid",
        frozen=True,
        allow_inf_nan=False,
        ignored_types=(cached_property,),
        use_attribute_docstrings=True,
    )

    @classmethod
    def keys(cls) -> list[str]:
        """Its keys in a file."""
        return [f.alias or name for name, f in cls.model_fields.items()]
