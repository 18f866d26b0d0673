"""Motions whose displacement and deformation gradient are known exactly at every point.

A motion carries a material point X of the relaxed state to x = X + u(X, t). It is the truth behind a synthetic movie:
`render` draws its inverse, and a measurement is scored against `displacement_px` and `gradient`. Any class with
`count`, `displacement_px` and `gradient` is a Motion; a finite-element result is one as well.

`TissueMotion` resembles a bundle between two pillars (paper, "Synthetic data generation"): it shortens along its axis
and bulges across it, the activation travels along the axis, a passive inclusion is pulled longer while the rest
shortens, and every beat has its own strength and length. Because of the travelling activation its displacement is no
product of a shape and a time course, so it gives no undue help to methods that assume few modes.

Points and tensors are in the order (row, col), as everywhere: F[..., 0, 1] is the derivative of the row position
by the column.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from typing import Literal, Protocol, runtime_checkable

import numpy as np

from ..data import Bools, Floats, Ints


@runtime_checkable
class Motion(Protocol):
    """A displacement of material points that is known in every frame."""

    @property
    def count(self) -> int:
        """Number of frames T."""
        ...

    def displacement_px(self, points_px: Floats, frame: int) -> Floats:
        """Displacement u (N, 2) in a frame of the material points (N, 2), which are given in the relaxed state."""
        ...

    def gradient(self, points_px: Floats, frame: int) -> Floats:
        """Deformation gradient F = I + du/dX (N, 2, 2) in a frame at the material points (N, 2)."""
        ...


@dataclass(frozen=True)
class RigidMotion:
    """Shift and turn the whole picture, as a drifting or vibrating stage does."""

    shift_px: Floats
    """(T, 2)"""
    angle_rad: Floats | None = None
    """(T,): turn about `center_px`, positive from the row axis towards the col axis, or None for no turn."""
    center_px: tuple[float, float] = (0.0, 0.0)

    def __post_init__(self) -> None:
        _expect("shift_px", np.shape(self.shift_px), (None, 2))
        if self.angle_rad is not None:
            _expect("angle_rad", np.shape(self.angle_rad), (len(self.shift_px),))

    @classmethod
    def drift(cls, count: int, per_frame_px: tuple[float, float], per_frame_rad: float = 0.0,
              center_px: tuple[float, float] = (0.0, 0.0)) -> RigidMotion:
        """Move steadily, by the same shift and turn in every frame; nothing has moved in frame 0."""
        t = np.arange(count)
        return cls(t[:, None] * np.asarray(per_frame_px, float), t * per_frame_rad, center_px)

    @property
    def count(self) -> int:
        return len(self.shift_px)

    def displacement_px(self, points_px: Floats, frame: int) -> Floats:
        """See `Motion.displacement_px`."""
        turn = self._turn(_checked(frame, self.count))
        return np.asarray((points_px - self.center_px) @ (turn - np.eye(2)).T + self.shift_px[frame])

    def gradient(self, points_px: Floats, frame: int) -> Floats:
        """See `Motion.gradient`."""
        return np.broadcast_to(self._turn(_checked(frame, self.count)), (len(points_px), 2, 2)).copy()

    def _turn(self, frame: int) -> Floats:
        angle = 0.0 if self.angle_rad is None else float(self.angle_rad[frame])
        return np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])


@dataclass(frozen=True)
class UniformStretch:
    """Deform the whole picture by one deformation gradient per frame, about a point that stays in place."""

    F: Floats
    """(T, 2, 2)"""
    center_px: tuple[float, float] = (0.0, 0.0)

    def __post_init__(self) -> None:
        _expect("F", np.shape(self.F), (None, 2, 2))

    @property
    def count(self) -> int:
        return len(self.F)

    def displacement_px(self, points_px: Floats, frame: int) -> Floats:
        """See `Motion.displacement_px`."""
        return np.asarray((points_px - self.center_px) @ (self.F[_checked(frame, self.count)] - np.eye(2)).T)

    def gradient(self, points_px: Floats, frame: int) -> Floats:
        """See `Motion.gradient`."""
        return np.broadcast_to(self.F[_checked(frame, self.count)], (len(points_px), 2, 2)).copy()


@dataclass(frozen=True)
class Composed:
    """Carry points by one motion after another: the first acts on the relaxed state, the next on its result.

    A beating tissue on a drifting stage is `Composed((tissue, stage))`.
    """

    parts: tuple[Motion, ...]

    def __post_init__(self) -> None:
        if not self.parts or len({p.count for p in self.parts}) != 1:
            raise ValueError("parts: expected one or more motions with the same number of frames, found "
                             f"{[p.count for p in self.parts]}")

    @property
    def count(self) -> int:
        return self.parts[0].count

    def displacement_px(self, points_px: Floats, frame: int) -> Floats:
        """See `Motion.displacement_px`."""
        u = np.zeros(np.shape(points_px))
        for part in self.parts:
            u = u + part.displacement_px(points_px + u, frame)
        return u

    def gradient(self, points_px: Floats, frame: int) -> Floats:
        """See `Motion.gradient`."""
        x = np.asarray(points_px, float)
        F = np.broadcast_to(np.eye(2), (len(x), 2, 2)).copy()
        for part in self.parts:
            F = part.gradient(x, frame) @ F
            x = x + part.displacement_px(x, frame)
        return F


@dataclass(frozen=True)
class Rhythm:
    """When the tissue beats and how strongly, with a rest between beats.

    Each beat lasts one period: a twitch in its first part and rest in the remainder. The activation is 1 at the peak
    of a beat of usual strength, 0 at rest, and twice differentiable in time for both shapes (`twitch`) or once
    (`cosine`), so that a travelling activation has a continuous deformation gradient.
    """

    count: int
    """Number of frames T."""
    period_frames: float = 24.0
    """Usual length of a beat."""
    shape: Literal["twitch", "cosine"] = "twitch"
    """`twitch` rises fast and falls slowly; `cosine` is the paper's clipped cosine, squared to be smooth (its share
    of active time is 0.47)."""
    first_beat: float = 0.3
    """Start of the first twitch as a share of the period. A negative value starts the movie inside a beat: -0.2 starts
    with the tissue fully contracted (for `twitch`), and the beat before it is cut off."""
    active: float = 0.55
    """Share of a period in which the tissue is not at rest."""
    rise: float = 0.36
    """Share of the active time until the peak, for `twitch`."""
    amplitude_variation: float = 0.0
    """Standard deviation of the beats' strength, which has mean 1."""
    period_variation: float = 0.0
    """Standard deviation of the beats' length as a share of the period."""
    seed: int = 0

    def __post_init__(self) -> None:
        if not (self.count > 0 and self.period_frames > 0 and 0 < self.active <= 1 and 0 < self.rise < 1):
            raise ValueError("Rhythm: expected count > 0, period_frames > 0, 0 < active <= 1 and 0 < rise < 1, "
                             f"found {self}")

    @cached_property
    def onset_frames(self) -> Floats:
        """Start of each twitch in frames (B + 1,), in order; the last entry is the end of the last beat. The first and
        last beats may lie partly or fully outside the movie, so that a delayed activation never runs out of beats."""
        n = int(np.ceil(2 * self.count / self.period_frames)) + 8
        rng = np.random.default_rng(np.random.SeedSequence([self.seed, 11]))
        lengths = self.period_frames * np.clip(1 + self.period_variation * rng.standard_normal(n), 0.6, 1.6)
        onsets = np.concatenate([[0.0], np.cumsum(lengths)])
        # One full beat before the first, because points that are activated late may still be in it at frame 0.
        onsets += self.first_beat * self.period_frames - onsets[2]
        stop = int(np.searchsorted(onsets, self.count + self.period_frames)) + 1
        return onsets[:stop]

    @cached_property
    def amplitudes(self) -> Floats:
        """Strength of each beat (B,)."""
        rng = np.random.default_rng(np.random.SeedSequence([self.seed, 12]))
        n = len(self.onset_frames) - 1
        return np.asarray(np.clip(1 + self.amplitude_variation * rng.standard_normal(n), 0.2, 1.8))

    @property
    def peak_frames(self) -> Floats:
        """Time in frames of the largest activation of each beat that peaks within the movie, without delay."""
        onset, length = self.onset_frames[:-1], np.diff(self.onset_frames)
        peak = onset + length * self.active * (self.rise if self.shape == "twitch" else 0.5)
        return np.asarray(peak[(peak >= 0) & (peak <= self.count - 1)])

    @property
    def resting(self) -> Bools:
        """Frames (T,) in which the undelayed activation is zero."""
        return np.asarray(self.activation(np.arange(self.count, dtype=float))[0] == 0.0)

    def activation(self, time_frames: Floats) -> tuple[Floats, Floats]:
        """Activation and its derivative per frame at any times, in frames; both in the shape of `time_frames`."""
        onsets = self.onset_frames
        beat: Ints = np.clip(np.searchsorted(onsets, time_frames, side="right") - 1, 0, len(onsets) - 2)
        length = (onsets[1:] - onsets[:-1])[beat] * self.active
        phase = (time_frames - onsets[beat]) / length
        a, da = _twitch(phase, self.rise) if self.shape == "twitch" else _cosine(phase)
        return self.amplitudes[beat] * a, self.amplitudes[beat] * da / length


@dataclass(frozen=True)
class Inclusion:
    """A passive region of the tissue, stretched by the rest while that shortens."""

    center_px: tuple[float, float]
    radius_px: float
    """Standard deviation of its smooth round outline."""
    extension: float = 0.5
    """Its extension at the centre, as a share of the shortening that active tissue would have there."""
    lag_frames: float = 0.5
    """How much later than active tissue it moves."""


@dataclass(frozen=True)
class TissueMotion:
    """Beat like a bundle that pulls two pillars towards each other.

    With s and n along and across the axis from the centre, and a(t) the activation,

        u_s = -peak_px b(s/L) (1 - asymmetry tanh(s/L)) c(n/W) a(t - delay(s)),   b(x) = x exp((1 - x^2)/2),
        u_n = bulge peak_px/L b'(s/L) n c(n/W) a(t - delay(s)),   c(y) = exp(-y^2/8),

    so the ends at s = +-L move inward by `peak_px` on average, and tissue beyond the pillars follows them less and
    less. The strain along the axis is largest in the middle, -1.65 peak_px/L, and vanishes at the pillars. Everything
    is smooth, and u is exactly 0 where and when the activation is 0.
    """

    rhythm: Rhythm
    center_px: tuple[float, float]
    half_length_px: float
    """L: distance from the centre to either pillar."""
    half_width_px: float
    """W: half of the tissue's width."""
    peak_px: float = 2.0
    """Displacement of the pillars along the axis at the peak of a beat of strength 1."""
    angle_deg: float = 0.0
    """Angle from the col axis to the tissue's axis, positive clockwise on the screen."""
    bulge: float = 0.4
    """Widening across the axis as a share of the shortening along it."""
    delay_frames: float = 2.0
    """Time that the activation takes from the first pillar to the second."""
    asymmetry: float = 0.15
    """How much more than average the end that is activated first moves, and the other less."""
    inclusion: Inclusion | None = None
    _axes: Floats = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        if not (self.half_length_px > 0 and self.half_width_px > 0):
            raise ValueError("TissueMotion: expected half_length_px > 0 and half_width_px > 0, found "
                             f"{self.half_length_px} and {self.half_width_px}")
        a = np.deg2rad(self.angle_deg)
        # Rows of the matrix: the unit vectors across (n) and along (s) the tissue, in (row, col).
        object.__setattr__(self, "_axes", np.array([[np.cos(a), -np.sin(a)], [np.sin(a), np.cos(a)]]))

    @property
    def count(self) -> int:
        return self.rhythm.count

    def displacement_px(self, points_px: Floats, frame: int) -> Floats:
        """See `Motion.displacement_px`."""
        return self._field(points_px, _checked(frame, self.count), gradient=False)[0] @ self._axes

    def gradient(self, points_px: Floats, frame: int) -> Floats:
        """See `Motion.gradient`."""
        du = self._field(points_px, _checked(frame, self.count), gradient=True)[1]
        return np.asarray(np.eye(2) + self._axes.T @ du @ self._axes)

    def _field(self, points_px: Floats, frame: int, *, gradient: bool) -> tuple[Floats, Floats]:
        """Displacement (N, 2) and its gradient (N, 2, 2; zeros if not asked for) in the axes (n, s)."""
        local = (np.asarray(points_px, float) - self.center_px) @ self._axes.T
        n, s = local[:, 0], local[:, 1]
        L, W, P = self.half_length_px, self.half_width_px, self.peak_px
        slowness = self.delay_frames / (2 * L)
        a, a_t = self.rhythm.activation(frame - slowness * (s + L))
        a_s = -slowness * a_t

        x = s / L
        g, g_x = self._pull(x)
        b_x = (1 - x**2) * np.exp(0.5 - 0.5 * x**2)
        b_xx = (x**3 - 3 * x) * np.exp(0.5 - 0.5 * x**2)
        c = np.exp(-(n / W) ** 2 / 8)
        c_n = -n / (4 * W**2) * c
        k = self.bulge * P / L

        u = np.empty_like(local)
        u[:, 1] = -P * g * c * a
        u[:, 0] = k * b_x * n * c * a
        du = np.zeros((len(local), 2, 2))
        if gradient:
            du[:, 1, 1] = -P * c * (g_x / L * a + g * a_s)
            du[:, 1, 0] = -P * g * c_n * a
            du[:, 0, 1] = k * n * c * (b_xx / L * a + b_x * a_s)
            du[:, 0, 0] = k * b_x * (c + n * c_n) * a
        if self.inclusion is not None:
            self._add_inclusion(self.inclusion, local, frame, slowness, u, du if gradient else None)
        return u, du

    def _pull(self, x: Floats) -> tuple[Floats, Floats]:
        """Inward displacement along the axis as a share of `peak_px`, and its derivative, at x = s/L."""
        b = x * np.exp(0.5 - 0.5 * x**2)
        b_x = (1 - x**2) * np.exp(0.5 - 0.5 * x**2)
        skew = 1 - self.asymmetry * np.tanh(x)
        skew_x = -self.asymmetry * (1 - np.tanh(x) ** 2)
        return b * skew, b_x * skew + b * skew_x

    def _add_inclusion(self, inclusion: Inclusion, local: Floats, frame: int, slowness: float, u: Floats,
                       du: Floats | None) -> None:
        # A round bump of stretch that cancels the shortening at its centre and exceeds it by `extension`.
        middle = self._axes @ (np.asarray(inclusion.center_px) - self.center_px)
        d = local - middle
        L = self.half_length_px
        shortening = (self.peak_px / L * float(self._pull(middle[1:] / L)[1][0])
                      * np.exp(-(middle[0] / self.half_width_px) ** 2 / 8))
        k = shortening * (1 + inclusion.extension) * np.array([-self.bulge, 1.0])
        r2 = inclusion.radius_px**2
        round_ = np.exp(-0.5 * (d**2).sum(axis=1) / r2)
        a, a_t = self.rhythm.activation(frame - inclusion.lag_frames - slowness * (local[:, 1] + L))
        u += k * d * (round_ * a)[:, None]
        if du is not None:
            w, w_s = round_ * a, -slowness * a_t * round_
            for i in (0, 1):
                for j in (0, 1):
                    slope = (i == j) * w - d[:, i] * d[:, j] / r2 * w + d[:, i] * (w_s if j == 1 else 0.0)
                    du[:, i, j] += k[i] * slope


def _smooth_step(p: Floats) -> tuple[Floats, Floats]:
    """Step from 0 to 1 on [0, 1] with zero first and second derivative at both ends, and its derivative."""
    p = np.clip(p, 0.0, 1.0)
    return p**3 * (10 - 15 * p + 6 * p**2), 30 * p**2 * (1 - p) ** 2


def _twitch(phase: Floats, rise: float) -> tuple[Floats, Floats]:
    up, d_up = _smooth_step(phase / rise)
    down, d_down = _smooth_step((phase - rise) / (1 - rise))
    return up - down, d_up / rise - d_down / (1 - rise)


def _cosine(phase: Floats) -> tuple[Floats, Floats]:
    p = np.clip(phase, 0.0, 1.0)
    return np.sin(np.pi * p) ** 2, np.pi * np.sin(2 * np.pi * p)


def _checked(frame: int, count: int) -> int:
    if not 0 <= frame < count:
        raise IndexError(f"frame {frame} is not one of the {count} frames of this motion")
    return frame


def _expect(name: str, found: tuple[int, ...], wanted: tuple[int | None, ...]) -> None:
    if len(found) != len(wanted) or any(w is not None and w != f for w, f in zip(wanted, found, strict=True)):
        raise ValueError(f"{name}: expected shape {wanted}, found {found}")
