"""What mkdocs calls while it builds the site: pages and pictures that the product itself makes.

``TILTCAL_DOCS_PICTURES=off`` leaves the pictures out, for a quick look at the text.
"""

import os
import re
from pathlib import Path
from typing import Any

import api_pages
import effect_pages
import tutorial_pictures
from mkdocs.structure.files import File
from picture_cache import BLANK, PictureCache

ROOT = Path(__file__).parents[2]
FILE_BLOCK = re.compile(r"^```(\w+) (\S+)$", re.M)
PICTURES = os.environ.get("TILTCAL_DOCS_PICTURES", "on") != "off"


def on_config(config: Any) -> None:
    """Add the generated pages to the navigation."""
    effects = {"Effects": [page for page, _ in effect_pages.pages()]}
    api = {"API by room": [page for page, _ in api_pages.pages()]}
    config.nav = [*config.nav, effects, api]


def on_files(files: Any, config: Any) -> None:
    """Add the generated pages and pictures."""
    for name, text in (*effect_pages.pages(), *api_pages.pages()):
        files.append(File.generated(config, name, content=text))
    drawn = {**tutorial_pictures.PICTURES, **effect_pages.pictures()}
    if PICTURES:
        drawn_files = PictureCache(ROOT, ROOT / ".docs_cache").files(drawn)
        for name, file in drawn_files.items():
            place = f"pictures/{name}"
            files.append(File.generated(config, place, abs_src_path=str(file)))
    else:
        for name in drawn:
            files.append(File.generated(config, f"pictures/{name}", content=BLANK))


def on_page_markdown(markdown: str, **_: Any) -> str:
    """A block that is a file shows its name: ```` ```toml bench.toml ```` as a title."""
    return FILE_BLOCK.sub(r'```\1 title="\2"', markdown)
