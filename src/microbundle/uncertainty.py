"""Standard errors of anything that is computed from a result.

The accurate method knows how its displacement field may be wrong, as random draws (see `draws`). `alternatives` gives
the results that the same movie with other noise might have led to; the standard error of a number is its standard
deviation over them. The cuts into beats stay; which of the relaxed frames count is drawn too, because tissue that still
stirs between beats makes the relaxed state uncertain.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace

import numpy as np

from .analysis import Analysis
from .contraction import mean_absolute, rest_weights
from .data import Beats, Bools, Floats, Ints, PillarMotion, Strain
from .draws import SEED
from .field import Field
from .strain import weigh_tiles
from .tiles import place_tiles


def alternatives(analysis: Analysis, *, same_rest: bool = False) -> Iterator[Analysis]:
    """Give results that the movie with other noise might have led to, 32 of them, each equally likely.

    Displacement, signal and strain differ between them. A result of the methods `fast` and `paper`, which do not know
    their errors, has none. With `same_rest` the relaxed frames are those of the result. Source: parametric bootstrap,
    B. Efron and R. Tibshirani, 1993.
    """
    field = analysis.tracks.field
    if field is None or field.draws is None:
        return
    at_markers, at_grid = (field.basis(p) for p in (analysis.markers.position_px, analysis.grid.point_px))
    strain, tiles = analysis.strain, None
    if strain is not None:
        tiles = weigh_tiles(field, place_tiles(analysis.masks, analysis.config), analysis.masks.tissue)
    streams = [field.draws.weighted(w) for w in (at_markers, at_grid)]
    if tiles is not None:
        streams.append(field.draws.weighted(tiles.weights))
    rng = np.random.default_rng(SEED)
    for markers, grid, *slopes in zip(*streams, strict=True):
        resting = analysis.beats.relaxed if same_rest else _some_rest(analysis.beats.relaxed, rng)
        changed = _moved(analysis, markers, grid, resting)
        if strain is not None and tiles is not None:
            changed = replace(changed, strain=_strained(strain, analysis.beats, tiles.gradient(slopes[0])[0], resting))
        yield replace(changed, pillars=_shifted(analysis.pillars, rng))


def standard_errors(analysis: Analysis, numbers: Callable[[Analysis], Mapping[str, Floats]]) -> dict[str, Floats]:
    """Compute the standard error of each array of numbers that a function takes from a result.

    The dict is empty for a result that does not know its errors. A number that is NaN in the result, or in half of the
    alternatives, has the error NaN.
    """
    own = {name: np.asarray(value, float) for name, value in numbers(analysis).items()}
    sums = {name: np.zeros((3, *value.shape)) for name, value in own.items()}
    count = 0
    for other in alternatives(analysis):
        count += 1
        for name, value in numbers(other).items():
            away = np.asarray(value, float) - own[name]
            seen = np.isfinite(away)
            away = np.where(seen, away, 0.0)
            sums[name] += np.stack([seen, away, away**2])
    out = {}
    for name, (seen, total, squares) in sums.items() if count else ():
        n = np.where(seen > count // 2, seen, np.nan)
        out[name] = np.sqrt(np.maximum(squares / n - (total / n) ** 2, 0.0) * n / (n - 1))
    return out


def added_by_noise(analysis: Analysis, number: Callable[[Analysis], Floats]) -> Floats:
    """Compute what noise adds, on the average, to numbers that are not linear in the displacement (a mean of lengths);
    zeros for a result that does not know its errors."""
    own = np.asarray(number(analysis), float)
    others = [number(other) - own for other in alternatives(replace(analysis, strain=None), same_rest=True)]
    return np.asarray(np.mean(others, axis=0)) if others else np.zeros(own.shape)


def displacement_error_at(analysis: Analysis, points_px: Floats) -> Floats:
    """Compute the standard error (T, P, 2) in px of the displacement from the relaxed state at points (P, 2).

    It belongs to `Analysis.displacement_at` with relative_to="beat". NaN for methods that do not know their errors.
    """
    points = np.atleast_2d(np.asarray(points_px, float))
    field = analysis.tracks.field
    if field is None or field.draws is None:
        return np.full((analysis.frame_count, len(points), 2), np.nan)
    weights = field.basis(points)
    moved = field.weighted(weights)
    rng = np.random.default_rng(SEED)
    squares = np.zeros(moved.shape)
    for draw in field.draws.weighted(weights):
        resting = _some_rest(analysis.beats.relaxed, rng)
        squares += _from_rests(moved + draw, moved, analysis.beats, resting) ** 2
    return np.asarray(np.sqrt(squares / field.draws.count))


def _some_rest(relaxed: Bools, rng: np.random.Generator) -> Bools:
    """Half of each run of relaxed frames, at a random place in it."""
    out = np.zeros(len(relaxed), bool)
    edges = np.flatnonzero(np.diff(np.pad(relaxed.astype(np.int8), 1)))
    for first, stop in zip(edges[::2], edges[1::2], strict=True):
        half = -(-(stop - first) // 2)
        begin = rng.integers(first, stop - half + 1)
        out[begin:begin + half] = True
    return out


def _rests(beats: Beats, resting: Bools) -> Iterator[tuple[Ints, Floats, Floats]]:
    """Frames that each beat owns, and the weights (T,) of the frames that give its relaxed state: of all relaxed ones,
    and of those in `resting`."""
    if len(beats) == 0:
        whole, some = (r / max(int(r.sum()), 1) for r in (beats.relaxed, resting))
        yield np.arange(len(resting)), whole, some
        return
    pairs = zip(rest_weights(beats.relaxed, beats.peak), rest_weights(resting, beats.peak), strict=True)
    for b, (whole, some) in enumerate(pairs):
        yield np.flatnonzero(beats.nearest_beat == b), whole, some


def _weighted(weights: Floats, values: Floats) -> Floats:
    """Weighted sum over frames of values (T, ...), of which only frames with a weight count."""
    used = weights != 0
    return np.asarray(np.tensordot(weights[used], values[used], 1))


def _from_rests(other: Floats, own: Floats, beats: Beats, resting: Bools) -> Floats:
    """Difference of displacements (T, P, 2), each from the relaxed state of its beat."""
    out = other - own
    for frames, whole, some in _rests(beats, resting):
        out[frames] -= _weighted(some, other) - _weighted(whole, own)
    return out


def _moved(analysis: Analysis, markers: Floats, grid: Floats, resting: Bools) -> Analysis:
    """The result with its displacements changed by a draw (T, N, 2), (T, P, 2)."""
    tracks, beats = analysis.tracks, analysis.beats
    own = tracks.position_px
    seen = np.isfinite(own).all(axis=(1, 2))
    position = own + markers
    relaxed = beats.relaxed & seen
    resting = resting & seen if (resting & seen).any() else relaxed
    shift = position[resting].mean(axis=0) - own[relaxed].mean(axis=0) if relaxed.any() else np.zeros(own.shape[1:])
    beat_shift = np.zeros(beats.beat_relaxed_px.shape)
    if len(beats):
        seen_beats = replace(beats, relaxed=relaxed)
        for b, (_, whole, some) in enumerate(_rests(seen_beats, resting)):
            beat_shift[b] = _weighted(some, position) - _weighted(whole, own)
    rest = beats.relaxed_px + shift
    kept = tracks.kept
    signal = mean_absolute(position[:, kept] - rest[kept].astype(np.float32))
    changed = grid - grid[beats.relaxed].mean(axis=0) if beats.relaxed.any() else grid
    return replace(
        analysis, tracks=replace(tracks, position_px=position, field=_without_draws(tracks.field)),
        beats=replace(beats, signal_px=signal, relaxed_px=rest, beat_relaxed_px=beats.beat_relaxed_px + beat_shift),
        grid=replace(analysis.grid, displacement_px=analysis.grid.displacement_px + changed))


def _shifted(pillars: PillarMotion | None, rng: np.random.Generator) -> PillarMotion | None:
    """The pillars' motion with errors drawn for each frame, and of its gain; what is common to all frames cancels in
    every force."""
    if pillars is None:
        return None
    error = rng.standard_normal(pillars.shift_px.shape) * np.nan_to_num(pillars.shift_se_px)
    gain = 1 + rng.standard_normal(len(pillars.pillars)) * np.nan_to_num(pillars.gain_se)
    return replace(pillars, shift_px=gain[:, None] * pillars.shift_px + error)


def _without_draws(field: Field | None) -> Field | None:
    """An alternative has no alternatives of its own."""
    return None if field is None else replace(field, draws=None)


def _strained(strain: Strain, beats: Beats, gradient: Floats, resting: Bools) -> Strain:
    """The strain with the displacement gradient changed by a draw (T, S, 2, 2), from other relaxed frames."""
    changed = strain.F + gradient
    F = changed.copy()
    for frames, whole, some in _rests(beats, resting):
        if whole.any() and some.any():
            F[frames] = changed[frames] @ np.linalg.inv(_weighted(some, changed)) @ _weighted(whole, strain.F)
    return replace(strain, F=F)
