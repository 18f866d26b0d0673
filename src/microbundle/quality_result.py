"""Judge a result: amplitude, tracking, timing of the beats, and sub-domains, each with its number and limit.

The frames themselves are judged by `quality`; see there for what the levels mean and where the limits come from.
"""

from __future__ import annotations

import numpy as np

from .appearance import sharpness_at, spread
from .config import Method
from .contraction import contraction_signal
from .data import Beats, Finding, Floats, Masks, Movie, Strain, Tracks, known

WHOLE_PX = 1.0
CONTRACTED = 0.3
"""A movie starts contracted where its first frame is above this share of the contraction signal's range."""
FOCUS_WITH_BEAT = 0.1
"""Change of sharpness from rest to peak: below 0.03 in good movies, 0.02 and 0.06 in real ones; 0.11 to 0.18 where the
peaks are blurred by 0.5 px, which makes displacement wrong by 0.05 px."""
MOST_COMPARED = 8
NEAR_PEAK = 2
"""Frames from a peak within which a lost frame may have held the real one."""
MISSES_PX = 0.05
"""Below 0.01 in good movies, 0.11 where the noise is half of the contrast."""
RESIDUAL = 0.2
"""Standard deviations of the tissue: 0 to 0.07 in good movies, 0.12 in a real one."""
FRAMES_A_BEAT, FRAMES_UP = 8.0, 3.0
FOOT = 0.1
"""Share of a beat's height at which its upstroke begins."""
UNEVEN, ROUNDING_FRAMES = 0.2, 2
"""Longest against shortest time between beats, as a share of the usual, beyond what whole frames make of even ones."""
MOST_WITHOUT_STRAIN = 0.5
FEWEST_IN_QUARTER = 6
SMALLEST_STRAIN, SMALLER_SHARE, CLEARLY = 0.005, 0.25, 4.0
"""Two quarters of a sub-domain deform in opposite ways where the smaller strain exceeds all of: this strain, this share
of the largest one, and this many of its standard errors."""


def check_result(movie: Movie, masks: Masks, tracks: Tracks, beats: Beats, strain: Strain | None,
                 method: Method = "accurate") -> tuple[Finding, ...]:
    """Judge what was measured on a movie; without beats, little can be said.

    At most 32 frames of the movie are looked at, to compare peaks with rests.
    """
    every = (_contracted_start(tracks, masks) if method == "paper" else None, _amplitude(beats, method),
             _peaks(tracks, beats), _focus_with_beat(movie, masks, beats), _misses(tracks), _residual(tracks, beats),
             _timing(beats), _rhythm(beats), _without_strain(strain), _sign_change(tracks, beats, strain))
    return tuple(finding for finding in every if finding is not None)


def _contracted_start(tracks: Tracks, masks: Masks) -> Finding | None:
    """For `paper`, which counts displacement from frame 0 and marks no beat as cut off."""
    points = tracks.position_px[0]
    signal = contraction_signal(tracks.position_px - points, points, masks.axis.direction)
    low, high = np.quantile(signal, [0.05, 0.95])
    share = float((signal[0] - low) / (high - low)) if high > low else 0.0
    if not share > CONTRACTED:
        return None
    return Finding("contracted_start", "review", f"the tissue is contracted in the first frame ({share:.0%} of its "
                   f"range, limit {CONTRACTED:.0%}), from which `paper` counts all displacement: amplitude and strain "
                   "are wrong. Begin with a relaxed frame (reading.first_frame), or use another method", share,
                   CONTRACTED)


def _amplitude(beats: Beats, method: Method) -> Finding | None:
    peaks = beats.signal_px[beats.peak]
    if not np.isfinite(peaks).any():
        return None
    size = float(np.nanmedian(peaks))
    if not size < WHOLE_PX:
        return None
    limit = beats.detection_limit_px
    small = f"; beats below {limit:.2g} px would be missed" if np.isfinite(limit) else ""
    if method == "accurate":
        return Finding("sub_pixel_motion", "info", f"the tissue moves by less than a pixel (on average {size:.2g} px "
                       f"at the peaks{small}): look at the standard errors", size, WHOLE_PX)
    return Finding("sub_pixel_motion", "review", f"the tissue moves by less than a pixel (on average {size:.2g} px "
                   f"at the peaks{small}), where single markers err by a tenth of it and more. Use the method "
                   "accurate, or magnify more", size, WHOLE_PX)


def _peaks(tracks: Tracks, beats: Beats) -> Finding | None:
    """A lost frame near a peak takes the peak away."""
    lost = np.flatnonzero(~tracks.ok.any(axis=1))
    near = np.abs(beats.peak[:, None] - lost).min(axis=1, initial=NEAR_PEAK + 1) <= NEAR_PEAK
    if not near.any():
        return None
    return Finding("peaks_lost", "fail" if near.mean() > 0.5 else "review", f"frames at the peaks of {int(near.sum())} "
                   f"of {len(near)} beats were lost, so their amplitude and strain are too small: the tissue moves too "
                   "far, folds or leaves the focus there. Look at those frames", float(near.sum()), 0.0)


def _focus_with_beat(movie: Movie, masks: Masks, beats: Beats) -> Finding | None:
    peaks = beats.peak[beats.complete & (beats.peak < movie.count - 1)]
    rests = np.flatnonzero(beats.relaxed[:-1] & beats.relaxed[1:])
    if len(peaks) == 0 or len(rests) < 2:
        return None
    peak, rest = (sharpness_at(movie, masks.tissue, spread(frames, MOST_COMPARED)) for frames in (peaks, rests))
    usual = float(rest.mean())
    change = float(peak.mean()) / usual - 1 if usual > 0 else 0.0
    error = float(rest.std(ddof=1)) * np.sqrt(1 / len(peak) + 1 / len(rest)) / usual if usual > 0 else 0.0
    if not abs(change) > max(FOCUS_WITH_BEAT, CLEARLY * error):
        return None
    return Finding("focus_with_beat", "review", f"the tissue is {abs(change):.0%} {'less' if change < 0 else 'more'} "
                   f"sharp at the peaks than at rest (limit {FOCUS_WITH_BEAT:.0%}): it leaves the focal plane with "
                   "every beat, which looks like motion of some hundredths to tenths of a pixel. Focus where it stays "
                   "sharp, or use an objective of smaller aperture", abs(change), FOCUS_WITH_BEAT)


def _misses(tracks: Tracks) -> Finding | None:
    if tracks.forward_backward_px is None or len(tracks.forward_backward_px) == 0:
        return None
    miss = float(np.median(tracks.forward_backward_px))
    if not miss > MISSES_PX:
        return None
    return Finding("forward_backward", "review", f"tracking to a frame and back misses the start by {miss:.2g} px for "
                   f"half of the markers (limit {MISSES_PX:g} px): noise, blur, or motion out of the picture's plane. "
                   "Use the method accurate", miss, MISSES_PX)


def _residual(tracks: Tracks, beats: Beats) -> Finding | None:
    """What is left unexplained at the peaks, beyond what noise leaves at rest."""
    if tracks.residual is None or len(beats) == 0 or not beats.relaxed.any():
        return None
    rest = float(np.nanmedian(tracks.residual[beats.relaxed]))
    peak = float(np.nanmedian(tracks.residual[beats.peak]))
    left = float(np.sqrt(max(peak**2 - rest**2, 0.0)))
    if not left > RESIDUAL:
        return None
    return Finding("large_residual", "review", f"at the peaks of the beats, displacement leaves {left:.0%} of the "
                   f"tissue's contrast unexplained, more than noise does (limit {RESIDUAL:.0%}): the tissue leaves the "
                   "focus, moves out of the plane or folds, or moves too far to be followed. Look at the frames of the "
                   "peaks", left, RESIDUAL)


def _timing(beats: Beats) -> Finding | None:
    whole = np.flatnonzero(beats.complete & np.isfinite(beats.signal_px[beats.peak]))
    if len(whole) == 0:
        return None
    up = float(np.median([upstroke_frames(beats.signal_px[beats.start[b]:beats.peak[b] + 1]) for b in whole]))
    length = float(np.median(np.diff(beats.peak))) if len(beats) > 1 else float((beats.stop - beats.start)[whole[0]])
    if up >= FRAMES_UP and length >= FRAMES_A_BEAT:
        return None
    few, value, limit = (f"{up:.1f} frames to rise", up, FRAMES_UP) if up < FRAMES_UP else (
        f"{length:.0f} frames", length, FRAMES_A_BEAT)
    return Finding("slow_frames", "review", f"a beat has only {few} (expected {limit:g} or more): peaks are cut, and "
                   "times and velocities are coarse. Record more frames a second", value, limit)


def upstroke_frames(rise_px: Floats) -> float:
    """Count the frames, with parts, from a tenth of a beat's height to its peak, the last value of a signal (n,)."""
    seen = np.flatnonzero(np.isfinite(rise_px))
    rise_px = np.interp(np.arange(len(rise_px)), seen, rise_px[seen])
    low = float(rise_px.min())
    foot = low + FOOT * (float(rise_px[-1]) - low)
    below = np.flatnonzero(rise_px <= foot)
    if len(below) == 0 or below[-1] + 1 >= len(rise_px):
        return 0.0
    t = int(below[-1])
    step = float(rise_px[t + 1] - rise_px[t])
    return len(rise_px) - 1 - t - (foot - float(rise_px[t])) / step


def _rhythm(beats: Beats) -> Finding | None:
    between = np.diff(beats.peak)[beats.complete[1:] & beats.complete[:-1]]
    if len(between) < 2:
        return None
    away = float(np.ptp(between) / np.median(between))
    if not away > UNEVEN or np.ptp(between) <= ROUNDING_FRAMES:
        return None
    return Finding("irregular_beats", "info", f"the times between beats differ by {away:.0%} of the usual (limit "
                   f"{UNEVEN:.0%}): the tissue beats irregularly, or a beat was missed. Look at the trace", away,
                   UNEVEN)


def _without_strain(strain: Strain | None) -> Finding | None:
    if strain is None or not any(strain.reason):
        return None
    why = [f"{label}: {reason}" for label, reason in zip(strain.label, strain.reason, strict=True) if reason]
    share = len(why) / len(strain.label)
    return Finding("subdomains_without_strain", "review" if share > MOST_WITHOUT_STRAIN else "info",
                   f"{len(why)} of {len(strain.label)} sub-domains have no strain ({'; '.join(why[:3])}"
                   f"{'; ...' if len(why) > 3 else ''}). Try larger ones (strain.tile_px), or other strain.extents_px",
                   share, MOST_WITHOUT_STRAIN)


def _sign_change(tracks: Tracks, beats: Beats, strain: Strain | None) -> Finding | None:
    if strain is None or len(beats) == 0:
        return None
    use = tracks.kept & known(beats.relaxed_px)
    rest = beats.relaxed_px[use]
    moved = tracks.position_px[beats.peak][:, use] - beats.beat_relaxed_px[:, use]
    seen = known(moved).any(axis=0)
    rest, moved = rest[seen], np.nanmedian(moved[:, seen], axis=0)
    mixed = [label for label, corners, reason in zip(strain.label, strain.corner_px, strain.reason, strict=True)
             if not reason and opposite_quarters(rest, moved, corners)]
    if not mixed:
        return None
    return Finding("sign_change", "info", f"part of the sub-domain{'s' * (len(mixed) > 1)} {', '.join(mixed[:6])}"
                   f"{', ...' if len(mixed) > 6 else ''} shortens while another part lengthens along the tissue, and "
                   f"{'their' if len(mixed) > 1 else 'its'} strain is the mean of both. Use smaller sub-domains "
                   "(strain.tile_px)", float(len(mixed)), 0.0)


def opposite_quarters(points_px: Floats, displacement_px: Floats, corners_px: Floats) -> bool:
    """Tell whether two quarters of a sub-domain deform along the tissue in clearly opposite ways.

    Points (N, 2) with displacements (N, 2) count where they lie in the sub-domain of the corners (4, 2).
    """
    along, across = corners_px[1] - corners_px[0], corners_px[3] - corners_px[0]
    length, width = float(np.hypot(*along)), float(np.hypot(*across))
    x, y = (points_px - corners_px[0]) @ along / length, (points_px - corners_px[0]) @ across / width
    inside = (x >= 0) & (x < length) & (y >= 0) & (y < width)
    x, y, u = x[inside], y[inside], displacement_px[inside] @ along / length
    quarters = [(x < length / 2) == left for left in (True, False)]
    quarters = [half & ((y < width / 2) == upper) for half in quarters for upper in (True, False)]
    slope, error = np.array([_slope(x[quarter], u[quarter]) for quarter in quarters]).T
    least = max(SMALLEST_STRAIN, SMALLER_SHARE * float(np.abs(slope).max()))
    clear = np.abs(slope) > np.maximum(CLEARLY * error, least)
    return bool((slope[clear] > 0).any() and (slope[clear] < 0).any())


def _slope(x: Floats, u: Floats) -> tuple[float, float]:
    """Slope of u (n,) over x (n,) and its standard error; 0 where there are too few points."""
    if len(x) < FEWEST_IN_QUARTER or np.ptp(x) == 0:
        return 0.0, np.inf
    dx = x - x.mean()
    spread = float((dx * dx).sum())
    slope = float((dx * u).sum()) / spread
    left = u - u.mean() - slope * dx
    return slope, float(np.sqrt((left * left).sum() / (len(x) - 2) / spread))
