"""The result of one movie: everything that was found, and how it was found."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from .config import Config
from .data import (
    Beats,
    Finding,
    Floats,
    Grid,
    Image,
    Markers,
    Masks,
    PillarMotion,
    Source,
    Strain,
    Tracks,
    Verdict,
)
from .decisions import Decisions, Judge, Note, UseSettings
from .field import checked_points, inside_tissue, interpolate
from .geometry import to_tissue


@dataclass(frozen=True)
class Analysis:
    """All that microbundle knows about one movie.

    `microbundle.tables` turns it into metrics in physical units; `displacement_at` samples the displacement anywhere.
    """

    name: str
    image: Image
    """The relaxed reference frame (R, C)."""
    time_s: Floats | None
    """(T,), or None where the frame times are unknown."""
    time_source: Source
    um_per_px: float | None
    um_per_px_source: Source
    config: Config
    masks: Masks
    markers: Markers
    tracks: Tracks
    beats: Beats
    grid: Grid
    strain: Strain | None
    """None where no sub-domain fits into the tissue; a finding says so."""
    movie_findings: tuple[Finding, ...]
    """What was found of the movie itself and of the analysis as a whole; `findings` has those of all stages."""
    files: tuple[str, ...]
    input_hash: str
    """SHA-256 over the movie's files, or the empty string for a movie made in memory."""
    versions: Mapping[str, str]
    stage_px: Floats | None = None
    """(T, 2): shift of the background against the reference frame, or None where it does not show. Longer movies are
    looked at in 40 frames, with straight lines between them."""
    pillars: PillarMotion | None = None
    """How the pillars move, or None where there are none, or none that can be told (a finding says why)."""
    decisions: Decisions = field(default_factory=Decisions)
    """What a person decided about this movie, and was replayed."""

    @property
    def frame_count(self) -> int:
        """Number of frames T."""
        return len(self.tracks.position_px)

    @property
    def findings(self) -> tuple[Finding, ...]:
        """Everything a reader should know, of all stages, and what a person made of it."""
        return (*self.movie_findings, *self.masks.findings, *self.markers.findings, *self.tracks.findings,
                *self.beats.findings, *(() if self.pillars is None else self.pillars.findings), *self._judged())

    @property
    def verdict(self) -> Verdict:
        """`fail` where nothing can be trusted, `review` where a person should look, else `pass`; a person who accepted
        the numbers has looked."""
        levels = {finding.level for finding in self.findings}
        if "fail" in levels:
            return "fail"
        return "review" if "review" in levels and not self.decisions.accepted else "pass"

    def _judged(self) -> Iterator[Finding]:
        """What a person decided of the movie as a whole, and of its settings."""
        judged = [one for one in self.decisions.listed if isinstance(one, Judge)]
        for one in self.decisions.listed:
            if isinstance(one, UseSettings):
                names = ", ".join(f"{name} = {value}" for name, value in one.named())
                yield Finding("settings_decided", "info", f"by a person's decision {names}{one.signed}")
            elif isinstance(one, Note):
                yield Finding("note", "info", f"a person's note: {one.text}{one.signed}")
            elif judged and one is judged[-1]:
                yield (Finding("accepted", "info", f"a person accepted these numbers{one.signed}") if one.accept else
                       Finding("rejected", "fail", f"a person rejected these numbers{one.signed}"))

    @property
    def displacement_px(self) -> Floats:
        """Displacement of the markers (T, N, 2) in px from the relaxed state of the movie, NaN where lost."""
        return np.asarray(self.tracks.position_px - self.beats.relaxed_px)

    def displacement_at(self, points_px: Floats, *, relative_to: Literal["movie", "beat"] = "movie",
                        method: Literal["local", "thin_plate"] = "local", extrapolate: bool = False) -> Floats:
        """Sample the displacement from the relaxed state at any points of the relaxed image.

        `points_px` is (N, 2) in the order (row, col); the result is (T, N, 2) in pixels, in the same order. Points
        outside the tissue are NaN unless `extrapolate`. The relaxed state is the movie's, so that drift shows; with
        relative_to="beat" it is that of the beat each frame belongs to or lies nearest to, and drift is left out.
        Raises ValueError for points of another shape.
        """
        rest = self.beats.relaxed_px
        tissue = None if extrapolate else self.masks.tissue
        if self.tracks.field is None:
            moved = interpolate(rest, self.tracks.position_px - rest, points_px, method=method, tissue=tissue)
        else:
            points = checked_points(points_px)
            moved = self.tracks.field.from_rest(points, self.beats.relaxed)
            if tissue is not None:
                moved[:, ~inside_tissue(points, tissue)] = np.nan
        if relative_to == "beat" and len(self.beats):
            drift = interpolate(rest, self.beats.beat_relaxed_px - rest, points_px, method=method, tissue=tissue)
            moved = moved - drift[self.beats.nearest_beat]
        return moved

    def inside(self, points_px: Floats) -> np.ndarray:
        """Tell which points (N, 2) of the relaxed image lie in the tissue: (N,)."""
        return inside_tissue(np.atleast_2d(points_px), self.masks.tissue)

    def tissue_axes(self, points_px: Floats) -> Floats:
        """Turn image points (..., 2) about the tissue's centre until the tissue is level."""
        return to_tissue(points_px, self.masks.axis.center_px, self.masks.axis.direction)
