"""Movies of a result: displacement or strain in colours over the beating tissue, with its trace running below.

    microbundle.movies.write_movie(movie, analysis, "displacement.mp4")

Frames are read, drawn and encoded one after the other, so that memory does not grow with the movie.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from .analysis import Analysis
from .data import Ints, Movie
from .encode import encoder
from .errors import CannotMeasure, ConfigError
from .movie_frames import Painter, Show, colouring, window
from .read import calibrated, prepare
from .shown import Shown

FASTEST = {".mp4": 60.0, ".gif": 50.0}
"""Frames a second that all players can show; faster movies are slowed down to it."""
UNKNOWN_FPS = 30.0
SHOWN: tuple[Show, ...] = ("displacement", "strain")
LONGEST = {".mp4": 640, ".gif": 400}
"""Longer side of the picture in px."""


def write_movie(movie: Movie, analysis: Analysis, path: Path | str, *, show: Show = "displacement", level: bool = False,
                beats_only: bool = False, limits: tuple[float, float] | None = None, fps: float | None = None,
                longest_px: int | None = None, overwrite: bool = False) -> Path:
    """Write a movie of a result, as MP4 or GIF by the name's ending, and return its path.

    `movie` is the one that was analyzed. `show` is "displacement", its length from the movie's relaxed state, or
    "strain", E_cc of the sub-domains in percent. `level` turns the tissue level; `beats_only` leaves out the frames
    that belong to no whole beat. `limits` are the ends of the colour bar in the unit shown; without them they follow
    the data. `fps` is the speed at which it plays: by default that of the recording, at most 60 (GIF: 50) frames a
    second, or 30 where it is not known. `longest_px` is the picture's longer side. Raises CannotMeasure where there is
    nothing to show, ConfigError for a wrong argument or another movie, OutputError where the file cannot be written or
    exists (unless `overwrite`); nothing is left then.
    """
    path = Path(path).expanduser()
    if show not in SHOWN:
        raise ConfigError(f"show: expected displacement or strain; found {show!r}")
    if limits is not None and not (np.isfinite(limits).all() and limits[0] < limits[1]):
        raise ConfigError(f"limits: expected two numbers, the lower first; found {limits}")
    if fps is not None and not (np.isfinite(fps) and fps > 0):
        raise ConfigError(f"fps: expected a positive number; found {fps}")
    movie = _as_analyzed(movie, analysis)
    _check_shown(analysis, show)
    frames = _frames(analysis, beats_only)
    suffix = path.suffix.lower()
    shown = Shown(analysis)
    view = window(shown, longest_px or LONGEST.get(suffix, LONGEST[".mp4"]), level=level)
    paint = Painter(movie, shown, show, view, limits)
    signal = np.nan_to_num(analysis.beats.signal_px)[frames]
    sample = [paint(int(t), movie.frames[int(t)]) for t in frames[[int(np.argmin(signal)), int(np.argmax(signal))]]]
    speed = fps or min(analysis_fps(analysis), FASTEST.get(suffix, FASTEST[".mp4"]))
    with encoder(path, paint.frame.shape, speed, sample, overwrite=overwrite) as add:
        for t in frames:
            add(paint(int(t), movie.frames[int(t)]))
    return path


def own_limits(analysis: Analysis) -> dict[str, tuple[float, float]]:
    """Find the limits that the movies of a result have where none are given: "displacement" and, where there is strain,
    "strain" -> (low, high)."""
    shown, out = Shown(analysis), dict[str, tuple[float, float]]()
    for show in SHOWN:
        try:
            _check_shown(analysis, show)
        except CannotMeasure:
            continue
        out[show] = colouring(shown, show, window(shown, LONGEST[".mp4"], level=False)).limits()
    return out


def _check_shown(analysis: Analysis, show: Show) -> None:
    if show == "strain" and (analysis.strain is None or not np.isfinite(analysis.strain.F).any()):
        raise CannotMeasure(f"{analysis.name}: no sub-domain has a strain, so there is no movie of it")


def save_all(movie: Movie, analysis: Analysis, folder: Path | str, *,
             limits: Mapping[str, tuple[float, float]] | None = None) -> dict[str, str]:
    """Write `displacement.mp4` and `strain.mp4` into a folder; returns what there is no movie of, and why.

    `limits` are the ends of the colour bars, by the same names; without them they follow the data. Raises ConfigError
    for another movie than the one that was analyzed, OutputError where a file cannot be written.
    """
    left_out: dict[str, str] = {}
    for show in SHOWN:
        try:
            write_movie(movie, analysis, Path(folder) / f"{show}.mp4", show=show, limits=(limits or {}).get(show))
        except CannotMeasure as error:
            left_out[show] = str(error)
    return left_out


def analysis_fps(analysis: Analysis) -> float:
    """Frames a second of the recording, or 30 where they are not known."""
    if analysis.time_s is None or len(analysis.time_s) < 2:
        return UNKNOWN_FPS
    return float(1 / np.median(np.diff(analysis.time_s)))


def _frames(analysis: Analysis, beats_only: bool) -> Ints:
    """Numbers of the frames that are shown."""
    if not beats_only:
        return np.arange(analysis.frame_count)
    beat = analysis.beats.beat_of_frame
    whole = np.append(analysis.beats.complete, False)  # -1, no beat, takes the last one
    frames = np.flatnonzero(whole[beat])
    if len(frames) == 0:
        raise CannotMeasure(f"{analysis.name}: the movie has no whole beat; leave beats_only away to show every frame")
    return frames


def _as_analyzed(movie: Movie, analysis: Analysis) -> Movie:
    """The movie with the cuts and filters of the analysis. Raises ConfigError where it is another one."""
    config = analysis.config
    ready = prepare(calibrated(movie, config.fps, config.um_per_px), config.reading)
    if ready.count != analysis.frame_count or ready.shape != analysis.image.shape:
        raise ConfigError(f"movie: expected the one that was analyzed, {analysis.frame_count} frames of "
                          f"{analysis.image.shape[0]} x {analysis.image.shape[1]} px; found {ready.count} of "
                          f"{ready.shape[0]} x {ready.shape[1]} px ({movie.name})")
    return ready
