"""What the displacement field may be wrong by, as random draws that any result can be computed from.

A field that was pooled over frames (see `modes`) is a mean and a few patterns, each times its course in time. Its error
has three parts, to first order:

1. The patterns and the mean are wrong by an average, over the frames that hold them, of the noise of single frames.
   How that noise looks is known: it is what the pooling discarded, frame by frame, so its size, its colour and the
   places of little texture need no model.
2. The courses jitter: the noise of one frame along a kept pattern cannot be told from motion.
3. The model is not the tissue. The pull of the bending energy is computed; what interpolation and knots cost does not
   show in the movie itself, and is taken as a small share of the motion and a small length, as measured on clean movies
   whose motion is known (`microbundle validate`).

A draw is one possible error of the whole field in space and time. The standard error of any number, linear or not, is
the standard deviation over draws of that number computed from the field plus the draw (parametric bootstrap; B. Efron
and R. Tibshirani, An Introduction to the Bootstrap, 1993).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from .data import Floats, Ints

if TYPE_CHECKING:
    from scipy.sparse import csr_matrix

    from .lattice import Template
    from .modes import Modes

COUNT = 32
"""Draws; a standard error from them is known to 12 %."""
SEED = 1729
PROBES = 16
"""Random vectors that estimate the trace of a matrix (M. Hutchinson, Commun. Stat. Simul. 18, 1989)."""
GAIN_SHARE, MODEL_SHARE, MODEL_PX = 0.002, 0.003, 0.0007
"""What interpolation and knots cost: as a share of all motion, of the motion at a place, and at the motion's peak."""


@dataclass(frozen=True)
class Draws:
    """Random errors of a displacement field; D draws, S stretches of frames, components 0 (the mean) to M (the modes).

    Draw d of frame t in stretch s is the sum over components r of course[t, r] pattern[s, d, r] + jitter[d, t, r]
    mode[s, r].
    """

    stretch: Ints
    """(T,): which stretch of frames each frame was pooled in."""
    course: Floats
    """(T, M + 1): orthonormal courses in time, first that of the mean; zeros where a stretch has fewer."""
    pattern: Floats
    """(S, D, M + 1, 2, K, L): errors of the mean and of the modes."""
    jitter: Floats
    """(D, T, M + 1): errors of the courses."""
    mode: Floats
    """(S, M + 1, 2, K, L): the modes, of unit size in the metric of the registration's matrix; zeros for the mean."""

    @property
    def count(self) -> int:
        """Number of draws D."""
        return int(self.pattern.shape[1])

    def weighted(self, weights: csr_matrix | Floats) -> Iterator[Floats]:
        """Errors (T, P, 2) of weighted sums of the field's coefficients, for weights (P, K L), draw by draw."""
        S, D, R = self.pattern.shape[:3]
        knots = self.pattern.shape[4] * self.pattern.shape[5]
        points = weights.shape[0]

        def sums(fields: Floats) -> Floats:
            flat = np.ascontiguousarray(fields.reshape(-1, knots).T)
            return np.asarray(weights @ flat, np.float32).T.reshape(*fields.shape[:-2], points)

        modes = sums(self.mode)
        for d in range(D):
            pattern = sums(np.ascontiguousarray(self.pattern[:, d]))
            out = np.empty((len(self.stretch), 2, points), np.float32)
            for s in range(S):
                here = self.stretch == s
                both = np.concatenate([self.course[here], self.jitter[d, here]], axis=1).astype(np.float32)
                right = np.concatenate([pattern[s], modes[s]]).reshape(2 * R, -1)
                out[here] = (both @ right).reshape(-1, 2, points)
            yield out.transpose(0, 2, 1)


@dataclass(frozen=True)
class StretchDraws:
    """Draws of one stretch of frames; see `Draws`."""

    course: Floats
    pattern: Floats
    jitter: Floats
    mode: Floats


def draw_errors(unknowns: Floats, modes: Modes, template: Template, rng: np.random.Generator,
                count: int = COUNT) -> StretchDraws:
    """Draw possible errors of pooled frames, from their unknowns (T, n) before the pooling."""
    frames, size = unknowns.shape
    centred = unknowns - unknowns.mean(axis=0)
    course = np.concatenate([np.full((frames, 1), frames**-0.5), modes.course], axis=1)
    kept = course.T @ unknowns
    discarded = unknowns - course @ kept
    kept[0] = 0.0  # no motion, but where the reference frame happens to be
    parts = course.shape[1]
    freedom = max(frames - parts, 1)
    grid = template.knots.grid
    mix = rng.standard_normal((count * parts, frames)) / np.sqrt(freedom)
    pattern = grid((mix @ discarded).reshape(count, parts, size))
    pattern += rng.standard_normal((count, 1, 1, 1, 1)) * grid(template.solve(template.penalty @ kept.T).T)
    pattern += GAIN_SHARE * rng.standard_normal((count, 1, 1, 1, 1)) * grid(kept)
    pattern += MODEL_SHARE * _smooth(rng, (count, 1, *template.knots.shape)) * grid(kept)
    if parts > 1:
        pattern[:, 1] += (MODEL_PX / np.abs(modes.course[:, 0]).max()) * _smooth(rng, (count, *template.knots.shape))
    mode = np.zeros((parts, size))
    mode[1:] = (modes.course.T @ centred) / modes.strength[:, None]
    # Noise has its full size only in directions that the picture decides, not in those left to the bending energy.
    probe = rng.choice([-1.0, 1.0], (size, PROBES))
    decided = size - float((probe * template.solve(template.penalty @ probe)).sum()) / PROBES
    jitter = modes.noise * np.sqrt(size / max(decided, 1.0)) * rng.standard_normal((count, frames, parts))
    jitter -= course @ (course.T @ jitter)
    jitter[:, :, 0] = 0.0
    return StretchDraws(course, pattern, jitter, grid(mode))


def _smooth(rng: np.random.Generator, shape: tuple[int, ...]) -> Floats:
    """Standard normal numbers that vary over three knots along the last two axes."""
    out = rng.standard_normal(shape)
    for axis in (-1, -2):
        near = np.pad(out, [(1, 1) if a == axis % out.ndim else (0, 0) for a in range(out.ndim)], mode="wrap")
        n = out.shape[axis]
        out = sum(np.take(near, range(k, k + n), axis=axis) for k in range(3)) / np.sqrt(3)
    return out


def join(stretches: Sequence[tuple[Ints, StretchDraws]], frames: int) -> Draws:
    """Put the draws of stretches, each with the numbers of its frames, together for a movie of so many frames."""
    first = stretches[0][1]
    parts = max(s.course.shape[1] for _, s in stretches)
    count, shape = len(first.pattern), first.pattern.shape[2:]
    stretch = np.zeros(frames, int)
    course, jitter = np.zeros((frames, parts), np.float32), np.zeros((count, frames, parts), np.float32)
    pattern = np.zeros((len(stretches), count, parts, *shape), np.float32)
    mode = np.zeros((len(stretches), parts, *shape), np.float32)
    for i, (where, one) in enumerate(stretches):
        own = one.course.shape[1]
        stretch[where] = i
        course[where, :own], jitter[:, where, :own] = one.course, one.jitter
        pattern[i, :, :own], mode[i, :own] = one.pattern, one.mode
    return Draws(stretch, course, pattern, jitter, mode)
