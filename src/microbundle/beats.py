"""Cut a movie into beats, and find where the tissue rests before and after each.

The default looks for peaks of the contraction signal that stand out of the signal's own noise. A beat runs from the
middle of the rest before it to the middle of the rest after it. Each beat's relaxed state is that of these two rests,
joined by a straight line in time and taken at the peak; so a drifting stage, a movie that starts contracted, an
irregular rhythm or a single beat need no trimming. A beat that the movie's start or end cuts off is kept, marked as not
complete. Where nothing stands out, the result says how small a beat the movie could have shown.

`paper` follows the published program: peaks of the mean absolute displacement with a fixed prominence, valleys half
way between peaks, and the first and last beats left out. Source: paper, "Temporal segmentation".
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from . import focus
from .config import BeatParams, Config
from .contraction import (
    CLEARLY_REPEATS,
    contraction_signal,
    filled_in,
    frame_noise,
    mean_absolute,
    repeating_share,
    rest_weights,
    without_trend,
)
from .data import Beats, Bools, Finding, Floats, Ints, Masks, Movie, Tracks
from .focus import shared_part, sharpness_correlation
from .modes import FRAMES_AT_ONCE, NOISE_FACTOR, faintest_in
from .peaks import find_peaks

SMALLEST_SHARE = 0.25
"""A peak counts as a beat from this share of the signal's whole range."""
REST_SHARE = 0.02
"""The tissue rests where the signal is within this share of the beat's height above its lowest point."""
CUT_SHARE = 0.3
"""A beat is cut off by the movie's end where the signal there is above this share of the usual height over the rests
nearby."""
SMALLEST_PX = 0.01
"""Motion below this cannot be measured with 8-bit tracking on any movie seen so far."""
CHANCE = 2.6
"""The signal's correlation from frame to frame exceeds this many standard deviations of that of noise by chance in
0.5 % of motionless movies; flicker and single frames make a signal that stands out, but none that goes on."""
FALSE_ALARMS_PERCENT = 1
"""Motionless movies in which a beat is found, at most, as measured by benchmarks/detection.py."""
MOST_POINTS = 250
EVEN_SHORTENING = 0.87
"""Mean over root mean square length of the displacement of a tissue that shortens evenly."""

PAPER_PROMINENCE_PX = 0.1


@dataclass(frozen=True)
class Cut:
    """Frames at which the movie is cut: beats, and the rests between them."""

    start: list[int]
    peak: list[int]
    stop: list[int]
    complete: list[bool]
    rests: list[tuple[tuple[int, int], ...]]
    """For each beat, the first and end frame of each rest that belongs to it."""


@dataclass(frozen=True)
class Without:
    """Why there is no beat."""

    why: str
    """Empty where nothing stands out of the noise."""
    still: bool = False
    """Nothing was found to move."""


def find_beats(tracks: Tracks, masks: Masks, movie: Movie, config: Config) -> Beats:
    """Find the beats of a tracked movie.

    A movie without a whole beat gives zero beats and a finding that says why.
    """
    if config.method == "paper":
        return _paper_beats(tracks)
    points = tracks.position_px[tracks.reference_frame][tracks.kept]
    displacement = tracks.position_px[:, tracks.kept] - points
    signal = contraction_signal(displacement, points, masks.axis.direction)
    noise = frame_noise(signal)
    cut, without = cut_signal(signal, noise, config.beats, movie.frames_per_s)
    limit = detection_limit(tracks, displacement, config.beats)
    drift = _drift_px(displacement)
    if without.still and drift > limit:  # which the signal need not show, for it follows what does not drift
        without = Without(f"the tissue drifts by {drift:.2g} px, but the movie holds no peak of a beat")
    blur = _why_focus(displacement, points, signal, cut, masks, movie)
    if blur:
        cut, without = Cut([], [], [], [], []), Without(blur, still=True)
    return _beats(tracks, cut, noise, limit, without)


def _drift_px(displacement_px: Floats) -> float:
    """Length of the straight line in time that the mean of displacements (T, N, 2) follows, in px."""
    mean = filled_in(displacement_px).reshape(len(displacement_px), -1, 2).mean(axis=1)
    return float(np.hypot(*np.ptp(mean - without_trend(mean), axis=0)))


def _why_focus(displacement_px: Floats, points_px: Floats, signal: Floats, cut: Cut, masks: Masks,
               movie: Movie) -> str:
    """Say why what was cut into beats is the focus that changes, or give the empty string."""
    if not cut.peak:
        return ""
    resting = np.unique([t for rests in cut.rests for first, stop in rests for t in range(first, stop)])
    pattern = _mean_position(displacement_px[cut.peak]) - _mean_position(displacement_px[resting])
    share = shared_part(pattern, points_px)
    if share > focus.SMALLEST_SHARE or np.nanmean(np.hypot(*pattern.T)) > focus.LARGEST_PX:
        return ""
    together = sharpness_correlation(movie.frames, masks.tissue, signal)
    if abs(together) < focus.CLEARLY:
        return ""
    return (f"what seems to move goes with the sharpness of the frames (correlation {together:.2f}), and only "
            f"{max(share, 0):.0%} of it is shared by the whole tissue, so it is the focus that changes")


def detection_limit(tracks: Tracks, displacement_px: Floats, params: BeatParams) -> float:
    """Predict the mean absolute displacement, in px, of the smallest beats that are found in displacements (T, N, 2).

    About half of such beats are found. It follows from the noise that is left without the motion, see
    `modes.faintest_peak`. NaN for too few frames or points.
    """
    least = max(params.min_amplitude_px, SMALLEST_PX)
    faintest = tracks.faintest_px
    if not np.isfinite(faintest):
        step = max(1, displacement_px.shape[1] // MOST_POINTS)
        seen = filled_in(displacement_px[:, ::step])
        if len(seen) < 5 or seen.shape[1] < 6:
            return float("nan")
        parts = np.array_split(seen, -(-len(seen) // FRAMES_AT_ONCE))
        per_point = np.median([faintest_in(part) for part in parts]) / np.sqrt(seen.shape[1] / 2)
        faintest = EVEN_SHORTENING * float(per_point)
    return max(least, faintest * params.noise_factor / NOISE_FACTOR)


def cut_signal(signal: Floats, noise: float, params: BeatParams,
               frames_per_s: float | None = None) -> tuple[Cut, Without]:
    """Cut a contraction signal (T,) in px into beats, or say why there are none."""
    none = Cut([], [], [], [], [])
    if len(signal) < 5:
        return none, Without(f"the movie has only {len(signal)} frames")
    smooth = np.convolve(np.pad(signal, 1, mode="edge"), [0.25, 0.5, 0.25], mode="valid")
    steady = without_trend(smooth[:, None])[:, 0]
    low, high = np.quantile(steady, [0.02, 0.98])
    stands_out = max(params.noise_factor * noise, params.min_amplitude_px, SMALLEST_PX)
    if np.ptp(steady) < stands_out or not goes_on(signal):
        if np.ptp(smooth - steady) < stands_out:
            return none, Without("", still=True)
        return none, Without("the tissue drifts, but the movie holds no peak of a beat")
    distance = max(1.0, params.min_period_s * frames_per_s) if frames_per_s else 1.0
    prominence = max(stands_out, SMALLEST_SHARE * (high - low))
    # Below both ends, so that a signal that starts or ends high has a peak there: a beat that is cut off.
    padded = np.concatenate([[smooth.min()], smooth, [smooth.min()]])
    peaks = find_peaks(padded, prominence=prominence, distance=distance) - 1
    inner = peaks[(peaks > 0) & (peaks < len(signal) - 1)]
    if len(inner) == 0:
        return none, Without(f"the tissue moves by {high - low:.3g} px, but the movie holds no peak of a beat")
    return _cut_at(smooth, noise, inner), Without("")


def goes_on(signal: Floats) -> bool:
    """Tell whether a signal (T,) without its trend goes on from frame to frame, or from period to period, as noise does
    not."""
    steady = without_trend(signal[:, None])[:, 0]
    size = float((steady**2).sum())
    along = float((steady[1:] * steady[:-1]).sum()) / size if size > 0 else 0.0
    return along > CHANCE / np.sqrt(len(signal)) or repeating_share(steady) > CLEARLY_REPEATS


def _cut_at(smooth: Floats, noise: float, peaks: Ints) -> Cut:
    """Put the cuts into the middle of the rests around the peaks."""
    edges = [0, *(int(p) for p in peaks), len(smooth) - 1]
    rests = [_rest(smooth, a, b, noise) for a, b in pairwise(edges)]
    level = [float(smooth[a:b].mean()) for a, b in rests]
    base = _local_base(level)
    height = float(np.median([smooth[p] - 0.5 * (a + b) for p, (a, b) in zip(peaks, pairwise(base), strict=True)]))
    whole = [lvl - low <= CUT_SHARE * height for lvl, low in zip(level, base, strict=True)]

    cuts = [(a + b) // 2 for a, b in rests]
    rise = int(np.median([p - c for p, c in zip(peaks[1:], cuts[1:-1], strict=True)] or [peaks[0] - rests[0][0]]))
    fall = int(np.median([c - p for p, c in zip(peaks[:-1], cuts[1:-1], strict=True)] or [rests[-1][1] - peaks[-1]]))
    # The first and last rests may be long, or cut short by the movie; the beat takes from them what others take.
    cuts[0] = max(rests[0][0], int(peaks[0]) - rise) if whole[0] else 0
    cuts[-1] = min(rests[-1][1], int(peaks[-1]) + fall) if whole[-1] else len(smooth)

    starts, stops, tops = cuts[:-1], cuts[1:], [int(p) for p in peaks]
    complete = [bool(a and b) for a, b in pairwise(whole)]
    pairs = [tuple(r for r, ok in ((rests[i], whole[i]), (rests[i + 1], whole[i + 1])) if ok)
             for i in range(len(tops))]
    # What is left at the ends, when it rises high enough, is part of one more beat.
    for first, stop, side in ((0, starts[0], 0), (stops[-1], len(smooth), -1)):
        part = smooth[first:stop]
        if len(part) > 1 and part.max() - base[side] > CUT_SHARE * height:
            where = 0 if side == 0 else len(tops)
            starts.insert(where, first)
            stops.insert(where, stop)
            tops.insert(where, first + int(np.argmax(part)))
            complete.insert(where, False)
            pairs.insert(where, (rests[side],) if whole[side] else ())
    lowest = rests[int(np.argmin(np.subtract(level, base)))]
    return Cut(starts, tops, stops, complete, [pair or (lowest,) for pair in pairs])


def _local_base(level: list[float]) -> list[float]:
    """Level at which the tissue rests around each rest: the median of those next to it that lie between two peaks, for
    the ends may be cut off, and a stage may drift."""
    inner = level[1:-1] or [min(level)]
    return [float(np.median(inner[min(max(i - 3, 0), len(inner) - 1):i + 2])) for i in range(len(level))]


def _rest(smooth: Floats, first: int, last: int, noise: float) -> tuple[int, int]:
    """First and end frame of the rest between two peaks: the run around the lowest point that stays near it."""
    part = smooth[first:last + 1]
    lowest = int(np.argmin(part))
    height = max(float(min(part[0], part[-1]) - part[lowest]), 0.0)
    if first == 0 or last == len(smooth) - 1:  # one side is the movie's end, not a peak
        height = float(part.max() - part[lowest])
    low = part <= part[lowest] + max(REST_SHARE * height, 2 * noise if np.isfinite(noise) else 0.0)
    a = lowest
    while a > 0 and low[a - 1]:
        a -= 1
    b = lowest + 1
    while b < len(part) and low[b]:
        b += 1
    return first + a, first + b


def _beats(tracks: Tracks, cut: Cut, noise: float, limit: float, without: Without) -> Beats:
    """Complete a cut with the relaxed positions and the signal."""
    relaxed = np.zeros(len(tracks.ok), bool)
    for first, stop in (rest for rests in cut.rests for rest in rests):
        relaxed[first:stop] = True
    if not cut.peak:
        relaxed[:] = True
    beats = Beats(np.zeros(len(relaxed)), noise, np.array(cut.start, int), np.array(cut.peak, int),
                  np.array(cut.stop, int), np.array(cut.complete, bool), relaxed, *at_rest(tracks, relaxed, cut.peak),
                  "default", limit)
    return with_findings(replace(beats, signal_px=signal_from(tracks, beats.relaxed_px)), without)


def at_rest(tracks: Tracks, relaxed: Bools, peaks: Sequence[int] | Ints) -> tuple[Floats, Floats]:
    """Find where the markers rest: over all relaxed frames (N, 2), and around the beats' peaks (B, N, 2)."""
    beat_relaxed = np.full((len(peaks), tracks.ok.shape[1], 2), np.nan)
    for b, weights in enumerate(rest_weights(relaxed, np.array(peaks, int))):
        beat_relaxed[b] = _mean_position(tracks.position_px[weights > 0], weights[weights > 0])
    return _mean_position(tracks.position_px[relaxed]), beat_relaxed


def signal_from(tracks: Tracks, rest_px: Floats) -> Floats:
    """Compute the mean absolute displacement (T,) of the markers that were followed from where they rest (N, 2)."""
    return mean_absolute(tracks.position_px[:, tracks.kept] - rest_px[tracks.kept].astype(np.float32))


def with_findings(beats: Beats, without: Without) -> Beats:
    """Add what a reader should know of the beats, in place of older findings; `without` says why there are none."""
    findings: list[Finding] = []
    whole = int(beats.complete.sum())
    if without.still:
        limit = beats.detection_limit_px
        findings.append(Finding(
            "no_measurable_motion", "fail", "no measurable motion: " + (without.why or (
                f"any beats are below the detection limit of {limit:.2g} px at {FALSE_ALARMS_PERCENT} % false alarms")),
            float(np.ptp(beats.signal_px)), limit))
    elif whole == 0:
        why = without.why or "every beat is cut off by the movie's start or end"
        findings.append(Finding("no_whole_beat", "fail", f"no whole beat: {why}", 0.0, 1.0))
    elif whole < 3:
        findings.append(Finding("few_beats", "review", f"only {whole} whole beat{'s' * (whole > 1)}; a spread "
                                "between beats needs at least two, a rhythm at least three", float(whole), 3.0))
    if len(beats) and not beats.complete[0] and beats.start[0] == 0:
        findings.append(Finding("contracted_start", "info", "the movie starts within a beat; that beat is kept, "
                                "marked as not complete"))
    if len(beats) > 1:
        drift = float(np.hypot(*(beats.drift_px[-1] - beats.drift_px[0])))
        height = float(np.median(beats.signal_px[beats.peak]))
        if drift > 0.25 * height:
            findings.append(Finding("drift", "review", f"the relaxed tissue moves by {drift:.2g} px over the movie; "
                                    "each beat is measured from its own relaxed state", drift, 0.25 * height))
    return replace(beats, findings=tuple(findings))


def _paper_beats(tracks: Tracks) -> Beats:
    moved = tracks.position_px - tracks.position_px[0]
    series = np.hypot(moved[..., 0], moved[..., 1]).mean(axis=1)
    crossings = np.flatnonzero(np.diff(np.sign(series - series.mean())))
    peaks = np.empty(0, int)
    if len(crossings) > 1:
        distance = max(1.0, 1.5 * float(np.diff(crossings).mean()))
        peaks = find_peaks(series, distance=distance, prominence=PAPER_PROMINENCE_PX)
    valleys = ((peaks[:-1] + peaks[1:]) / 2).astype(int)
    start, stop = valleys[:-1], valleys[1:]
    peak = peaks[1:-1] if len(peaks) > 2 else np.empty(0, int)
    relaxed = np.zeros(len(series), bool)
    relaxed[start] = True
    beats = Beats(series, frame_noise(series), start, peak, stop, np.ones(len(start), bool), relaxed,
                  tracks.position_px[0].astype(float), tracks.position_px[start].astype(float), "paper")
    return with_findings(beats, Without(f"the published method needs three peaks; {len(peaks)} were found"))


def _mean_position(position_px: Floats, weights: Floats | None = None) -> Floats:
    """Mean over frames (F, N, 2) -> (N, 2), over the frames in which each marker was followed, by weights (F,)."""
    seen: Bools = np.isfinite(position_px)
    weight = seen * (np.ones(len(seen)) if weights is None else weights)[:, None, None]
    total = (weight * np.where(seen, position_px, 0)).sum(axis=0)
    return np.asarray(np.divide(total, weight.sum(axis=0), out=np.full(total.shape, np.nan), where=seen.any(axis=0)))
