"""The commands about truth: simulate a movie or a plate, validate the pipeline, compare with hand-clicked points.

`cli` registers them; each parses, calls one library function, prints, and returns an exit code.
"""

from __future__ import annotations

from fnmatch import fnmatch
from pathlib import Path
from typing import Literal

from ..commands import Switch
from ..config import Method
from ..errors import ConfigError, OutputError


def simulate(*, out: Path, physics: Literal["analytic", "fe", "sheet"] = "analytic",
             size: tuple[int, int] | None = None, frames: int | None = None, peak_px: float = 1.5,
             angle_deg: float = 0.0, inclusion: Switch = False,
             noise: Literal["none", "camera", "weak-light", "perlin"] = "camera", magnitude: float = 0.06,
             octaves: int = 28, texture: Path | None = None, case: str | None = None, masks: bool = True, seed: int = 0,
             quiet: Switch = False) -> int:
    """Render a movie with exactly known motion, in the paper's layout, with its truth beside it.

    Parameters
    ----------
    out
        New folder: movie/*.tif, masks/, truth.npz, truth.csv and calibration.toml.
    physics
        `analytic` beats by a formula; `fe` is a finite-element bundle, `sheet` a thin sheet after the paper's Type 2
        (both need the extra `synth`).
    size
        Rows and columns; by default 256 448. Not for `sheet`, and not with a texture.
    frames
        Number of frames, at 30 frames/s and 24 or 25 frames a beat; by default 96, and 200 for `fe`.
    peak_px
        Peak of the mean absolute displacement in the middle of the tissue (analytic), or of the whole tissue with
        a texture. Finite elements move as their mechanics says.
    angle_deg
        Angle of the tissue, positive clockwise (analytic).
    inclusion
        Put a passive region into the tissue.
    noise
        `camera`: shot and read noise; `weak-light`: ten times less light; `perlin`: the paper's.
    magnitude
        Height of Perlin noise as a share of the largest brightness.
    octaves
        Octaves of Perlin noise, counted on 90 px as in the paper.
    texture
        Movie whose relaxed frame is set in motion instead of a painted tissue (analytic).
    case
        Render this case of the validation sets instead; all other options but --masks are then ignored.
    masks
        Write the true tissue and pillar masks too.
    seed
        Of texture, rhythm and noise.
    quiet
        Print nothing but errors.
    """
    from ..config import Config
    from .cases import SETS, Case, camera, case_set, perlin
    from .microscope import framed_scene, relaxed_picture
    from .noise import NoiseModel
    from .scenes import Analytic, Elements, Scene, Sheet
    from .simulate import write_simulation

    if case is not None:
        found = [c for name in SETS for c in case_set(name) if c.name == case]
        if not found:
            raise ConfigError(f"--case: expected the name of a movie in {', '.join(SETS)}; found {case!r}")
        folder = write_simulation(found[0], out, masks=masks)
    else:
        if peak_px < 0 or (frames is not None and frames < 3):
            raise ConfigError(f"expected --peak-px of at least 0 and --frames of at least 3; found {peak_px}, {frames}")
        if texture is not None and physics != "analytic":
            raise ConfigError("--texture: a real frame is set in motion by --physics analytic only")
        scene: Scene
        if texture is not None:
            from ..read import read_movie

            scene = framed_scene(relaxed_picture(read_movie(texture), Config()), peak_px, seed, frames or 96)
        elif physics == "fe":
            scene = Elements(seed, inclusion, frames=frames or 200, shape=size or (288, 512))
        elif physics == "sheet":
            scene = Sheet(seed, frames=frames or 120)
        else:
            scene = Analytic(peak_px, seed, shape=_shape(size), frames=frames or 96, angle_deg=angle_deg,
                             inclusion=inclusion, side_px=0.18 * _shape(size)[1])
        columns = scene.picture().image.shape[1]
        model = {"none": NoiseModel(seed=seed), "camera": camera(seed),
                 "weak-light": camera(seed, electrons=2_000, read=0.01),
                 "perlin": perlin(magnitude, octaves, columns, seed)}[noise]
        folder = write_simulation(Case(out.name, "simulated", scene, model), out, masks=masks)
    if not quiet:
        print(folder)
    return 0


def example_plate(*, out: Path, wells: int = 24, faults: Switch = False, seed: int = 0, quiet: Switch = False) -> int:
    """Render a plate of small movies with known truth: a drug of known effect, and faults on request.

    Parameters
    ----------
    out
        New folder: a movie for each well, plate.csv (the manifest for `microbundle batch`) and truth.csv.
    wells
        Number of wells, 2 to 1536; each takes about a third of a second and 3.7 MB.
    faults
        Spoil up to 16 wells, each in another way; truth.csv says how, and what must be reported.
    seed
        Of textures, noise, and the variation from well to well.
    quiet
        Print nothing but errors.
    """
    from ..console import progress_bar
    from .plate import render_plate

    with progress_bar(quiet) as tell:
        manifest = render_plate(out, wells, faults=faults, seed=seed, tell=tell)
    if not quiet:
        print(manifest)
    return 0


def validate(*, cases: str = "frontier", method: Method = "accurate", workers: int = 1,
             out: Path | None = None, only: str | None = None, texture: Path | None = None,
             fps: float | None = None, um_per_px: float | None = None, tissue_mask: Path | None = None,
             figures: bool = True, quiet: Switch = False) -> int:
    """Measure the pipeline's error on movies whose motion is known, beside the paper's errors.

    An interrupted run goes on where it stopped, when it is started again with the same folder.

    Parameters
    ----------
    cases
        Set of movies: frontier (30), paper (416), type2, still, patchwork or smoke.
    method
        Method of analysis that is validated.
    workers
        Movies that are worked on at the same time.
    out
        Folder for scores, tables, figures; by default validation_SET_METHOD in the current folder.
    only
        Take the cases whose name fits this pattern, such as "homogeneous-*-m12-*".
    texture
        A movie of yours: its own relaxed frame is moved by a known field, at several amplitudes and under its own
        noise, and the error to expect on that microscope is printed.
        The amplitude is the peak of the mean absolute displacement of the whole tissue.
    fps
        Frames per second of that movie.
    um_per_px
        Micrometres per pixel of that movie.
    tissue_mask
        Mask of the tissue in that movie.
    figures
        Draw figures as PNG and PDF (needs matplotlib).
    quiet
        Print nothing but errors.
    """
    from ..config import Config
    from ..console import print_rows
    from .cases import case_set
    from .microscope import texture_cases
    from .validate import Row, run_validation
    from .validation_tables import EXPECTED, SHORT, columns, summary_rows, write_tables

    if workers < 1:
        raise ConfigError(f"--workers: expected at least 1; found {workers}")
    config, noise = Config(method=method), None
    if texture is not None:
        from ..read import read_movie

        movie = read_movie(texture, fps=fps, um_per_px=um_per_px, tissue_mask=tissue_mask)
        chosen, noise = texture_cases(movie, config)
        title = f"Error to expect on {movie.name}, method {method}"
        folder = out or Path(f"validation_{movie.name}_{method}")
    else:
        chosen = case_set(cases)
        title = f"Validation, set {cases}, method {method}"
        folder = out or Path(f"validation_{cases}_{method}")
    chosen = tuple(c for c in chosen if only is None or fnmatch(c.name, only))
    if not chosen:
        raise ConfigError(f"--only: no case fits {only!r}" if only else "no amplitude suits a tissue of this size")

    def tell(row: Row, done: int, count: int) -> None:
        if not quiet:
            print(f"{done}/{count} {row.case}: {row.status}", flush=True)

    rows = run_validation(chosen, config, folder, workers=workers, tell=tell)
    write_tables(rows, folder, title)
    if figures:
        from .validation_figures import write_figures

        write_figures(chosen, rows, folder)
    if not quiet:
        if noise is not None:
            print(f"noise, as a share of full scale: tissue {noise.tissue:.2g}, ground {noise.ground:.2g}; "
                  f"neighbouring pixels correlated by {noise.correlation:.2f}")
        shown = SHORT if noise is None else EXPECTED
        print_rows(title, shown, columns(summary_rows(rows), shown))
        for row in rows:
            if not row.measured:
                print(f"{row.case}: {row.status}")
        print(f"results: {folder}")
    return 0


def compare_clicks(result: Path, clicks: Path, *, out: Path | None = None, quiet: Switch = False,
                   json: Switch = False) -> int:
    """Compare a result with points that people followed by hand.

    Parameters
    ----------
    result
        Folder or result.nc that `microbundle analyze` wrote.
    clicks
        CSV with the columns person, point, frame, row, col, in pixels and frames of the analyzed movie.
    out
        Also write the table into this new CSV file.
    quiet
        Print nothing but errors.
    json
        Print JSON instead of the table.
    """
    from ..console import print_json, print_rows
    from ..store import load
    from .manual import compare_clicks as compare
    from .manual import read_clicks, table

    agreements = compare(load(result), read_clicks(clicks))
    if out is not None:
        if out.exists():
            raise OutputError(f"{out}: exists already, and is not replaced")
        try:
            table(agreements).to_csv(out, index=False, float_format="%.6g", lineterminator="\n")
        except OSError as error:
            raise OutputError(f"{out}: cannot be written: {error.strerror or error}") from None
    if json:
        print_json({"people": [vars(a) for a in agreements]})
    elif not quiet:
        header = ("person", "points", "clicks", "R2 row", "R2 col", "MAE row px", "MAE col px", "spread px")
        print_rows("Displacement by hand and in the result", header, [
            (a.person, str(a.points), str(a.clicks), *(f"{v:.4g}" for v in (
                a.r2_row, a.r2_col, a.mae_row_px, a.mae_col_px, a.spread_px))) for a in agreements])
    return 0


def _shape(size: tuple[int, int] | None) -> tuple[int, int]:
    shape = size or (256, 448)
    if min(shape) < 64 or shape[0] > shape[1]:
        raise ConfigError("--size: expected rows and columns of at least 64 px, not more rows than columns; found "
                          f"{shape[0]} {shape[1]}")
    return shape
