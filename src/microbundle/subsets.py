"""Follow single points, or one rigid body, by the grey values around them: for sparse regions such as pillars.

Every frame is compared with one reference frame, so errors do not add up. The search for the square around a point, or
for the pixels of a body (`patches`), starts from where the last two frames point to, and where that fails or fits
badly once more from pyramidal Lucas-Kanade, and from what the others do.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, Literal

import cv2
import numpy as np
from numpy.typing import ArrayLike
from scipy import ndimage

from .bspline import Float32
from .data import BodyMotion, Bools, Floats, Image, Movie, Tracks
from .data import known as known_points
from .errors import CannotMeasure, ConfigError, MaskUnusable, NoTexture
from .patches import FEWEST_PIXELS, MARGIN_PX, Found, Mean, Noise, Part, Patches, box

BORDER_PX = 3
"""Pixels this near to the picture's border are left out: their splines need pixels beyond it."""
TEMPLATE_MARGIN_PX = 6
"""Around a body, for the slopes at its border."""
DOUBT, LEAST_DOUBT = 2.0, 0.03
"""The search starts once more where the share that is not found again is this many times the least so far."""
ODD, ODD_FLOOR = 4.0, 0.25
"""A patch shows something else in frames where that share is this many times the usual."""
LEAST_VARIANCE = 1e-4
"""Of the residual in a usual frame, as a share of the patch's own."""
STILL = np.eye(2, 3)
ROTATION = 3
"""Row of the warp's parameters that is the angle of a small rotation, clockwise on the screen."""
PYRAMID, MOST_WINDOW_PX = 3, 31
ANCHORS = 40
"""Points of a body that Lucas-Kanade follows."""
GLARE_PERCENT = (0.5, 99.5)


def follow_points(movie: Movie, points_px: ArrayLike, *, half_width_px: int = 10, mask: Bools | None = None,
                  reference_frame: int = 0, max_error_px: float = 0.5) -> Tracks:
    """Follow points (N, 2), each by the square of 2 half_width_px + 1 px around it, through all frames of a movie.

    Points are (row, col) in px in the reference frame. Only pixels inside `mask` (R, C) count, when it is given: let
    it hold what moves together, so that a square at a border does not see both sides. `position_px` (T, N, 2) is NaN
    and `ok` False wherever a point cannot be followed: fewer than 60 usable pixels, no texture, a search that does
    not end, a picture that does not match, or a standard error above `max_error_px`. `position_se_px` (T, N, 2) is the
    standard error of the way from the reference frame; it holds the noise of both frames, and grows where a frame's
    residual is far above that of the point's other frames. A pattern that repeats itself can be followed only while
    it moves by less than half of its period from frame to frame.

    Raises ConfigError for points, a half width or a reference frame that are not allowed, and MaskUnusable.
    """
    points = _checked_points(points_px)
    if not 3 <= half_width_px <= 100:
        raise ConfigError(f"half_width_px: expected 3 to 100 px; found {half_width_px}. 10 suits most textures")
    usable = _usable(movie, mask, reference_frame)
    corner = np.rint(points).astype(int) - int(half_width_px)
    patches = Patches(_picture(movie, reference_frame), usable, corner, (2 * int(half_width_px) + 1,) * 2, points,
                       "affine")
    count = movie.count, len(points)
    position, ok = np.full((*count, 2), np.nan), np.zeros(count, bool)
    variance, unlike = np.zeros(count), np.ones(count)
    noise = Noise(patches, movie.count)
    for t, _, found in _frames(movie, patches, reference_frame, points[:, None]):
        position[t] = points + found.warp[:, :, 2]
        ok[t], variance[t], unlike[t] = found.ok, found.variance, 1 - found.match
        noise.add(t, found)
    ok &= ~_odd(unlike, ok)
    usual = _usual(variance, ok)
    # What exceeds the usual residual is no noise but another picture, and does not average out over the pixels.
    excess = variance / (ODD * np.maximum(usual, LEAST_VARIANCE * patches.contrast))
    se = noise.standard_error(variance, (0, 1)) * patches.noisy_slopes(usual / 2)
    se *= np.sqrt(np.maximum(excess, 1))[:, :, None]
    ok &= se.max(axis=-1) <= max_error_px
    position[~ok], se[~ok] = np.nan, np.nan
    return Tracks(position, ok, "subsets", reference_frame, 2 * int(half_width_px) + 1, position_se_px=se)


def follow_body(movie: Movie, mask: Bools, *, reference_frame: int = 0,
                model: Literal["rigid", "translation"] = "rigid") -> BodyMotion:
    """Follow one body, such as a pillar's head, given as a mask (R, C) in the reference frame, through all frames.

    Only pixels within the mask count, and of these not the ones at the picture's border. After a first pass, all
    frames are pulled back to the reference and averaged, and every frame is registered once more against this
    template: slopes and residual are then free of the reference frame's noise, and the residual's variance is halved.
    Where the template itself lies is as uncertain as the reference frame is noisy; that error is the same in all
    frames and cancels wherever two of them are compared. The standard errors are those of the way from the reference
    frame and hold both parts. Frames are decoded one by one, twice.

    Frames that do not show the body are NaN, with `ok` False. Raises ConfigError for a reference frame or a model
    that are not allowed, MaskUnusable, and NoTexture where the mask holds nothing to follow.
    """
    if model not in ("rigid", "translation"):
        raise ConfigError(f"model: expected rigid or translation; found {model!r}")
    usable = _usable(movie, mask, reference_frame)
    picture, (corner, size) = _picture(movie, reference_frame), box(usable)
    center = np.argwhere(mask).mean(axis=0)[None]
    patches = Patches(picture, usable, corner, size, center, model)
    if not patches.good[0]:
        raise NoTexture(f"{movie.name}: expected a body with texture in all directions on {FEWEST_PIXELS} px or more; "
                        f"found none in frame {reference_frame}, in the {int(usable.sum())} px of the mask that lie "
                        f"{BORDER_PX} px inside the picture. Is the mask on the body, and the body in focus?")
    anchors = _anchors(patches, usable)
    mean = Mean(ndimage.binary_dilation(usable, iterations=TEMPLATE_MARGIN_PX), center)
    start = np.tile(STILL, (movie.count, 1, 1, 1))
    for t, part, found in _frames(movie, patches, reference_frame, anchors):
        if found.ok[0]:
            start[t] = found.warp
            mean.add(part, found)
    template = Patches(mean.picture(picture), usable, corner, size, center, model)
    noise = Noise(template, movie.count)
    warp, ok = np.empty((movie.count, 2, 3)), np.zeros((movie.count, 1), bool)
    variance, unlike = np.zeros((movie.count, 1)), np.ones((movie.count, 1))
    for t, _, found in _frames(movie, template, reference_frame, anchors, start):
        warp[t], ok[t], variance[t], unlike[t] = found.warp[0], found.ok, found.variance, 1 - found.match
        noise.add(t, found)
    lost = ~(ok & ~_odd(unlike, ok))[:, 0]
    se = noise.standard_error(variance + variance[reference_frame], (0, 1, ROTATION))[:, 0]
    steeper = patches.noisy_slopes(_usual(variance, ok))[0]
    se *= [*steeper, steeper.mean()]
    residual = np.sqrt(variance[:, 0] / template.contrast[0])
    shift, turn, turn_se = warp[:, :, 2], np.degrees(np.arctan2(warp[:, 0, 1], warp[:, 0, 0])), np.degrees(se[:, 2])
    for values in (shift, se, turn, turn_se, residual):
        values[lost] = np.nan
    if model == "translation":
        turn[:], turn_se[:] = np.nan, np.nan
    return BodyMotion(shift, turn, se[:, :2], turn_se, residual, ~lost, center[0], reference_frame, model)


def _frames(movie: Movie, patches: Patches, reference: int, anchors: Floats,
            known: Floats | None = None) -> Iterator[tuple[int, Part, Found]]:
    """Find all patches in every frame, from the reference to both ends; from the warps (T, N, 2, 3), where known.

    Where a search fails it starts again where Lucas-Kanade has found the patch's anchors (N, M, 2), and then from the
    motion that the others share.
    """
    still = np.tile(STILL, (len(patches.center), 1, 1))
    restart, least = _Restart(patches, anchors), np.full(len(still), np.inf)
    for order in (range(reference, movie.count), range(reference - 1, -1, -1)):
        last, pace = still, np.zeros((len(still), 2, 1))
        for t in order:
            frame = movie.frames[t]
            if frame.dtype.kind == "f" and not np.isfinite(frame).all():
                frame = np.zeros(frame.shape, np.float32)  # in which nothing is found
            start = known[t] if known is not None else np.concatenate([last[:, :, :2], last[:, :, 2:] + pace], axis=2)
            part = Part.of(frame, patches, start)
            found = patches.find(part, start, patches.good)
            trusted = DOUBT * np.where(np.isfinite(least), least, LEAST_DOUBT)
            for way in (restart.shift, _common_shift):
                sure = found.ok & (1 - found.match <= trusted)
                again = np.where((patches.good & ~sure)[:, None], way(frame, found, sure), np.nan)
                missed = known_points(again)
                if missed.any():
                    start = np.where(missed[:, None, None], np.dstack([still[:, :, :2], again]), start)
                    part = Part.of(frame, patches, start)
                    found = _either(found, patches.find(part, start, missed))
            if t != reference:
                least = np.where(found.ok, np.minimum(np.maximum(1 - found.match, LEAST_DOUBT), least), least)
            yield t, part, found
            if known is None:
                seen = found.ok[:, None, None]
                pace = np.where(seen, (found.warp - last)[:, :, 2:], 0.0)
                last = np.where(seen, found.warp, last)


class _Restart:
    """Pyramidal Lucas-Kanade from the reference frame."""

    def __init__(self, patches: Patches, anchors: Floats) -> None:
        self.first, self.good, self.anchors = _eight_bits(patches.picture), patches.good, anchors
        self.window = min(max(patches.f.shape[1:]), MOST_WINDOW_PX)

    def shift(self, frame: Image, _found: Found, sure: Bools) -> Floats:
        """Median shift (N, 2) of each patch's anchors (N, M, 2), NaN where it is sure already or none is found."""
        out = np.full((len(sure), 2), np.nan)
        chosen = np.flatnonzero(self.good & ~sure)
        if not len(chosen):
            return out
        begin = np.ascontiguousarray(self.anchors[chosen].reshape(-1, 2)[:, ::-1], np.float32)
        end, status, _ = cv2.calcOpticalFlowPyrLK(self.first, _eight_bits(frame), begin, begin.copy(), maxLevel=PYRAMID,
                                                  winSize=(self.window, self.window))
        moved = np.where(status > 0, end - begin, np.nan)[:, ::-1].reshape(len(chosen), -1, 2)
        for i, shifts in zip(chosen, moved, strict=True):
            known = shifts[known_points(shifts)]
            if len(known):
                out[i] = np.median(known, axis=0)
        return out


def _common_shift(_frame: Image, found: Found, sure: Bools) -> Floats:
    """Median shift (N, 2) of the patches that are surely found, NaN where there are none."""
    return np.broadcast_to(np.median(found.warp[sure, :, 2], axis=0) if sure.any() else np.nan, (len(sure), 2))


def _eight_bits(frame: Image) -> Image:
    """A frame scaled by its own range of grey values, whatever the light."""
    low, high = np.percentile(frame[::4, ::4], GLARE_PERCENT)
    return np.asarray(np.clip((frame - low) * (255 / max(high - low, 1e-12)), 0, 255), np.uint8)


def _either(first: Found, second: Found) -> Found:
    """Of each patch the search that fits better."""
    better = second.ok & (~first.ok | (second.match > first.match))

    def pick(a: Any, b: Any) -> Any:
        return np.where(better.reshape(-1, *[1] * (a.ndim - 1)), b, a)

    return Found(**{name: pick(getattr(first, name), getattr(second, name)) for name in vars(first)})


def _odd(unlike: Floats, ok: Bools) -> Bools:
    """Where (T, N) the share of a patch that is not found again is far from usual."""
    return np.asarray(unlike > np.maximum(ODD * _usual(unlike, ok), ODD_FLOOR))


def _usual(values: Floats, ok: Bools) -> Floats:
    """Median (N,) of values (T, N) where they are ok; 0 where none is."""
    return np.array([np.median(v[k]) if k.any() else 0.0 for v, k in zip(values.T, ok.T, strict=True)])


def _picture(movie: Movie, frame: int) -> Float32:
    picture = np.array(movie.frames[frame], np.float32, order="C")
    if not np.isfinite(picture).all():
        raise CannotMeasure(f"{movie.name}: expected a reference frame of finite grey values; frame {frame} holds NaN "
                            "or infinity. Choose another reference_frame")
    return picture


def _usable(movie: Movie, mask: Bools | None, reference_frame: int) -> Bools:
    """Pixels (R, C) that may count."""
    if not 0 <= reference_frame < movie.count:
        raise ConfigError(f"reference_frame: expected 0 to {movie.count - 1}, a frame of {movie.name}; found "
                          f"{reference_frame}")
    if min(movie.shape) < 2 * MARGIN_PX:
        raise CannotMeasure(f"{movie.name}: expected frames of {2 * MARGIN_PX} x {2 * MARGIN_PX} px or more; found "
                            f"{movie.shape[0]} x {movie.shape[1]}")
    usable = np.zeros(movie.shape, bool)
    inner = slice(BORDER_PX, -BORDER_PX)
    usable[inner, inner] = True
    if mask is None:
        return usable
    mask = np.asarray(mask)
    if mask.dtype != np.bool_ or mask.shape != movie.shape:
        raise MaskUnusable(f"mask: expected a bool array of {movie.shape} like the frames of {movie.name}; found "
                           f"{mask.dtype} of {mask.shape}. Read a file with microbundle.read_mask")
    if not mask.any():
        raise MaskUnusable("mask: expected some pixels; it is empty")
    return usable & mask


def _checked_points(points_px: ArrayLike) -> Floats:
    points = np.asarray(points_px, float)
    if points.ndim != 2 or points.shape[1] != 2 or not len(points):
        raise ConfigError(f"points_px: expected (N, 2), a row and a col for each point; found shape {points.shape}")
    if not np.isfinite(points).all():
        raise ConfigError(f"points_px: expected numbers; found NaN or infinity in point "
                          f"{int(np.argmin(np.isfinite(points).all(axis=1)))}")
    return points


def _anchors(patches: Patches, usable: Bools) -> Floats:
    """Strong points (1, M, 2) of a body, its centre where there are none."""
    corners = cv2.goodFeaturesToTrack(_eight_bits(patches.picture), ANCHORS, 0.01, 5, mask=usable.astype(np.uint8))
    return patches.center[None] if corners is None else corners[None, :, 0, ::-1].astype(float)
