"""Follow markers through the movie with pyramidal Lucas-Kanade.

Source: J.-Y. Bouguet, Pyramidal implementation of the affine Lucas Kanade feature tracker, 2001; paper, "Sparse
optical flow algorithm for tracking".

The default compares every frame with the same relaxed frame, starting from the frame before, so errors do not add
up. A marker is lost in a frame where OpenCV says so, where tracking back misses its start, or where it moves unlike
its neighbours. `paper` goes from frame to frame and keeps every point, as published.
"""

from __future__ import annotations

from collections.abc import Callable

import cv2
import numpy as np
from scipy.spatial import cKDTree

from .config import Config
from .data import Bools, Finding, Floats, Ints, Markers, Masks, Movie, Tracks
from .errors import CannotMeasure
from .scaling import Scaling, movie_scaling, stretch_each

FIRST_WINDOW_PX = 17
WINDOW_STEP_PX = 8
WINDOW_ROUNDS = 3
ACCEPTABLE_LOSS = 0.05
FEWEST_FOLLOWED = 12
PYRAMID = 3
STOP = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_COUNT, 20, 0.01)
NEIGHBOURS = 8
FEWEST_NEIGHBOURS = 3
"""With fewer of its neighbours followed, a marker is taken for lost too: nothing speaks for it."""
OUTLIER = 5.0
"""A marker is an outlier when it differs from its neighbours' median by this many of their median deviations."""
OUTLIER_FLOOR_PX = 0.1

PAPER_PYRAMID = 5
PAPER_STOP = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_COUNT, 10, 0.03)
PAPER_FIRST_WINDOW_PX = 5
PAPER_ROUNDS = 15


def track_markers(movie: Movie, masks: Masks, markers: Markers, config: Config,
                  tell: Callable[[float], None]) -> Tracks:
    """Follow the markers through all frames; `tell` hears the share of frames done.

    Raises CannotMeasure where nearly all of them are lost.
    """
    if config.method == "paper":
        return _paper_tracks(movie, markers, config.tracking.window_px, tell)
    return _reference_tracks(movie, masks.tissue, markers, config, tell)


def _reference_tracks(movie: Movie, tissue: Bools, markers: Markers, config: Config,
                      tell: Callable[[float], None]) -> Tracks:
    """Track against the reference frame; widen the window while too many markers are lost or outrun it."""
    params = config.tracking
    scaling = movie_scaling(movie, tissue)
    start = (markers.position_px - scaling.origin).astype(np.float32)
    neighbours = _neighbours(start)
    window = params.window_px or FIRST_WINDOW_PX
    best: tuple[float, Floats, Bools, Floats, int] | None = None
    for _ in range(1 if params.window_px else WINDOW_ROUNDS):
        position, ok, misses = _track_all(movie, scaling, markers.reference_frame, start, neighbours, window,
                                          params.max_forward_backward_px, tell)
        loss = float(1 - ok.mean())
        if best is None or loss < 0.8 * best[0]:
            best = (loss, position, ok, misses, window)
        if loss <= ACCEPTABLE_LOSS:
            break
        window += WINDOW_STEP_PX
    assert best is not None
    loss, position, ok, misses, window = best
    followed = int((ok.mean(axis=0) >= 0.5).sum())
    if followed < min(FEWEST_FOLLOWED, len(start)):
        raise CannotMeasure(f"{movie.name}: expected at least {FEWEST_FOLLOWED} points of the tissue that could be "
                            f"followed through half of the frames; found {followed} of {len(start)}. Do the frames "
                            "show one and the same tissue, in focus?")
    position += scaling.origin.astype(np.float32)
    position[~ok] = np.nan
    findings: tuple[Finding, ...] = ()
    if loss > ACCEPTABLE_LOSS:
        findings = (Finding("markers_lost", "review" if loss < 0.5 else "fail",
                            f"{loss:.0%} of all marker positions were lost; large motion, changing focus or little "
                            "texture does this", loss, ACCEPTABLE_LOSS),)
    return Tracks(position, ok, "fast", markers.reference_frame, window, misses, findings=findings)


def _track_all(movie: Movie, scaling: Scaling, reference: int, start: Floats, neighbours: Ints,
               window: int, max_miss_px: float, tell: Callable[[float], None]) -> tuple[Floats, Bools, Floats]:
    """One pass over the movie, from the reference frame to both ends."""
    count = movie.count
    position = np.empty((count, len(start), 2), np.float32)
    ok = np.ones((count, len(start)), bool)
    miss = np.zeros((count, len(start)), np.float32)
    first = scaling(movie.frames[reference])
    begin = start[:, ::-1].copy()
    done = 0
    for order in (range(reference, count), range(reference - 1, -1, -1)):
        guess = begin
        for t in order:
            frame = scaling(movie.frames[t])
            to, status, _ = cv2.calcOpticalFlowPyrLK(
                first, frame, begin, guess.copy(), winSize=(window, window), maxLevel=PYRAMID, criteria=STOP,
                flags=cv2.OPTFLOW_USE_INITIAL_FLOW)
            back, back_status, _ = cv2.calcOpticalFlowPyrLK(
                frame, first, to, begin.copy(), winSize=(window, window), maxLevel=0, criteria=STOP,
                flags=cv2.OPTFLOW_USE_INITIAL_FLOW)
            miss[t] = np.hypot(*(back - begin).T)
            good = (status.ravel() > 0) & (back_status.ravel() > 0) & (miss[t] <= max_miss_px)
            moved = to - begin
            if len(neighbours):
                good &= ~_outliers(moved, good, neighbours)
            position[t], ok[t] = to[:, ::-1], good
            guess = np.where(good[:, None], to, begin + _common_motion(moved, good))
            done += 1
            tell(done / count)
    return position, ok, np.median(miss, axis=0)


def _neighbours(points: Floats) -> Ints:
    """Indices (N, 8) of each point's nearest others; none where there are too few points to compare."""
    if len(points) <= 2 * NEIGHBOURS:
        return np.empty((0, NEIGHBOURS), int)
    return np.asarray(cKDTree(points).query(points, NEIGHBOURS + 1)[1])[:, 1:]


def _outliers(moved: Floats, good: Bools, neighbours: Ints) -> Bools:
    """Normalised median test: markers that move unlike those around them, or have too few around them to tell.

    Source: J. Westerweel and F. Scarano, Universal outlier detection for PIV data, Exp. Fluids 39, 2005.
    """
    followed = good[neighbours]
    count = followed.sum(axis=1)
    middle = _median_of_first(np.where(followed[..., None], moved[neighbours], np.inf), count)
    away = np.where(followed[..., None], np.abs(moved[neighbours] - middle[:, None]), np.inf)
    spread = _median_of_first(away, count)
    unlike = (np.abs(moved - middle) > OUTLIER * spread + OUTLIER * OUTLIER_FLOOR_PX).any(axis=1)
    return np.asarray(unlike | (count < FEWEST_NEIGHBOURS))


def _median_of_first(values: Floats, count: Ints) -> Floats:
    """Median (N, 2) of the `count` (N,) smallest of values (N, K, 2); 0 where there are none."""
    ordered = np.sort(values, axis=1)
    lower, upper = (np.maximum(k, 0)[:, None, None] for k in ((count - 1) // 2, count // 2))
    upper = np.minimum(upper, values.shape[1] - 1)
    both = np.take_along_axis(ordered, lower, axis=1) + np.take_along_axis(ordered, upper, axis=1)
    return np.where((count > 0)[:, None], 0.5 * both[:, 0], 0.0)


def _common_motion(moved: Floats, good: Bools) -> Floats:
    return np.asarray(np.median(moved[good], axis=0) if good.any() else np.zeros(2), np.float32)


def _paper_tracks(movie: Movie, markers: Markers, window_px: int | None,
                  tell: Callable[[float], None]) -> Tracks:
    """Track from frame to frame; widen the window while the farthest marker outruns it."""
    window = window_px or PAPER_FIRST_WINDOW_PX
    for _ in range(PAPER_ROUNDS + 1):
        position = _paper_pass(movie, markers.position_px, window, tell)
        farthest = float(np.hypot(*np.moveaxis(position - position[0], -1, 0)).max())
        if window_px or farthest <= window:
            break
        window += 5
    ok = np.ones(position.shape[:2], bool)
    return Tracks(position, ok, "paper", 0, window)


def _paper_pass(movie: Movie, start: Floats, window: int, tell: Callable[[float], None]) -> Floats:
    at = start[:, ::-1].astype(np.float32)
    position = np.empty((movie.count, len(start), 2), np.float32)
    position[0] = at[:, ::-1]
    last = stretch_each(movie.frames[0])
    for t in range(1, movie.count):
        image = stretch_each(movie.frames[t])
        found, _, _ = cv2.calcOpticalFlowPyrLK(last, image, at, at.copy(), winSize=(window, window),
                                               maxLevel=PAPER_PYRAMID, criteria=PAPER_STOP)
        at = np.asarray(found, np.float32)
        position[t], last = at[:, ::-1], image
        tell((t + 1) / movie.count)
    return position
