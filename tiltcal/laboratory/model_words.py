"""How a scenario names a model of its own: ``[rig] mjcf``, its axes and the instrument's site."""

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, Literal

from pydantic import Field, field_validator

from tiltcal.core.errors import TiltcalError
from tiltcal.core.extensions import load
from tiltcal.setup.chain import Chain, Place
from tiltcal.setup.part import Part

GROUP = "tiltcal.models"
Reader = Callable[["ModelWords", Path, Sequence[str]], tuple[Chain, Mapping[str, Place]]]


class ModelAxis(Part):
    """A joint behind a column.

    Args:
        joint: its name in the model.
        sign: -1 where the readout counts the other way.
        offset_deg: angle of a joint that turns, where the readout says zero.
        offset_mm: place of a joint that slides, where the readout says zero.
    """

    joint: str
    sign: Literal[1, -1] = 1
    offset_deg: float = 0.0
    offset_mm: float = 0.0


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


def with_links(table: dict[str, Any], words: ModelWords, folder: Path) -> dict[str, Any]:
    """A scenario's table with the links of its model, and the places of its sensors, instead of the
    words for them.

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
    sensors = [s for s in table.get("sensor", ()) if isinstance(s, dict)]
    sites = [s["site"] for s in sensors if isinstance(s.get("site"), str)]
    chain, places = reader(words, folder, sites)
    rig = {k: v for k, v in table["rig"].items() if k not in ModelWords.model_fields}
    rig |= {"model": words.mjcf, "site": words.site, **chain.model_dump(exclude_defaults=True)}
    return {**table, "rig": rig, "sensor": [_placed(s, places) for s in table.get("sensor", ())]}


def _placed(sensor: Any, places: Mapping[str, Place]) -> Any:
    """A sensor's table with the place of the site that it names."""
    if not isinstance(sensor, dict) or not isinstance(sensor.get("site"), str):
        return sensor
    others = {k: v for k, v in sensor.items() if k != "site"}
    return {**others, "place": places[sensor["site"]].model_dump()}
