"""The nouns of microbundle: what one stage hands to the next.

One convention, everywhere: an image is indexed `[row, col]` with rows downward; every point, vector and tensor index
is in the order (row, col). Lengths are in pixels and times in frames until `metrics` turns them into physical units
with `um_per_px` and `time_s`. A field's name carries its unit. Letters in shapes: T frames, N markers, B beats,
S sub-domains, R rows, C columns. What is missing is NaN, and `ok` is False there; arrays keep their length from
stage to stage.

All classes are frozen, and check the shapes they are given (ValueError: a mistake in the program, not in the data).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, Protocol

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from .field import Field

Floats = NDArray[np.floating[Any]]
Ints = NDArray[np.integer[Any]]
Bools = NDArray[np.bool_]
Image = NDArray[Any]
"""One grey frame (R, C) in the numbers the file holds."""

Source = Literal["file", "user", "unknown"]
"""Where a calibration comes from."""

PillarSource = Literal["supplied", "found", "mirrored"]
"""Where a pillar's mask comes from."""

Level = Literal["info", "review", "fail"]
Verdict = Literal["pass", "review", "fail"]


@dataclass(frozen=True)
class Finding:
    """One thing a reader of the result should know: what was found, how bad it is, and what to do about it."""

    key: str
    """Short name that does not change between versions, such as `mask_unstable`."""
    level: Level
    message: str
    value: float | None = None
    limit: float | None = None


class Frames(Protocol):
    """A sequence of grey frames that are decoded when they are asked for."""

    def __len__(self) -> int: ...

    def __getitem__(self, index: int) -> Image: ...


@dataclass(frozen=True)
class Movie:
    """A movie whose frames are decoded on demand, with the calibration that is known of it."""

    name: str
    frames: Frames
    shape: tuple[int, int]
    """Rows and columns of every frame."""
    time_s: Floats | None = None
    """Time of each frame in seconds (T,), or None where unknown."""
    time_source: Source = "unknown"
    um_per_px: float | None = None
    um_per_px_source: Source = "unknown"
    supplied_masks: Mapping[str, Bools] = field(default_factory=dict)
    """Masks that came with the movie, by name: `tissue`, `pillar_1`, `pillar_2`, ... each (R, C)."""
    files: tuple[Path, ...] = ()
    """The files the frames come from, in order; empty for a movie made in memory."""
    findings: tuple[Finding, ...] = ()
    taken: Mapping[str, int] = field(default_factory=dict)
    """Which `series`, `channel` and `z` of the file it is, counted from 0; empty for a movie made in memory."""

    def __post_init__(self) -> None:
        if self.time_s is not None:
            _expect("time_s", self.time_s, (len(self.frames),))
        for name, mask in self.supplied_masks.items():
            _expect(f"supplied_masks[{name!r}]", mask, self.shape)

    @property
    def count(self) -> int:
        """Number of frames T."""
        return len(self.frames)

    @property
    def frames_per_s(self) -> float | None:
        """Frames per second by the median time between frames, or None where the times are unknown."""
        if self.time_s is None or len(self.time_s) < 2:
            return None
        return float(1.0 / np.median(np.diff(self.time_s)))

    @classmethod
    def from_array(cls, array: Image, *, fps: float | None = None, um_per_px: float | None = None,
                   name: str = "movie", tissue_mask: Bools | None = None) -> Movie:
        """Make a movie of an array (T, R, C) that is already in memory."""
        array = np.asarray(array)
        if array.ndim != 3:
            raise ValueError(f"array: expected (frames, rows, cols), found shape {array.shape}")
        return cls(
            name=name, frames=array, shape=(int(array.shape[1]), int(array.shape[2])),
            time_s=None if fps is None else np.arange(len(array)) / fps,
            time_source="unknown" if fps is None else "user",
            um_per_px=um_per_px, um_per_px_source="unknown" if um_per_px is None else "user",
            supplied_masks={} if tissue_mask is None else {"tissue": np.asarray(tissue_mask, bool)},
        )


@dataclass(frozen=True)
class TissueAxis:
    """Where the tissue lies and how large it is, measured along and across its long axis."""

    center_px: Floats
    """Middle of the tissue (row, col), shape (2,)."""
    direction: Floats
    """Unit vector (row, col) along the tissue, shape (2,); its column part is never negative, so nothing is turned
    upside down (a vertical tissue points down)."""
    length_px: float
    width_center_px: float
    """Width across the axis at the centre."""
    width_min_px: float
    width_min_at_px: float
    """Place of the smallest width, as the distance from the centre along the axis."""

    def __post_init__(self) -> None:
        _expect("center_px", self.center_px, (2,))
        _expect("direction", self.direction, (2,))

    @property
    def angle_deg(self) -> float:
        """Angle from the image's column axis to the tissue, positive clockwise on the screen, in (-90, 90]."""
        return float(np.degrees(np.arctan2(self.direction[0], self.direction[1])))


@dataclass(frozen=True)
class Masks:
    """Which pixels are tissue, and how far that answer can be trusted."""

    tissue: Bools
    """(R, C)"""
    axis: TissueAxis
    method: str
    """`supplied`, or the name of the automatic method that made it."""
    stability: float | None = None
    """Smallest overlap (intersection over union) with the masks that slightly different parameters, and other parts
    of the movie, give; None for a supplied mask."""
    findings: tuple[Finding, ...] = ()

    def __post_init__(self) -> None:
        if self.tissue.ndim != 2 or self.tissue.dtype != np.bool_:
            raise ValueError(f"tissue: expected a 2-D bool array, found {self.tissue.dtype} {self.tissue.shape}")


@dataclass(frozen=True)
class Pillars:
    """Which pixels are pillars, in the order in which they stand along the tissue's axis. Letter in shapes: P."""

    masks: tuple[Bools, ...]
    """P masks, each (R, C)."""
    names: tuple[str, ...]
    """`1`, `2`, ...: along the axis, or the numbers of the supplied masks."""
    center_px: Floats
    """(P, 2): middle of each mask."""
    source: tuple[PillarSource, ...]
    """Whether each mask was supplied, found in the picture, or made as the mirror image of another."""
    score: tuple[float | None, ...]
    """Plausibility of each pillar that was found, 0 to 1; None for the others."""
    findings: tuple[Finding, ...] = ()

    def __post_init__(self) -> None:
        p = len(self.masks)
        _expect("center_px", self.center_px, (p, 2))
        for name in ("names", "source", "score"):
            _expect(name, getattr(self, name), (p,))
        for mask in self.masks:
            _expect("mask", mask, self.masks[0].shape)

    def __len__(self) -> int:
        return len(self.masks)


@dataclass(frozen=True)
class Markers:
    """Points of the tissue that are followed through the movie."""

    position_px: Floats
    """(N, 2) in the reference frame."""
    reference_frame: int
    quality: float
    """Shi-Tomasi quality level at which they were accepted."""
    spacing_px: float
    """Smallest distance between two of them."""
    coverage_px: float
    """Tissue pixels per marker."""
    findings: tuple[Finding, ...] = ()

    def __post_init__(self) -> None:
        _expect("position_px", self.position_px, (None, 2))

    def __len__(self) -> int:
        return len(self.position_px)


@dataclass(frozen=True)
class Tracks:
    """Where every marker is in every frame."""

    position_px: Floats
    """(T, N, 2), NaN where lost."""
    ok: Bools
    """(T, N): False where the marker was lost in that frame."""
    method: str
    reference_frame: int
    window_px: int
    """Side of the square patch that was compared."""
    forward_backward_px: Floats | None = None
    """Median over frames of the distance by which tracking there and back misses, per marker (N,)."""
    field: Field | None = None
    """The displacement field that the markers were sampled from, for the accurate method."""
    residual: Floats | None = None
    """(T,): what the field leaves unexplained of each frame, in standard deviations of the tissue's grey values."""
    faintest_px: float = float("nan")
    """Mean displacement at the peak of the faintest beats that stand out of the noise, where the method knows it."""
    findings: tuple[Finding, ...] = ()
    position_se_px: Floats | None = None
    """(T, N, 2): standard error of the way from the reference frame, for the method `subsets`; NaN where lost."""

    def __post_init__(self) -> None:
        _expect("position_px", self.position_px, (None, None, 2))
        _expect("ok", self.ok, self.position_px.shape[:2])
        if self.position_se_px is not None:
            _expect("position_se_px", self.position_se_px, self.position_px.shape)

    @property
    def kept(self) -> Bools:
        """Markers (N,) that were followed in at least half of the frames; the others carry no result."""
        return np.asarray(self.ok.mean(axis=0) >= 0.5)

    @property
    def lost_fraction(self) -> float:
        """Share of marker-frames that were lost."""
        return float(1.0 - self.ok.mean())


@dataclass(frozen=True)
class BodyMotion:
    """How one rigid body, such as a pillar's head, moves from the reference frame; NaN in frames without it."""

    translation_px: Floats
    """(T, 2): of the centre of the body's mask."""
    rotation_deg: Floats
    """(T,): about that centre, positive clockwise on the screen; NaN where only translation was measured."""
    translation_se_px: Floats
    """(T, 2): standard errors, of which the noise of the reference frame is common to all frames."""
    rotation_se_deg: Floats
    """(T,)"""
    residual: Floats
    """(T,): what the body's picture leaves unexplained of each frame, in standard deviations of its grey values."""
    ok: Bools
    """(T,): False where the body was not found."""
    center_px: Floats
    """(2,): centre of the mask in the reference frame."""
    reference_frame: int
    model: str
    """`rigid` or `translation`."""

    def __post_init__(self) -> None:
        t = len(self.ok)
        for name in ("translation_px", "translation_se_px"):
            _expect(name, getattr(self, name), (t, 2))
        for name in ("rotation_deg", "rotation_se_deg", "residual"):
            _expect(name, getattr(self, name), (t,))
        _expect("center_px", self.center_px, (2,))


@dataclass(frozen=True)
class PillarMotion:
    """How the pillars move; T frames, P pillars."""

    pillars: Pillars
    shift_px: Floats
    """(T, P, 2): movement of each pillar from the reference frame, NaN where it was not found."""
    shift_se_px: Floats
    """(T, P, 2): its standard error, NaN where the method does not know it."""
    rotation_deg: Floats
    """(T, P): rotation of each head in the picture, clockwise; a head that only bends over hardly rotates."""
    gain_se: Floats
    """(P,): standard error of all motion of a pillar as a share of it, by how its quarters disagree; NaN where the
    method does not know it."""
    method: str
    findings: tuple[Finding, ...] = ()

    def __post_init__(self) -> None:
        p = len(self.pillars)
        _expect("shift_px", self.shift_px, (None, p, 2))
        _expect("shift_se_px", self.shift_se_px, self.shift_px.shape)
        _expect("rotation_deg", self.rotation_deg, self.shift_px.shape[:2])
        _expect("gain_se", self.gain_se, (p,))


@dataclass(frozen=True)
class Beats:
    """The movie cut into beats, each with a relaxed state of its own."""

    signal_px: Floats
    """Mean absolute displacement (T,): mean over markers of the distance from the movie's relaxed state."""
    noise_px: float
    """Standard deviation of the signal's frame-to-frame noise."""
    start: Ints
    """First frame of each beat (B,), in its relaxed state."""
    peak: Ints
    """Frame of the largest displacement of each beat (B,)."""
    stop: Ints
    """First frame after each beat (B,)."""
    complete: Bools
    """(B,): False for a beat that the movie's start or end cuts off, or that a person left out; it has no period."""
    relaxed: Bools
    """(T,): frames in which the tissue rests."""
    relaxed_px: Floats
    """(N, 2): where each marker rests, its mean over all relaxed frames."""
    beat_relaxed_px: Floats
    """(B, N, 2): where each marker rests around each beat."""
    method: str
    detection_limit_px: float = float("nan")
    """Smallest amplitude, as mean absolute displacement, of beats that this movie can tell from no motion: about half
    of such beats are found, almost all of twice the size, and a motionless movie has a beat in at most 1 % of cases.
    NaN where the method has no such limit."""
    findings: tuple[Finding, ...] = ()
    left_out: Bools = field(default_factory=lambda: np.zeros(0, bool))
    """(B,): True for a beat that a person decided to leave out; False for all where nothing is given."""

    def __post_init__(self) -> None:
        b, t = len(self.start), len(self.signal_px)
        if len(self.left_out) == 0:
            object.__setattr__(self, "left_out", np.zeros(b, bool))
        for name in ("peak", "stop", "complete", "left_out"):
            _expect(name, getattr(self, name), (b,))
        _expect("relaxed", self.relaxed, (t,))
        _expect("relaxed_px", self.relaxed_px, (None, 2))
        _expect("beat_relaxed_px", self.beat_relaxed_px, (b, len(self.relaxed_px), 2))

    def __len__(self) -> int:
        return len(self.start)

    def label(self, beat: int) -> str:
        """Name a beat for people: its number, counted from 1, and why it does not count where it does not."""
        why = " (left out)" if self.left_out[beat] else "" if self.complete[beat] else " (cut off)"
        return f"beat {beat + 1}{why}"

    @property
    def drift_px(self) -> Floats:
        """(B, 2): movement (row, col) of the relaxed state of each beat from that of the movie, the median over
        markers."""
        if len(self) == 0:
            return np.zeros((0, 2))
        return np.asarray(np.nanmedian(self.beat_relaxed_px - self.relaxed_px, axis=1))

    @property
    def beat_of_frame(self) -> Ints:
        """(T,): number of the beat that each frame belongs to, -1 outside all beats."""
        out = np.full(len(self.signal_px), -1)
        for b, (first, stop) in enumerate(zip(self.start, self.stop, strict=True)):
            out[first:stop] = b
        return out

    @property
    def nearest_beat(self) -> Ints:
        """(T,): number of the beat that each frame belongs to or lies nearest to; all -1 where there are no beats."""
        t = np.arange(len(self.signal_px))
        if len(self) == 0:
            return np.full(len(t), -1)
        away = np.maximum(self.start - t[:, None], t[:, None] - (self.stop - 1))
        return np.asarray(np.argmin(np.maximum(away, 0), axis=1))


@dataclass(frozen=True)
class Strain:
    """Deformation of each sub-domain in each beat, in the tissue's axes (row across, col along)."""

    label: tuple[str, ...]
    """A1, A2, ...: letter for the row, number for the column."""
    grid: tuple[int, int]
    """Rows and columns of sub-domains."""
    side_px: tuple[float, float]
    """Height and width of one sub-domain."""
    corner_px: Floats
    """(S, 4, 2): corners in the image, clockwise from the upper left in the tissue's axes."""
    angle_deg: float
    """Angle of the sub-domains' column axis in the image, clockwise."""
    center_px: Floats
    """(T, S, 2): centre of each sub-domain in the image, moved with its markers."""
    F: Floats
    """(T, S, 2, 2): deformation gradient [[rr, rc], [cr, cc]]; NaN outside beats and where it cannot be measured."""
    count: Ints
    """(S,): markers in each sub-domain."""
    reason: tuple[str, ...]
    """Why a sub-domain has no strain, or the empty string."""

    def __post_init__(self) -> None:
        s = len(self.label)
        _expect("corner_px", self.corner_px, (s, 4, 2))
        _expect("F", self.F, (None, s, 2, 2))
        _expect("count", self.count, (s,))

    @cached_property
    def E(self) -> Floats:
        """Green-Lagrange strain (F'F - I)/2, (T, S, 2, 2)."""
        return 0.5 * (np.swapaxes(self.F, -1, -2) @ self.F - np.eye(2))

    @property
    def J(self) -> Floats:
        """Area ratio det F, (T, S); the areal strain is J - 1."""
        return np.asarray(self.F[..., 0, 0] * self.F[..., 1, 1] - self.F[..., 0, 1] * self.F[..., 1, 0])

    @property
    def principal(self) -> tuple[Floats, Floats]:
        """Principal Green-Lagrange strains (T, S, 2), smallest first, and the angle (T, S) in degrees of the first
        principal direction from the col axis, positive towards +row."""
        E = self.E
        mean = 0.5 * (E[..., 0, 0] + E[..., 1, 1])
        half = 0.5 * (E[..., 1, 1] - E[..., 0, 0])
        radius = np.hypot(half, E[..., 0, 1])
        largest_deg = 0.5 * np.degrees(np.arctan2(E[..., 0, 1], half))
        first_deg = (largest_deg + 180.0) % 180.0 - 90.0
        return np.stack([mean - radius, mean + radius], axis=-1), first_deg


@dataclass(frozen=True)
class Grid:
    """Displacement at the points of a regular grid in the tissue's axes."""

    point_px: Floats
    """(P, 2): grid points in the relaxed image, NaN-free; rows of the grid run across the tissue."""
    shape: tuple[int, int]
    """Rows and columns of the grid; P is their product."""
    displacement_px: Floats
    """(T, P, 2): displacement in image axes from the relaxed state; NaN outside the tissue."""

    def __post_init__(self) -> None:
        _expect("point_px", self.point_px, (self.shape[0] * self.shape[1], 2))
        _expect("displacement_px", self.displacement_px, (None, self.shape[0] * self.shape[1], 2))


def known(points_px: Floats) -> Bools:
    """Tell which points (..., 2) have both coordinates: (...)."""
    return np.asarray(np.isfinite(points_px[..., 0]) & np.isfinite(points_px[..., 1]), dtype=bool)


def _expect(name: str, array: Any, shape: tuple[int | None, ...]) -> None:
    found = np.shape(array)
    if len(found) != len(shape) or any(w is not None and w != f for w, f in zip(shape, found, strict=True)):
        wanted = ", ".join("any" if w is None else str(w) for w in shape)
        raise ValueError(f"{name}: expected shape ({wanted}), found {found}")
