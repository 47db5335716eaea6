"""Pages that stand alone: one file that opens offline, with its style, plots and data."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from typing import Any

from tiltcal import __version__
from tiltcal.core.files import write_text
from tiltcal.core.units import signs_in, unit_sign
from tiltcal.report.figures import inline_svg, save_figures
from tiltcal.report.plots import Plot

TEMPLATES = Path(__file__).parent / "templates"


@dataclass
class Numbered:
    """Gives each plot of a page its id.

    Args:
        shown: the plots so far.
        drawn_by_page: how many of them the page draws itself.
    """

    shown: list[Plot] = field(default_factory=list)
    drawn_by_page: int = 0

    @property
    def any(self) -> bool:
        """Whether the page draws a plot; asked at its end."""
        return self.drawn_by_page > 0

    def still(self, plot: Plot, width_mm: float) -> str:
        """A plot as SVG, for a page that is printed."""
        self.shown.append(plot)
        return inline_svg(plot, width_mm, len(self.shown))

    def __call__(self, plot: Plot) -> Mapping[str, Any]:
        """What the macro ``plot`` shows."""
        self.shown.append(plot)
        self.drawn_by_page += 1
        return {
            "id": f"plot-{self.drawn_by_page}",
            "height": plot.height,
            "caption": plot.caption,
            "alternative": plot.alternative,
            "json": plot.to_json(),
        }


def write_page(path: Path, template: str, **values: Any) -> None:
    """Write a page, whole or not at all.

    Args:
        path: of the HTML file.
        template: name of the template.
        values: that it shows.

    Raises:
        TiltcalError: the file cannot be written.
    """
    write_text(path, rendered(template, **values))


def rendered(template: str, **values: Any) -> str:
    """A page from a template. In addition to the values it has ``version``, ``plotly()`` for the
    script that draws, ``plots(plot)`` for what the macro ``plot`` shows, ``plots.still(plot, mm)``,
    and the filters ``sign`` of a unit and ``signs`` of a text with units. Its figures are written
    where the command names a folder for them.

    Raises:
        TiltcalError: a figure cannot be written.
    """
    page, plots = _environment().get_template(f"{template}.html.jinja"), Numbered()
    text = page.render(version=__version__, plotly=_plotly, plots=plots, **values)
    save_figures(plots.shown, template.replace("_", "-"))
    return str(text)


@cache
def _environment() -> Any:
    from jinja2 import Environment, FileSystemLoader, StrictUndefined

    made = Environment(
        loader=FileSystemLoader(TEMPLATES),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    made.filters["sign"] = unit_sign
    made.filters["signs"] = signs_in
    return made


def _plotly() -> str:
    from plotly.offline import get_plotlyjs

    return str(get_plotlyjs())


def sections(*titles: str) -> Sequence[tuple[str, str]]:
    """Id and title of each section of a page; those without a title are left out."""
    return [(title.lower().replace(" ", "-"), title) for title in titles if title]
