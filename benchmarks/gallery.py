"""Write docs/gallery.md and its pictures: every kind of figure, and two movies.

    [MICROBUNDLE_DATA=FOLDER] python benchmarks/gallery.py

Rendered bundles whose motion is known show every kind. Where MICROBUNDLE_DATA names the folder of real movies, traces
of one are shown too; without it, their pictures in docs/gallery stay as they are.
"""

from __future__ import annotations

import os
import shutil
import tempfile
from dataclasses import replace
from pathlib import Path

from microbundle import Analysis, Config, analyze, read_movie
from microbundle.batch.plan import make_plan
from microbundle.batch.run import run_batch
from microbundle.figures import KINDS, draw, why_not
from microbundle.movies import write_movie
from microbundle.style import settings
from microbundle.synth.cases import camera, case_set
from microbundle.synth.plate import render_plate

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
REAL = ("signal", "beats", "force", "force_length", "strain_cc_series")
PLATES = {"amplitude_um": "Contraction amplitude in each well", "groups": "Groups of the wells"}
PLATES_TEXT = """`microbundle batch` draws these for each plate and metric ([more](batch.md#plate-maps)). The plate is
that of `microbundle example-plate --wells 24 --faults`, of whose wells half are spoilt.
"""
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
The movie is a finite-element bundle on two pillars under a camera's noise (`microbundle simulate --case
homogeneous-X-1`), with a stiffness of 2.677 µN/µm. Made by `python benchmarks/gallery.py`.
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


def rendered() -> None:
    """Pictures and movies of a finite-element bundle under a camera's noise, whose motion is known: every kind."""
    case = next(c for c in case_set("paper") if c.name == "homogeneous-X-1")
    movie = replace(case, noise=camera(3)).make().drawn().movie
    settings_of_movie = {"pillars": {"stiffness_un_per_um": 2.677}, "reading": {"stop_frame": 100}}
    config = Config.from_dict(settings_of_movie)
    analysis = analyze(movie, config)
    travelling = next(c for c in case_set("frontier") if c.name == "clean-1.6px-travelling")
    delayed = analyze(travelling.make().drawn().movie)  # all of the bundle of finite elements contracts at once
    for kind in KINDS:
        shown = delayed if kind == "delay" else analysis
        why = why_not(shown, kind)
        if why:
            raise SystemExit(f"{kind}: {why}")
        picture(shown, kind, kind)
    short = analyze(movie, config.model_copy(update={"reading": config.reading.model_copy(update={"stop_frame": 56})}))
    gifs = [write_movie(movie, short, PICTURES / f"{show}.gif", show=show, beats_only=True, longest_px=316,
                        overwrite=True) for show in ("displacement", "strain")]
    size = sum(file.stat().st_size for file in gifs)
    if size > LARGEST_GIFS:
        raise SystemExit(f"movies: expected at most {LARGEST_GIFS} bytes; found {size}")


def real(folder: Path) -> None:
    """Traces of a real movie."""
    analysis = analyze(read_movie(folder, fps=30, um_per_px=4),
                       Config.from_dict({"pillars": {"stiffness_un_per_um": 2.677}}))
    for kind in REAL:
        picture(analysis, kind, f"real_{kind}")


def plates() -> None:
    """Maps of a rendered plate, of whose wells half are spoilt."""
    with tempfile.TemporaryDirectory() as folder:
        home = Path(folder)
        plan = make_plan(render_plate(home / "plate", 24, faults=True), config=Config(method="fast"), report=False)
        out = run_batch(plan, home / "out").out
        for name in PLATES:
            shutil.copyfile(out / "plate_maps" / f"P1_{name}.png", PICTURES / f"plate_{name}.png")


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
    shown = [name for name in PLATES if (PICTURES / f"plate_{name}.png").exists()]
    if shown:
        lines += ["## Plates\n", PLATES_TEXT, *(f"![{PLATES[name]}](gallery/plate_{name}.png)\n" for name in shown)]
    shown = [kind for kind in REAL if (PICTURES / f"real_{kind}.png").exists()]
    if shown:
        lines += ["## A real movie\n", "100 frames of the published tool's example, with the same stiffness.\n",
                  *(f"![{KINDS[kind].text}](gallery/real_{kind}.png)\n" for kind in shown)]
    return "\n".join([*lines, SPEED.format(table=table)] if table else lines).rstrip() + "\n"


def last_table() -> str:
    """The table of time and memory that the page has now; benchmarks/pictures.py prints a new one."""
    page_now = (DOCS / "gallery.md").read_text(encoding="utf-8") if (DOCS / "gallery.md").exists() else ""
    return "\n".join(line for line in page_now.splitlines() if line.startswith("|"))


def main() -> None:
    PICTURES.mkdir(parents=True, exist_ok=True)
    rendered()
    plates()
    data = os.environ.get("MICROBUNDLE_DATA")
    if data:
        real(Path(data) / "type1_bright")
    assert {kind for kinds in SECTIONS.values() for kind in kinds} == set(KINDS)
    (DOCS / "gallery.md").write_text(page(last_table()), encoding="utf-8")


if __name__ == "__main__":
    main()
