"""The page of all keys, docs/keys.md: made from the models that validate the files.

    python -m tests.keys_page            compare the page with the models
    python -m tests.keys_page --write    write it anew

A key's meaning is the docstring below its field, which the JSON schema of the file has as well.
"""

import inspect
import json
import sys
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from pydantic import BaseModel

from tiltcal.calibration.stored import StoredCalibration
from tiltcal.laboratory.own_model import ModelReference
from tiltcal.laboratory.scenario import Scenario
from tiltcal.validation.campaign.campaign_file import CampaignTable

PAGE = Path(__file__).parents[1] / "docs" / "keys.md"
Schema = dict[str, Any]
HEAD = """\
# All keys

After this page you can look up every key of a scenario, a campaign and CAL.json: what it may be,
what it is where it is left out, and what it means.

The page is made from the models that check the files. `tiltcal init --json-schema` prints the same
of a scenario as JSON Schema, for editors. Terms not defined here stand in the
[glossary](glossary.md).
"""


@dataclass(frozen=True)
class File:
    """A kind of file: its model, its title, what a reader has to know first, and how the path of
    one of its tables is written.
    """

    model: type[BaseModel]
    title: str
    about: str
    first: str
    table: str = "`[{}]`"
    listed: str = "`[[{}]]`"
    named: str = "`[{}.NAME]`"
    within: tuple[str, ...] = ()


FILES = (
    File(
        Scenario,
        "Scenario",
        "A TOML file. An unknown key is an error, and the message names the nearest valid one. The"
        " parameters of effects are not listed here: `tiltcal effects` prints them with their"
        " units, and the page on [physics](physics.md) defines them.",
        "Keys of a scenario",
    ),
    File(
        ModelReference,
        "Own model in a scenario",
        "With these keys in `[rig]`, instead of `table`, the rig is a model of the user:"
        " [own model](own_model.md).",
        "`[rig]` with `mjcf`",
        within=("rig",),
    ),
    File(
        CampaignTable,
        "Campaign",
        "A TOML file for `tiltcal campaign`; an unknown key is an error:"
        " [campaigns](campaigns.md).",
        "Keys of a campaign",
    ),
    File(
        StoredCalibration,
        "CAL.json",
        "A JSON file. Numbers are finite; further keys are kept, and readers have to skip those"
        " that they do not know: [interfaces](interfaces.md#caljson).",
        "Keys of CAL.json",
        table="`{}` in CAL.json",
        listed="An entry of `{}` in CAL.json",
        named="An entry of `{}` in CAL.json",
    ),
)


@dataclass
class Section:
    """A table of a file: its heading, its schema and what its model says of itself."""

    heading: str
    schema: Schema
    about: str
    keys: list[str] = field(default_factory=list)

    @property
    def anchor(self) -> str:
        """The heading as the end of a link."""
        kept = "".join(c for c in self.heading.lower() if c.isalnum() or c in " _-")
        return "-".join(kept.split())


def sections_of(file: File) -> dict[str, Section]:
    """Name of each model of a file -> its section; the file's own first."""
    schema = file.model.model_json_schema(by_alias=True)
    parts = schema.get("$defs", {})
    found: dict[str, Section] = {}

    def add(name: str, part: Schema, heading: str, path: tuple[str, ...]) -> None:
        model = models()[name]
        keys = [f.alias or key for key, f in model.model_fields.items()]
        found[name] = Section(heading, part, inspect.cleandoc(model.__doc__ or ""), keys)
        for key in keys:
            for inner, form in tables_in(part["properties"][key], file):
                if inner not in found:
                    below = (*path, key)
                    add(inner, parts[inner], form.format(".".join(below)), below)

    add(file.model.__name__, schema, file.first, file.within)
    return found


def models() -> dict[str, type[BaseModel]]:
    """All models of the package by name."""

    def below(cls: type[BaseModel]) -> Iterator[type[BaseModel]]:
        for inner in cls.__subclasses__():
            yield inner
            yield from below(inner)

    return {c.__name__: c for c in below(BaseModel) if c.__module__.startswith("tiltcal.")}


def tables_in(value: Schema, file: File) -> Iterator[tuple[str, str]]:
    """(model, form of its heading) of the tables that the value of a key consists of."""
    if "$ref" in value:
        yield value["$ref"].rpartition("/")[2], file.table
    for inner in value.get("anyOf", ()):
        yield from tables_in(inner, file)
    for part, form in (("items", file.listed), ("additionalProperties", file.named)):
        if isinstance(value.get(part), dict):
            yield from ((name, form) for name, _ in tables_in(value[part], file))


def kind_of(value: Schema, sections: dict[str, Section]) -> str:
    """What a value may be."""
    if "$ref" in value:
        return f"[table](#{sections[value['$ref'].rpartition('/')[2]].anchor})"
    if "anyOf" in value:
        kinds = [kind_of(v, sections) for v in value["anyOf"] if v.get("type") != "null"]
        return " or ".join(kinds)
    if choices := value.get("enum", [value["const"]] if "const" in value else []):
        return ", ".join(f"`{json.dumps(choice)}`" for choice in choices)
    if "prefixItems" in value:
        return f"{len(value['prefixItems'])} numbers"
    if value.get("type") == "array":
        return f"list of {plural(kind_of(value.get('items', {}), sections))}"
    if value.get("type") == "object":
        inner = value.get("additionalProperties")
        return f"{plural(kind_of(inner, sections))} by name" if isinstance(inner, dict) else "table"
    return plain_kind_of(value)


def plain_kind_of(value: Schema) -> str:
    """What a value without parts may be."""
    if "pattern" in value:
        return f"text, `{value['pattern']}`"
    names = {"string": "text", "boolean": "true or false", "integer": "whole number"}
    name = names.get(value.get("type", ""), value.get("type", "value"))
    signs = {"exclusiveMinimum": ">", "minimum": ">=", "exclusiveMaximum": "<", "maximum": "<="}
    bounds = [f"{sign} {value[key]:g}" for key, sign in signs.items() if key in value]
    return ", ".join([name, *bounds])


def plural(kind: str) -> str:
    """Several of a kind: `list of numbers`."""
    plurals = {"text": "texts", "number": "numbers", "value": "values", "table": "tables"}
    for one, many in {**plurals, "whole number": "whole numbers"}.items():
        if kind == one or kind.startswith(f"{one},"):
            return kind.replace(one, many, 1)
    return kind.replace("[table]", "[tables]").replace("list of", "lists of")


def default_of(key: str, section: Section) -> str:
    """What a key is where it is left out."""
    if key in section.schema.get("required", ()):
        return "required"
    default = section.schema["properties"][key].get("default")
    if default is None or isinstance(default, dict) or default in ("", []):
        return ""
    return f"`{json.dumps(default)}`"


def lines_of(section: Section, sections: dict[str, Section]) -> Iterator[str]:
    """A section of the page."""
    yield from ("", f"### {section.heading}", "", section.about.replace("``", "`"), "")
    yield from ("| key | type, values | default | meaning |", "|---|---|---|---|")
    kinds = {key: kind_of(section.schema["properties"][key], sections) for key in section.keys}
    for key in sorted(kinds, key=lambda key: "](#" in kinds[key]):  # tables of their own last
        meaning = " ".join(section.schema["properties"][key]["description"].split())
        cells = (f"`{key}`", kinds[key], default_of(key, section), meaning)
        yield f"| {' | '.join(cells)} |"


def page() -> str:
    """The whole page."""
    lines = HEAD.splitlines()
    for file in FILES:
        sections = sections_of(file)
        lines += ["", f"## {file.title}", "", file.about]
        for section in sections.values():
            lines += lines_of(section, sections)
    return "\n".join(lines) + "\n"


def main() -> int:
    """Compare or write the page; the exit status: 0 it is as generated or written, 1 it differs."""
    if "--write" in sys.argv:
        PAGE.write_text(page(), encoding="utf-8")
    same = PAGE.exists() and PAGE.read_text(encoding="utf-8") == page()
    print(f"{PAGE.name}: {'as generated' if same else 'DIFFERS'}")
    return 0 if same else 1


if __name__ == "__main__":
    sys.exit(main())
