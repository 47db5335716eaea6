"""``tiltcal datasets``."""

from pathlib import Path
from typing import Annotated, Literal

from cyclopts import Parameter

from tiltcal.cli.options import Json
from tiltcal.cli.output import print_json, print_note, print_table
from tiltcal.core.assets import folder
from tiltcal.core.errors import TiltcalError
from tiltcal.recordings import datasets as catalogue
from tiltcal.recordings.datasets import Dataset, fetch, find_dataset


def datasets(
    action: Annotated[Literal["list", "get"], Parameter(help="list or get.")] = "list",
    name: Annotated[str | None, Parameter(help="Data set to get.")] = None,
    /,
    *,
    source: Annotated[
        str | None,
        Parameter("--from", help="Address or folder that holds the files, instead of the owner's."),
    ] = None,
    output: Annotated[
        Path | None, Parameter(alias="-o", help="Folder for the files; the name if not given.")
    ] = None,
    as_json: Json = False,
) -> int:
    """List published recordings, or get one from its owner.

    A file that is not the published one, by its SHA-256, is refused. The
    mapping and the scenario of each are part of tiltcal.

      tiltcal datasets list
      tiltcal datasets get mpu9150 -o data
    """
    if action == "list":
        _show(as_json)
        return 0
    if name is None:
        raise TiltcalError(
            "command line of `tiltcal datasets get`",
            found="no name",
            need="one of " + ", ".join(catalogue.datasets()),
            do="add it",
        )
    dataset = find_dataset(name)
    paths = fetch(dataset, Path(name) if output is None else output, source)
    if as_json:
        mapping, scenario = _mapping_and_scenario(dataset)
        files = [str(p) for p in paths]
        print_json({"files": files, "mapping": str(mapping), "scenario": str(scenario)})
    else:
        _print_notes(dataset, paths)
    return 0


def _show(as_json: bool) -> None:
    if as_json:
        known = catalogue.datasets().values()
        print_json([d.model_dump(mode="json") | {"address": d.address} for d in known])
        return
    rows = [
        [
            d.name,
            d.title,
            f"{d.repository} @ {d.commit}" + ("" if d.folder else " (location not known)"),
            d.licence,
            f"{sum(f.bytes for f in d.file) / 1e6:.1f} MB",
        ]
        for d in catalogue.datasets().values()
    ]
    print_table(["name", "what", "source", "licence", "size"], rows, spare=["source"])


def _mapping_and_scenario(dataset: Dataset) -> tuple[Path, Path]:
    """The mapping and the scenario of a data set."""
    real = folder("scenarios") / "real"
    return real / dataset.mapping, real / dataset.scenario


def _print_notes(dataset: Dataset, paths: list[Path]) -> None:
    mapping, scenario = _mapping_and_scenario(dataset)
    for path in paths:
        print_note(f"{path}: the published file")
    here = paths[0].parent / dataset.import_file
    print_note(f"licence: {dataset.licence}, {dataset.repository}")
    print_note(f"next: tiltcal import {here} --map {mapping} -o run.csv")
    print_note(f"scenario: {scenario}")
