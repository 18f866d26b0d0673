"""The analysis of one movie, from the first frame to the last number, in the order the work is done."""

from __future__ import annotations

import platform
from importlib.metadata import version

from .analysis import Analysis
from .beat_decisions import decide_beats
from .beats import find_beats
from .config import Config
from .data import Finding, Masks, Movie, Strain
from .decisions import Decisions
from .errors import CannotMeasure, ConfigError
from .events import Progress, Tell, ignore, stage
from .grid import interpolate_grid
from .markers import place_markers
from .mask import find_masks
from .mask_files import with_decided_masks
from .pillars import measure_pillars
from .quality import check_movie
from .quality_result import check_result
from .read import calibrated, content_hash, prepare
from .reference import find_relaxed_frame
from .register import register
from .stage_motion import measure_stage, stage_finding
from .strain import measure_strain
from .track import track_markers

FEWEST_FRAMES = 3


def analyze(movie: Movie, config: Config | None = None, *, masks: Masks | None = None,
            decisions: Decisions | None = None, tell: Tell = ignore) -> Analysis:
    """Measure one movie: tissue, tracks, beats, displacement field and strain.

    `masks` replaces the automatic ones. `decisions` of a person (see `microbundle.read_decisions`) are replayed. `tell`
    hears of the progress. A movie in which nothing moves is a result, with the verdict "fail" and a finding that says
    so. Raises NoTissue, NoTexture, MovieUnreadable, MaskUnusable.
    """
    if not isinstance(movie, Movie):
        raise ConfigError(f"movie: expected a Movie, found {type(movie).__name__}; open a file with "
                          "microbundle.read_movie(path), an array with microbundle.Movie.from_array(array)")
    decisions = decisions or Decisions()
    config = decisions.over(config or Config())
    movie = with_decided_masks(calibrated(movie, config.fps, config.um_per_px), decisions)
    movie = prepare(movie, config.reading)
    if movie.count < FEWEST_FRAMES:
        raise CannotMeasure(f"{movie.name}: expected a movie of at least {FEWEST_FRAMES} frames; found {movie.count}")

    stage(tell, "finding the tissue", 0.0, 0.1)
    masks = masks or find_masks(movie, config.mask, axis_deg=config.axis_deg)
    stage(tell, "finding a relaxed frame", 0.1, 0.25)
    reference_frame = find_relaxed_frame(movie, masks, config)
    markers = place_markers(movie, masks, reference_frame, config)
    follow = register if config.method == "accurate" else track_markers
    tracks = follow(movie, masks, markers, config, stage(tell, "tracking", 0.25, 0.85))
    stage(tell, "following the pillars", 0.85, 0.9)
    pillars, no_pillars = measure_pillars(movie, masks, reference_frame, config)
    stage(tell, "beats and strain", 0.9, 1.0)
    beats = decide_beats(find_beats(tracks, masks, movie, config), tracks, decisions)
    background = None if config.method == "paper" else measure_stage(movie, masks, reference_frame)
    grid = interpolate_grid(tracks, beats, masks, config)
    strain, no_strain = _strain_or_reason(tracks, beats, masks, config)
    tell(Progress("done", 1.0))

    return Analysis(
        name=movie.name, image=movie.frames[reference_frame], time_s=movie.time_s, time_source=movie.time_source,
        um_per_px=movie.um_per_px, um_per_px_source=movie.um_per_px_source, config=config, masks=masks,
        markers=markers, tracks=tracks, beats=beats, grid=grid, strain=strain,
        movie_findings=(*movie.findings, *check_movie(movie, masks, config.method), *no_strain, *no_pillars,
                        *stage_finding(background, beats),
                        *check_result(movie, masks, tracks, beats, strain, config.method)),
        files=tuple(str(file) for file in movie.files), input_hash=content_hash(movie), versions=_versions(),
        stage_px=None if background is None else background.shift_px, pillars=pillars, decisions=decisions,
    )


def _strain_or_reason(*stages: object) -> tuple[Strain | None, tuple[Finding, ...]]:
    """Strain, or a finding where the tissue leaves no room for it: displacement is still a result."""
    try:
        return measure_strain(*stages), ()  # type: ignore[arg-type]
    except CannotMeasure as error:
        return None, (Finding("no_strain", "review", str(error)),)


def _versions() -> dict[str, str]:
    packages = ("microbundle", "numpy", "scipy", "opencv-python-headless", "tifffile")
    return {"python": platform.python_version(), **{name: version(name) for name in packages}}
