"""Published recordings: listed, and fetched from where their owners keep them."""

import hashlib
import tomllib
from collections.abc import Mapping
from functools import cache
from pathlib import Path
from typing import Annotated
from urllib.parse import urlparse

from pydantic import Field

from tiltcal.core.errors import TiltcalError, nearest
from tiltcal.core.files import make_folder, replacing
from tiltcal.core.optional_library import library
from tiltcal.setup.part import StrictTable

LIST = Path(__file__).parent / "datasets.toml"
_RAW = "https://raw.githubusercontent.com"


class PublishedFile(StrictTable):
    """A file and the digest of its content."""

    name: str
    bytes: int
    sha256: Annotated[str, Field(pattern="^[0-9a-f]{64}$")]


class Dataset(StrictTable):
    """A published recording.

    ``commit`` is stated as far as it is known; without ``folder`` the path within the
    repository is not known. ``mapping`` and ``scenario`` stand in ``scenarios/real``.
    """

    name: str
    title: str
    repository: str
    commit: str
    folder: str | None = None
    licence: str
    import_file: str
    mapping: str
    scenario: str
    notes: str = ""
    file: tuple[PublishedFile, ...]

    @property
    def address(self) -> str | None:
        """URL of its files; None where it is not known."""
        if self.folder is None:
            return None
        return f"{_RAW}/{self.repository}/{self.commit}/{self.folder}"


@cache
def datasets() -> Mapping[str, Dataset]:
    """All published recordings by name."""
    table = tomllib.loads(LIST.read_text(encoding="utf-8"))
    found = [Dataset.model_validate(entry) for entry in table["dataset"]]
    return {dataset.name: dataset for dataset in found}


def find_dataset(name: str) -> Dataset:
    """A published recording by name.

    Raises:
        TiltcalError: there is none of that name.
    """
    if name not in datasets():
        raise TiltcalError(
            f"data set '{name}'",
            found="no data set of this name",
            need="one that `tiltcal datasets list` shows",
            do=nearest(name, list(datasets())),
        )
    return datasets()[name]


def fetch(dataset: Dataset, into: Path, source: str | None = None) -> list[Path]:
    """The files of a data set in a folder; those that are there and whole are not fetched again.

    Args:
        dataset: what is fetched.
        into: the folder.
        source: an address or a folder with the files, instead of the published address.

    Raises:
        TiltcalError: the address is not known, the library is missing, a file cannot be fetched,
            or it is not the published one.
    """
    location = source or dataset.address
    if location is None:
        digests = ", ".join(f"{f.name} with SHA-256 {f.sha256}" for f in dataset.file)
        raise TiltcalError(
            f"data set {dataset.name}",
            found=f"no known address in {dataset.repository} at {dataset.commit}",
            need=digests,
            do="find it there, and give its folder or address with --from",
        )
    make_folder(into)
    return [_one(dataset, file, into, location) for file in dataset.file]


def _one(dataset: Dataset, file: PublishedFile, into: Path, location: str) -> Path:
    target = into / file.name
    if target.is_file() and _digest(target) == file.sha256:
        return target
    if urlparse(location).scheme in ("http", "https"):
        _download(dataset, file, f"{location.rstrip('/')}/{file.name}", target)
        return target
    local = Path(location) / file.name
    if not local.is_file():
        raise TiltcalError(
            f"data set {dataset.name}",
            found=f"no file {local}",
            need="the published file",
            do="check the folder after --from",
        )
    if _digest(local) != file.sha256:
        raise _other_file(dataset, file, str(local))
    with replacing(target) as temporary:
        temporary.write_bytes(local.read_bytes())
    return target


def _download(dataset: Dataset, file: PublishedFile, address: str, target: Path) -> None:
    pooch = library("pooch", "datasets", "data sets")
    requests = library("requests", "datasets", "data sets")
    pooch.get_logger().setLevel("WARNING")
    with replacing(target) as temporary:
        try:
            pooch.HTTPDownloader(progressbar=False, timeout=60)(address, str(temporary), None)
        except requests.RequestException as error:
            raise TiltcalError(
                f"data set {dataset.name}",
                found=f"{address} does not answer with the file ({type(error).__name__})",
                need="access to it",
                do="check the network, or give a folder or another address with --from",
            ) from error
        if _digest(temporary) != file.sha256:
            raise _other_file(dataset, file, address)


def _digest(path: Path) -> str:
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def _other_file(dataset: Dataset, file: PublishedFile, location: str) -> TiltcalError:
    return TiltcalError(
        f"data set {dataset.name}, {file.name}",
        found=f"another content at {location}",
        need=f"SHA-256 {file.sha256}",
        do="fetch it again, or from another address with --from",
    )
