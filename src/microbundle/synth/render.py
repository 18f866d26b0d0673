"""Movies of a moving texture, with exact truth.

Every pixel x of frame t shows the material point X with X + u(X, t) = x. `invert` finds it by Newton's method on the
motion's own displacement and deformation gradient, and the texture is sampled there; nothing is warped twice, and no
pixel is moved by an approximate field, so the motion itself is the truth. Where the motion is
smooth, X - x is solved on a coarse grid and carried to the pixels by quintic interpolation; wherever that is off by
more than `tolerance_px`, the grid is halved, in the end to the pixels themselves. Frames are rendered when they are
asked for, and come out the same in any order.

The tissue lies on ground that stays where it is: `Tapered` fades the displacement in a band around the tissue, and
leaves it untouched within.

`patchwork` draws a frame the paper's way (S1 Appendix, "16 x 16 subdomains"): slightly overlapping tiles, each warped
by one projective map with linear interpolation. It moves fine texture too little (5 to 8 % at 0.2 px), so its truth is
only nearly true. It serves to reproduce published numbers.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field, replace
from functools import cached_property, lru_cache
from typing import Literal

import numpy as np
from scipy import interpolate, ndimage

from ..data import Bools, Floats, Image, Ints, Movie
from ..errors import ConfigError
from .motion import Composed, Inclusion, Motion, Rhythm, RigidMotion, TissueMotion
from .noise import NoiseModel
from .texture import Texture, band_limited, procedural_tissue

Ground = Literal["still", "moves"]

_MAX_STEPS = 40


@dataclass(frozen=True)
class Tapered:
    """Let a motion act on the tissue alone, and fade to rest in a band around it.

    Within the mask, holes included, displacement and gradient are exactly those of the motion.
    """

    motion: Motion
    mask: Bools
    """(R, C): what moves."""
    band_px: float = 24.0
    """Width of the transition outside the mask. Keep it above five times the largest displacement, or the picture
    folds; `invert` then says so."""

    @property
    def count(self) -> int:
        """Number of frames T."""
        return self.motion.count

    def displacement_px(self, points_px: Floats, frame: int) -> Floats:
        """See `Motion.displacement_px`."""
        points_px = np.asarray(points_px, float)
        w = self.weight(points_px)
        u = np.zeros(points_px.shape)
        u[w > 0] = w[w > 0, None] * self.motion.displacement_px(points_px[w > 0], frame)
        return u

    def gradient(self, points_px: Floats, frame: int) -> Floats:
        """See `Motion.gradient`."""
        points_px = np.asarray(points_px, float)
        w = self.weight(points_px)
        F = np.broadcast_to(np.eye(2), (len(points_px), 2, 2)).copy()
        F[w == 1] = self.motion.gradient(points_px[w == 1], frame)
        band = (w > 0) & (w < 1)
        X, w = points_px[band], w[band, None, None]
        # A cubic spline's slope by central differences, off by 1e-7 at most.
        step = 1e-3
        slope = np.stack([self.weight(X + d) - self.weight(X - d) for d in np.eye(2) * step], axis=1) / (2 * step)
        u = self.motion.displacement_px(X, frame)
        F[band] = w * self.motion.gradient(X, frame) + (1 - w) * np.eye(2) + u[:, :, None] * slope[:, None, :]
        return F

    def weight(self, points_px: Floats) -> Floats:
        """Share (N,) of the motion that acts at points (N, 2): 1 in the tissue, 0 beyond the band."""
        w = ndimage.map_coordinates(self._weights, np.asarray(points_px, float).T, order=3, mode="nearest",
                                    prefilter=False)
        # The spline's own rounding must not reach the truth inside.
        return np.asarray(np.where(w > 1 - 1e-12, 1.0, np.where(w < 1e-12, 0.0, w)))

    @cached_property
    def _weights(self) -> Floats:
        # These are B-spline coefficients as they stand, not samples: the spline then stays between 0 and 1, and is
        # exactly 1 wherever the 4 x 4 of them around a point are. Hence 1 is kept until 4 px outside the mask.
        sigma = max(self.band_px - 4, 1.0) / 7
        solid = ndimage.binary_fill_holes(np.pad(self.mask, 1))[1:-1, 1:-1]
        outside_px = ndimage.distance_transform_edt(~solid)
        grown = (outside_px <= 4 + 3.5 * sigma).astype(float)
        weights = ndimage.gaussian_filter(grown, sigma, mode="nearest", truncate=3.5)
        weights[outside_px <= 4] = 1.0
        return np.asarray(np.minimum(weights, 1.0))


def invert(motion: Motion, places_px: Floats, frame: int, *, start_px: Floats | None = None,
           tolerance_px: float = 1e-9) -> Floats:
    """Find the material points X (N, 2) that a motion carries to given places x (N, 2) in a frame.

    Raises ConfigError where there is no such point, because the motion folds the picture over itself.
    """
    x = np.asarray(places_px, float)
    X = np.array(x if start_px is None else start_px, float)
    open_ = np.arange(len(x))
    for _ in range(_MAX_STEPS):
        missing = x[open_] - X[open_] - motion.displacement_px(X[open_], frame)
        left = np.abs(missing).max(axis=1) > tolerance_px
        open_, missing = open_[left], missing[left]
        if not len(open_):
            return X
        F = motion.gradient(X[open_], frame)
        det = F[:, 0, 0] * F[:, 1, 1] - F[:, 0, 1] * F[:, 1, 0]
        if not np.isfinite(det).all() or (det <= 0.02).any():
            break
        step = np.stack([F[:, 1, 1] * missing[:, 0] - F[:, 0, 1] * missing[:, 1],
                         F[:, 0, 0] * missing[:, 1] - F[:, 1, 0] * missing[:, 0]], axis=1) / det[:, None]
        X[open_] += step
    worst = x[open_[0]]
    raise ConfigError(f"frame {frame}: no material point was found for {len(open_)} of {len(x)} places, the first at "
                      f"row {worst[0]:.1f}, col {worst[1]:.1f}. The motion folds the picture over itself there. Make "
                      "it smaller or smoother, or widen the band between tissue and still ground.")


def material_points(motion: Motion, shape: tuple[int, int], frame: int, tolerance_px: float = 5e-5) -> Floats:
    """Find the material point (R, C, 2) that each pixel of a frame shows, to `tolerance_px`; with 0, to 1e-9 px.

    The motion must be defined some 40 px around the frame as well.
    """
    pixels = _places(*(np.arange(float(n)) for n in shape))
    if tolerance_px <= 0:
        return invert(motion, pixels.reshape(-1, 2), frame).reshape(pixels.shape)
    spacing = 16
    nodes = _nodes(shape, spacing)
    places = _places(*nodes)
    moved: Floats = invert(motion, places.reshape(-1, 2), frame).reshape(places.shape) - places
    rough = np.ones(places.shape[:2], bool)
    while spacing > 1:
        spacing //= 2
        finer = _nodes(shape, spacing)
        places = _places(*finer)
        moved = _carry(moved, nodes, finer)
        # Where interpolation failed on the coarser grid, hold it against the motion at the new nodes, and solve those
        # that are off. Half of the tolerance is left for the error between nodes that passed.
        rough = rough[np.ix_(*(_nearest(n, f) for n, f in zip(nodes, finer, strict=True)))]
        X = places[rough] + moved[rough]
        off = np.abs(X + motion.displacement_px(X, frame) - places[rough]).max(axis=1) > 0.5 * tolerance_px
        rough[rough] = off
        moved[rough] = invert(motion, places[rough], frame, start_px=X[off],
                              tolerance_px=0.1 * tolerance_px) - places[rough]
        rough = ndimage.binary_dilation(rough, np.ones((3, 3), bool), iterations=2)
        nodes = finer
    # The splines' faint ringing must not make still ground flicker by a count.
    faint = (np.abs(moved).max(axis=-1) < tolerance_px) & moved.any(axis=-1)
    moved[faint] *= motion.displacement_px(places[faint], frame).any(axis=1, keepdims=True)
    return places + moved


def _nodes(shape: tuple[int, int], spacing: int) -> tuple[Floats, Floats]:
    """Rows and cols of a grid whose nodes are multiples of the spacing, two beyond each side of the picture."""
    if spacing == 1:
        return np.arange(float(shape[0])), np.arange(float(shape[1]))
    rows, cols = (np.arange(-2, -(-n // spacing) + 3) * float(spacing) for n in shape)
    return rows, cols


def _nearest(nodes: Floats, places: Floats) -> Ints:
    return np.asarray(np.rint((places - nodes[0]) / (nodes[1] - nodes[0])).astype(int))


def _places(rows: Floats, cols: Floats) -> Floats:
    """All points (R, C, 2) of a grid."""
    return np.stack(np.meshgrid(rows, cols, indexing="ij"), axis=-1)


def _carry(values: Floats, nodes: tuple[Floats, ...], places: tuple[Floats, ...]) -> Floats:
    """Interpolate values (n, m, 2) on a grid to the grid of `places` by quintic splines along both sides."""
    rows, cols = (_spline_matrix(tuple(n), tuple(p)) for n, p in zip(nodes, places, strict=True))
    planes = [rows @ np.ascontiguousarray(values[..., k]) @ cols.T for k in (0, 1)]
    return np.stack(planes, axis=-1)


@lru_cache(maxsize=16)
def _spline_matrix(nodes: tuple[float, ...], places: tuple[float, ...]) -> Floats:
    return np.asarray(interpolate.make_interp_spline(nodes, np.eye(len(nodes)), k=5)(np.asarray(places)))


@dataclass(frozen=True)
class Truth:
    """What a synthetic movie really shows."""

    motion: Motion
    """Motion of the tissue in the picture, stage included; exact within the mask."""
    mask: Bools
    """(R, C): the tissue in its relaxed state."""
    fps: float
    um_per_px: float
    rhythm: Rhythm | None = None
    """Beats of the tissue, where the motion has a rhythm."""
    reference_frame: int = 0
    """Frame that `from_reference_px` counts displacement from."""

    def displacement_px(self, points_px: Floats, frame: int) -> Floats:
        """Displacement (N, 2) from the relaxed state of the material points (N, 2) of that state."""
        return self.motion.displacement_px(np.asarray(points_px, float), frame)

    def F(self, points_px: Floats, frame: int) -> Floats:
        """Deformation gradient (N, 2, 2) at the material points (N, 2)."""
        return self.motion.gradient(np.asarray(points_px, float), frame)

    def from_reference_px(self, points_px: Floats, frame: int) -> Floats:
        """Displacement (N, 2) between `reference_frame` and a frame, of points (N, 2) seen in the reference frame."""
        X = invert(self.motion, np.asarray(points_px, float), self.reference_frame)
        return X + self.motion.displacement_px(X, frame) - points_px

    def mad_px(self, points_px: Floats, frames: Iterable[int] | None = None) -> Floats:
        """Mean absolute displacement of points (N, 2) from the relaxed state, in all or the given frames (T,)."""
        points = np.asarray(points_px, float)
        chosen = range(self.motion.count) if frames is None else frames
        return np.array([np.hypot(*self.motion.displacement_px(points, t).T).mean() for t in chosen])

    def points_px(self, spacing_px: float = 4.0) -> Floats:
        """Points (N, 2) of a regular grid that lie in the mask."""
        r, c = np.nonzero(self.mask)
        grid = np.stack(np.meshgrid(np.arange(r.min(), r.max() + 1, spacing_px),
                                    np.arange(c.min(), c.max() + 1, spacing_px), indexing="ij"), axis=-1).reshape(-1, 2)
        near = np.rint(grid).astype(int)
        return np.asarray(grid[self.mask[near[:, 0], near[:, 1]]], float)


@dataclass(frozen=True)
class Rendered:
    """Frames of a moving texture, drawn when they are asked for."""

    texture: Texture
    motion: Motion
    shape: tuple[int, int]
    noise: NoiseModel = field(default_factory=NoiseModel)
    how: Literal["exact", "paper"] = "exact"
    tolerance_px: float = 5e-5

    def __len__(self) -> int:
        return self.motion.count

    def __getitem__(self, index: int) -> Image:
        count = len(self)
        if not -count <= index < count:
            raise IndexError(f"frame {index} is not one of the {count} frames of this movie")
        frame = index % count
        return self.noise.quantise(self.noise.disturb(self.perfect(frame), frame, count))

    def perfect(self, frame: int) -> Floats:
        """Picture (R, C) of a frame before any disturbance, 0 black to 1 white."""
        if self.how == "paper":
            return patchwork(self._relaxed, self.motion, frame)
        X = material_points(self.motion, self.shape, frame, self.tolerance_px)
        return self.texture.sample(X.reshape(-1, 2)).reshape(self.shape)

    @cached_property
    def _relaxed(self) -> Floats:
        pixels = np.stack(np.meshgrid(*(np.arange(n) for n in self.shape), indexing="ij"), axis=-1).reshape(-1, 2)
        return self.texture.sample(pixels.astype(float)).reshape(self.shape)


@dataclass(frozen=True)
class SyntheticMovie:
    """A movie and the truth about it."""

    movie: Movie
    truth: Truth
    rendered: Rendered
    pillars: tuple[Bools, ...] = ()
    """Masks (R, C) of the pillar caps, where the picture has any."""

    def array(self) -> Image:
        """Draw all frames (T, R, C)."""
        return np.stack([self.rendered[t] for t in range(len(self.rendered))])

    def drawn(self, clean: Floats | None = None) -> SyntheticMovie:
        """Hold all frames in memory: an analysis looks at each several times. `clean` are the frames before any
        disturbance (T, R, C), where they are there already."""
        if clean is None:
            frames = self.array()
        else:
            noise, count = self.rendered.noise, len(self.rendered)
            frames = np.stack([noise.quantise(noise.disturb(clean[t], t, count)) for t in range(count)])
        return replace(self, movie=replace(self.movie, frames=frames))


def render_movie(texture: Texture, motion: Motion, mask: Bools, *, moving: Bools | None = None,
                 ground: Ground = "still", band_px: float = 24.0, stage: Motion | None = None,
                 noise: NoiseModel | None = None, fps: float = 30.0, um_per_px: float = 4.0, name: str = "synthetic",
                 how: Literal["exact", "paper"] = "exact") -> SyntheticMovie:
    """Put a texture into motion and get a movie with its truth; nothing is drawn before a frame is asked for.

    `mask` (R, C) is the tissue; `moving` is what moves with it, by default the tissue with its holes filled. With
    `ground="still"` everything else rests, after a transition of `band_px`. `stage` moves the whole picture on top.
    """
    shape = (int(mask.shape[0]), int(mask.shape[1]))
    if not mask.any():
        raise ValueError("mask: expected some tissue, found none")
    rhythm = motion.rhythm if isinstance(motion, TissueMotion) else None
    if ground == "still":
        motion = Tapered(motion, mask if moving is None else moving | mask, band_px)
    if stage is not None:
        motion = Composed((motion, stage))
    frames = Rendered(texture, motion, shape, noise or NoiseModel(), how)
    movie = Movie(name=name, frames=frames, shape=shape, time_s=np.arange(motion.count) / fps, time_source="user",
                  um_per_px=um_per_px, um_per_px_source="user")
    return SyntheticMovie(movie, Truth(motion, np.asarray(mask, bool), fps, um_per_px, rhythm), frames)


def beating_tissue(shape: tuple[int, int] = (256, 256), frames: int = 60, fps: float = 30.0, um_per_px: float = 4.0,
                   peak_px: float = 2.0, seed: int = 0, noise: NoiseModel | None = None, *, angle_deg: float = 0.0,
                   rhythm: Rhythm | None = None, inclusion: bool = True,
                   drift_px_per_frame: tuple[float, float] = (0.0, 0.0)) -> SyntheticMovie:
    """Make a movie of a beating bundle out of nothing but a seed, as `microbundle demo` does.

    The tissue is painted (`procedural_tissue`), its pillars are pulled inward by `peak_px`, and it beats 1.25 times a
    second unless a `rhythm` is given, which then has its own number of frames. `noise` defaults to that of a good
    camera; `NoiseModel()` gives a clean movie.
    """
    picture = procedural_tissue(shape, seed, angle_deg=angle_deg)
    rhythm = rhythm or Rhythm(frames, fps / 1.25, amplitude_variation=0.05, period_variation=0.03, seed=seed)
    side = min(shape)
    passive = None
    if inclusion:
        along = 0.12 * side
        a = np.deg2rad(angle_deg)
        middle = (picture.center_px[0] + along * np.sin(a), picture.center_px[1] + along * np.cos(a))
        passive = Inclusion(middle, 0.06 * side)
    motion = TissueMotion(rhythm, picture.center_px, picture.half_length_px, picture.half_width_px, peak_px,
                          angle_deg=angle_deg, inclusion=passive)
    if noise is None:
        noise = NoiseModel(full_well_electrons=30_000, read_noise=0.001, flicker_gain=0.001, seed=seed)
    stage = RigidMotion.drift(rhythm.count, drift_px_per_frame) if any(drift_px_per_frame) else None
    made = render_movie(band_limited(picture.image), motion, picture.tissue, moving=picture.body, stage=stage,
                        noise=noise, band_px=max(20.0, 6 * peak_px), fps=fps, um_per_px=um_per_px, name=f"demo_{seed}")
    return replace(made, pillars=picture.pillars)


def patchwork(image: Floats, motion: Motion, frame: int, *, tiles: int = 16, overlap_px: float = 2.0) -> Floats:
    """Warp a picture (R, C) in tiles by one projective map each, as the paper does; in overlaps the brighter wins."""
    import cv2

    rows, cols = image.shape
    out = np.zeros((rows, cols), np.float32)
    edges = [np.linspace(0, n - 1, tiles + 1) for n in (rows, cols)]
    source = image.astype(np.float32)
    for i in range(tiles):
        for j in range(tiles):
            low = np.array([edges[0][i], edges[1][j]]) - overlap_px
            high = np.array([edges[0][i + 1], edges[1][j + 1]]) + overlap_px
            corners = np.array([low, (low[0], high[1]), high, (high[0], low[1])])
            moved = corners + motion.displacement_px(corners, frame)
            # The tile is cut with one more pixel on every side, and the map is taken in the tile's own frame.
            r0, c0 = (max(int(np.floor(v)) - 1, 0) for v in low)
            r1, c1 = (min(int(np.ceil(v)) + 2, n) for v, n in zip(high, (rows, cols), strict=True))
            R0, C0 = (max(int(np.floor(v)) - 1, 0) for v in moved.min(axis=0))
            R1, C1 = (min(int(np.ceil(v)) + 2, n) for v, n in zip(moved.max(axis=0), (rows, cols), strict=True))
            if R1 <= R0 or C1 <= C0:
                continue
            xy = (corners - (r0, c0))[:, ::-1].astype(np.float32)
            to_xy = (moved - (R0, C0))[:, ::-1].astype(np.float32)
            warped = cv2.warpPerspective(source[r0:r1, c0:c1], cv2.getPerspectiveTransform(xy, to_xy),
                                         (C1 - C0, R1 - R0), flags=cv2.INTER_LINEAR)
            out[R0:R1, C0:C1] = np.maximum(out[R0:R1, C0:C1], warped)
    return out.astype(float)


def with_noise(synthetic: SyntheticMovie, noise: NoiseModel) -> SyntheticMovie:
    """Give the same movie another noise; the truth stays the same."""
    frames = replace(synthetic.rendered, noise=noise)
    return replace(synthetic, rendered=frames, movie=replace(synthetic.movie, frames=frames))
