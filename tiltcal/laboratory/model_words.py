"""How a scenario names a model of its own: ``[rig] mjcf``, its axes and the instrument's site."""

from collections.abc import Callable
from pathlib import Path
from typing import Any, Literal

from pydantic import Field, field_validator

from tiltcal.core.errors import TiltcalError
from tiltcal.core.extensions import load
from tiltcal.setup.chain import Chain
from tiltcal.setup.sensor import Part

GROUP = "tiltcal.models"
Reader = Callable[["ModelWords", Path], Chain]


class ModelAxis(Part):
    """A joint behind a column.

    Args:
        joint: its name in the model.
        sign: -1 where the readout counts the other way.
        offset_deg: angle of the joint where the readout says zero.
    """

    joint: str
    sign: Literal[1, -1] = 1
    offset_deg: float = 0.0


class ModelWords(Part):
    """A model and what of it is recorded.

    Args:
        mjcf: MJCF or URDF, in the scenario's folder.
        axes: joint of each table axis, by the name in its column ``table_<axis>_<unit>``.
        site: of the instrument: a site, or a body.
    """

    mjcf: str
    axes: dict[str, ModelAxis] = Field(min_length=1)
    site: str

    @field_validator("axes", mode="before")
    @classmethod
    def _plain_names(cls, words: Any) -> Any:
        if not isinstance(words, dict):
            return words
        return {k: {"joint": v} if isinstance(v, str) else v for k, v in words.items()}


def links_of(rig: dict[str, Any], words: ModelWords, folder: Path) -> dict[str, Any]:
    """A rig's table with the links of its model in place of the words for it.

    Raises:
        TiltcalError: no simulator is installed, or the model cannot be read.
    """
    readers = [reader for _, reader in load(GROUP)]
    if not readers:
        raise TiltcalError(
            f"model {words.mjcf}",
            found="no simulator installed",
            need="the package tiltsim",
            do="install tiltcal with its simulator",
        )
    reader: Reader = readers[0]
    chain = reader(words, folder)
    others = {k: v for k, v in rig.items() if k not in ModelWords.model_fields}
    return {**others, "model": words.mjcf, **chain.model_dump(exclude_defaults=True)}
