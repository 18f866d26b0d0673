"""Displacement at many points, one frame at a time, so that pictures of long movies need little memory."""

from __future__ import annotations

import numpy as np

from .analysis import Analysis
from .data import Floats, Ints, known
from .field import filled, local_weights


class Motion:
    """Displacement from the movie's relaxed state at points (P, 2) of the relaxed image, also beyond the tissue's edge.

    The numbers are those of `Analysis.displacement_at`. Raises ValueError for fewer than three markers that were
    followed, where there is no field.
    """

    def __init__(self, analysis: Analysis, points_px: Floats) -> None:
        self._analysis, self._points = analysis, points_px
        field, rest = analysis.tracks.field, analysis.beats.relaxed_px
        self._usable = np.flatnonzero((known(analysis.displacement_px).mean(axis=0) >= 0.5) & known(rest))
        self._near: tuple[Floats, Ints] | None = None
        if field is None:
            if len(self._usable) < 3:
                raise ValueError(f"expected at least 3 markers with displacements; found {len(self._usable)}")
            return
        resting = np.zeros(field.coefficients.shape[1:])
        for t in np.flatnonzero(analysis.beats.relaxed):
            resting += field.coefficients[t] / analysis.beats.relaxed.sum()
        self._weights = field.basis(points_px - field.basis(points_px) @ resting.reshape(2, -1).T)
        self._weights.data = self._weights.data.astype(np.float32)
        self._rest = self._weights @ resting.reshape(2, -1).T.astype(np.float32)

    def at(self, frame: int) -> Floats:
        """Displacement (P, 2) in px in one frame."""
        field = self._analysis.tracks.field
        if field is not None:
            return np.asarray(self._weights @ field.coefficients[frame].reshape(2, -1).T - self._rest)
        rest = self._analysis.beats.relaxed_px[self._usable]
        moved = self._analysis.tracks.position_px[frame, self._usable] - rest
        return self._spread(filled(rest, moved[None])[0])

    def from_rest(self, beat: int) -> Floats:
        """Displacement (P, 2) in px at a beat's peak, from the relaxed state of that beat."""
        beats = self._analysis.beats
        drift = (beats.beat_relaxed_px[beat] - beats.relaxed_px)[self._usable]
        return self.at(int(beats.peak[beat])) - self._spread(filled(beats.relaxed_px[self._usable], drift[None])[0])

    def _spread(self, moved: Floats) -> Floats:
        """Values (P, 2) at the points, from those of the usable markers."""
        if self._near is None:
            self._near = local_weights(self._analysis.beats.relaxed_px[self._usable].astype(float), self._points)
        weights, index = self._near
        return np.asarray(np.einsum("pk,pkd->pd", weights, moved[index]))
