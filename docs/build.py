"""Build the documentation: the API reference by pdoc, and the catalogue of effects from its classes."""

from pathlib import Path

import pdoc

from tiltcal.effects import CATALOGUE

HERE = Path(__file__).parent
OUT = HERE / "api"


def catalogue_page() -> str:
    """The catalogue as Markdown, one section an effect."""
    lines = ["# Catalogue of effects", ""]
    for id, cls in CATALOGUE.items():
        lines += [f"## {id}", "", f"*{cls.stage}*: {cls.title}. {cls.physics}", "", f"`{cls.equation}`", ""]
        lines += [f"Excited by {cls.excited_by}. Look: {cls.look}. Source: {cls.source}.", ""]
        lines += ["| parameter | precision laboratory | mid MEMS | consumer |", "|---|---|---|---|"]
        for p in cls.parameters:
            lines.append(f"| `{p.name}{p.suffix}` | {' | '.join(f'{x:g}' for x in p.plausible)} |")
        lines.append("")
    return "\n".join(lines)


def main() -> None:
    """Write docs/api."""
    OUT.mkdir(exist_ok=True)
    (OUT / "catalogue.md").write_text(catalogue_page(), encoding="utf-8")
    pdoc.render.configure(docformat="google")
    pdoc.pdoc("tiltcal", "tiltsim", output_directory=OUT)
    print(f"documentation: {OUT / 'index.html'} and {OUT / 'catalogue.md'}; the guide is {HERE / 'guide.md'}")


if __name__ == "__main__":
    main()
