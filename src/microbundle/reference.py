"""Find a frame in which the tissue rests, before anything else is measured.

A hundred strong points are followed through the movie at half resolution; their contraction signal shows when
the tissue is relaxed. Movies that start contracted, with one beat or irregular ones, need no trimming.
"""

from __future__ import annotations

import cv2
import numpy as np

from .config import Config
from .contraction import contraction_signal, frame_noise
from .data import Floats, Masks, Movie
from .scaling import Scaling, movie_scaling

POINTS = 100
MAX_FRAMES = 400
"""Longer movies are sampled at this many frames, one after the other from the start."""
MIN_FOLLOWED = 0.5


def find_relaxed_frame(movie: Movie, masks: Masks, config: Config) -> int:
    """Choose the frame that all others are compared with: the calmest of the relaxed ones.

    `paper` always takes frame 0; a frame given in the settings is used as it is.
    """
    if config.method == "paper":
        return 0
    if config.tracking.reference_frame is not None:
        return min(config.tracking.reference_frame, movie.count - 1)
    if movie.count < 3:
        return 0
    frames = np.arange(min(movie.count, MAX_FRAMES))
    scaling = movie_scaling(movie, masks.tissue)
    for start in (0, len(frames) // 2):
        signal = _coarse_signal(movie, masks, scaling, frames, int(frames[start]))
        if signal is not None:
            return int(frames[calmest_relaxed(signal)])
    return 0


def calmest_relaxed(signal: Floats) -> int:
    """Choose the frame of a contraction signal (T,) that is near its relaxed level and moves least."""
    low, high = np.quantile(signal, [0.1, 0.95])
    noise = frame_noise(signal)
    limit = low + 0.15 * (high - low) + (noise if np.isfinite(noise) else 0.0)
    smooth = np.convolve(np.pad(signal, 2, mode="edge"), np.array([1, 4, 6, 4, 1]) / 16, mode="valid")
    relaxed = np.flatnonzero(smooth <= limit)
    if len(relaxed) == 0:
        return int(np.argmin(smooth))
    speed = np.abs(np.gradient(smooth))[relaxed]
    calm = speed <= np.quantile(speed, 0.25)
    return int(relaxed[calm][0])


def _coarse_signal(movie: Movie, masks: Masks, scaling: Scaling, frames: np.ndarray, start: int) -> Floats | None:
    """Contraction signal of strong points at half resolution, or None where most of them are lost."""
    def half(t: int) -> np.ndarray:
        return cv2.resize(scaling(movie.frames[t]), None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA)

    first = half(start)
    tissue = cv2.resize(scaling.tissue.astype(np.uint8), first.shape[::-1], interpolation=cv2.INTER_NEAREST)
    found = cv2.goodFeaturesToTrack(first, POINTS, 0.01, 4, mask=tissue)
    if found is None or len(found) < 8:
        return None
    points, moved, ok = found.reshape(-1, 2), [], []
    for t in frames:
        to, status, _ = cv2.calcOpticalFlowPyrLK(first, half(int(t)), points, points.copy(), winSize=(11, 11),
                                                 maxLevel=3)
        moved.append(to - points)
        ok.append(status.ravel() > 0)
    followed = np.array(ok)
    if followed.mean() < MIN_FOLLOWED:
        return None
    u = np.where(followed[..., None], np.array(moved)[..., ::-1], np.nan)
    return contraction_signal(u, points[:, ::-1].astype(float), masks.axis.direction)
