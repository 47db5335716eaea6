"""One version: of the program, the build, the citation and the newest section of the changelog."""

import re
from pathlib import Path

import yaml
from hatchling.metadata.core import ProjectMetadata
from hatchling.plugin.manager import PluginManager

from tiltcal import __version__
from tiltcal.cli import main

ROOT = Path(__file__).parents[1]
SECTION = re.compile(r"^## \[(\d+\.\d+\.\d+)\] - (\d{4}-\d{2}-\d{2})$", re.M)


def test_the_program_says_its_version(capsys):
    assert main(["--version"]) == 0
    assert capsys.readouterr().out.strip() == f"tiltcal {__version__}"


def test_the_build_reads_the_version_from_the_package():
    assert ProjectMetadata(str(ROOT), PluginManager()).version == __version__


def test_citation_and_changelog_name_the_version_and_its_date():
    cited = yaml.safe_load((ROOT / "CITATION.cff").read_text(encoding="utf-8"))
    sections = SECTION.findall((ROOT / "CHANGELOG.md").read_text(encoding="utf-8"))
    assert sections[0] == (__version__, cited["date-released"])
    assert cited["version"] == __version__
