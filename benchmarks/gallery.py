"""Write docs/gallery.md and its pictures: every kind of figure, and two movies.

    [MICROBUNDLE_DATA=FOLDER] python benchmarks/gallery.py

The rendered tissue of `microbundle demo` is always shown. Where MICROBUNDLE_DATA names the folder of real movies, they
are shown too; without it, their pictures in docs/gallery stay as they are.
"""

from __future__ import annotations

import os
from dataclasses import replace
from pathlib import Path

from microbundle import Analysis, Config, Movie, analyze, read_movie
from microbundle.figures import KINDS, draw, why_not
from microbundle.movies import write_movie
from microbundle.style import settings
from microbundle.synth.render import beating_tissue

DOCS = Path(__file__).parent.parent / "docs"
PICTURES = DOCS / "gallery"
DPI = (144, 128, 112, 96)
LARGEST_PNG, LARGEST_GIFS = 120_000, 1_000_000
SECTIONS = {
    "Tissue and tracking": ("tissue", "markers", "quality"),
    "Displacement": ("displacement", "displacement_row", "displacement_col"),
    "Beats": ("signal", "beats"),
    "Strain": ("subdomains", "strain_cc", "strain_cr", "strain_rr", "principal", "delay", "strain_cc_series",
               "strain_cr_series", "strain_rr_series"),
    "Pillars and forces": ("pillar_displacement", "force", "force_length"),
}
RENDERED = ("displacement", "strain_cc", "principal", "beats")
HEAD = """# Gallery

Every kind of figure, as `microbundle analyze my_movie --figures --movies` writes it (there also as PDF), and in Python:

```python
from microbundle import figures, movies

figures.draw(analysis, "strain_cc").savefig("strain.pdf")          # a matplotlib figure, 85 mm wide
figures.draw(analysis, "displacement", beat=2, limits=(0, 20))     # one beat, given limits
common = figures.shared_limits(analyses)                           # the same limits for a whole batch
figures.save_all(analysis, "figures", limits=common)
movies.write_movie(movie, analysis, "strain.mp4", show="strain", level=True)
movies.write_movie(movie, analysis, "displacement.gif", beats_only=True)
```

Lengths are in µm and times in s where the calibration is known, else in px and frames. Bands are standard errors.
Colours can be told apart with any colour vision. What a result has no data for is left out, and the reason is told.
The real movie is an example of the published tool, with a pillar stiffness of 2.677 µN/µm assumed for the forces. Made
by `python benchmarks/gallery.py`.
"""
SPEED = """## Time and memory

`python benchmarks/pictures.py`: 512 x 512 px; CPU seconds of both cores of a shared machine, on which such figures vary
by a third, and the peak memory of a process of its own.

{table}
"""


def picture(analysis: Analysis, kind: str, name: str) -> None:
    """Write one figure as a small PNG, as fine as its size allows."""
    file = PICTURES / f"{name}.png"
    figure = draw(analysis, kind)
    with settings():
        for dpi in DPI:
            figure.savefig(file, dpi=dpi)
            if file.stat().st_size <= LARGEST_PNG:
                return
    raise SystemExit(f"{file}: expected at most {LARGEST_PNG} bytes; found {file.stat().st_size}")


def real(folder: Path) -> None:
    """Pictures and movies of a real movie."""
    config = Config.from_dict({"pillars": {"stiffness_un_per_um": 2.677}})
    movie = read_movie(folder, fps=30, um_per_px=4)
    analysis = analyze(movie, config)
    for kind in KINDS:
        why = why_not(analysis, kind)
        if why:
            raise SystemExit(f"{kind}: {why}")
        picture(analysis, kind, kind)
    short = config.model_copy(update={"reading": config.reading.model_copy(update={"stop_frame": 56})})
    two_beats = analyze(movie, short)
    gifs = [write_movie(movie, two_beats, PICTURES / f"{show}.gif", show=show, beats_only=True, longest_px=316,
                        overwrite=True) for show in ("displacement", "strain")]
    size = sum(file.stat().st_size for file in gifs)
    if size > LARGEST_GIFS:
        raise SystemExit(f"movies: expected at most {LARGEST_GIFS} bytes; found {size}")


def rendered() -> None:
    """Pictures of the rendered tissue, whose motion is known."""
    synthetic = beating_tissue((256, 256), 75, seed=0)
    movie: Movie = replace(synthetic.movie, frames=synthetic.array())
    analysis = analyze(movie, Config.from_dict({"strain": {"tile_px": 20}}))
    for kind in RENDERED:
        picture(analysis, kind, f"rendered_{kind}")


def page(table: str) -> str:
    """The page, of the pictures that are there."""
    lines = [HEAD]
    movies = [file for file in ("displacement.gif", "strain.gif") if (PICTURES / file).exists()]
    if movies:
        lines += ["## Movies\n", *(f"![{file.removesuffix('.gif')}](gallery/{file})" for file in movies), ""]
    for title, kinds in SECTIONS.items():
        shown = [kind for kind in kinds if (PICTURES / f"{kind}.png").exists()]
        if shown:
            lines += [f"## {title}\n", *(f"`{kind}`: {KINDS[kind].text}.\n\n![{KINDS[kind].text}](gallery/{kind}.png)\n"
                                         for kind in shown)]
    lines += ["## A rendered tissue\n", "Its exact motion is known; `microbundle demo` compares them.\n",
              *(f"![{KINDS[kind].text}](gallery/rendered_{kind}.png)\n" for kind in RENDERED)]
    return "\n".join([*lines, SPEED.format(table=table)] if table else lines).rstrip() + "\n"


def last_table() -> str:
    """The table of time and memory that the page has now; benchmarks/pictures.py prints a new one."""
    page_now = (DOCS / "gallery.md").read_text(encoding="utf-8") if (DOCS / "gallery.md").exists() else ""
    return "\n".join(line for line in page_now.splitlines() if line.startswith("|"))


def main() -> None:
    PICTURES.mkdir(parents=True, exist_ok=True)
    rendered()
    data = os.environ.get("MICROBUNDLE_DATA")
    if data:
        real(Path(data) / "type1_bright")
    assert {kind for kinds in SECTIONS.values() for kind in kinds} == set(KINDS)
    (DOCS / "gallery.md").write_text(page(last_table()), encoding="utf-8")


if __name__ == "__main__":
    main()
