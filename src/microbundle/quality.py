"""Judge the frames of a movie: what was found, its number and limit, and what to do about it.

A finding is `info` where the numbers are right nevertheless, `review` where some of them may not be; what a method
copes with by itself is `info` for that method. Limits are held against faults made on purpose and against good movies
by benchmarks/quality.py (docs/quality.md). `quality_result` judges what the stages made of the frames; findings of
single stages (masks, lost frames, beats, stage) are made there.
"""

from __future__ import annotations

import numpy as np

from .appearance import Appearance, look
from .config import Method
from .data import Bools, Finding, Floats, Level, Masks, Movie
from .prepare import stands_out

SHARP = 0.06
"""Share of the texture's power in details finer than 6.4 px: 0.19 to 0.36 in sharp tissues, 0.03 to 0.06 after a blur
of 1.5 px."""
FOCUS_CHANGE = 0.15
"""Between quarters of a movie, as a share of its sharpness: below 0.05 in good movies."""
CONTRAST_TO_NOISE, TELLING = 1.0, 4.0
"""From the second on, the sharpness of a few frames is known well."""
GREY_LEVELS = 16
CUT_OFF, MUCH_CUT_OFF = 0.005, 0.05
"""A fifth of the tissue cut off makes displacement less exact by a tenth; but a place where all is cut off shows
nothing."""
FLICKER, FLICKER_UNDONE = 0.01, 0.2
BRIGHTNESS_DRIFT = 0.1
REPEATED = 0.25
"""A frame repeats the one before where its noise differs by less than this share of what is usual."""
STEADY = 0.6
"""Noise is steady where the smaller differences, repeated frames left out, reach this share of the larger ones."""
GAP = 1.5
"""Frames are missing where the time to the next exceeds the usual one by this factor."""
FEWEST_FOR_RHYTHM = 5
"""Frames that are needed to tell what is usual."""


def check_movie(movie: Movie, masks: Masks, method: Method = "accurate") -> tuple[Finding, ...]:
    """Judge the frames of a movie: focus, grey scale, light, repeated and missing frames, calibration.

    At most 600 frames are looked at, one at a time. A movie of a single frame gets what one frame can tell.
    """
    seen = look(movie, masks.tissue)
    copes = method != "paper"
    every = (_sharpness(seen), _focus_drift(seen), _contrast(seen), _grey_levels(seen), _saturation(seen),
             _flicker(seen, copes), _flashes(seen, copes), _brightness_drift(seen, copes), _repeats(seen, movie.count),
             _gaps(movie), _calibration(movie))
    return tuple(finding for finding in every if finding is not None)


def _sharpness(seen: Appearance) -> Finding | None:
    if seen.texture is None or not seen.texture.sharpness < SHARP:
        return None
    return Finding("blurred", "review", f"the tissue shows little fine detail ({seen.texture.sharpness:.1%} of its "
                   f"texture is finer than 6 px, expected {SHARP:.0%} or more): it is out of focus, or magnified so "
                   "far that its structures are large; displacement is less exact. Focus on the tissue, or bin "
                   "the pixels", seen.texture.sharpness, SHARP)


def _focus_drift(seen: Appearance) -> Finding | None:
    if seen.texture is None or seen.texture.contrast_to_noise < TELLING:
        return None
    parts = seen.texture.sharpness_of_parts
    if len(parts) < 2 or not parts.mean() > 0:
        return None
    change = float(np.ptp(parts) / parts.mean())
    if not change > FOCUS_CHANGE:
        return None
    return Finding("focus_drift", "review", f"the sharpness of the tissue changes by {change:.0%} over the movie "
                   f"(limit {FOCUS_CHANGE:.0%}): the focus drifts, and later displacements are less exact. Let the "
                   "microscope settle, or cut the movie with reading.first_frame and reading.stop_frame",
                   change, FOCUS_CHANGE)


def _contrast(seen: Appearance) -> Finding | None:
    if seen.texture is None or not seen.texture.contrast_to_noise < CONTRAST_TO_NOISE:
        return None
    ratio = seen.texture.contrast_to_noise
    return Finding("low_contrast", "review", f"the tissue's texture has {ratio:.2g} times the power of the noise in a "
                   f"frame (expected {CONTRAST_TO_NOISE:g} or more): numbers of single frames and sub-domains are "
                   "noisy, see their standard errors. More light, phase contrast, or longer exposure", ratio,
                   CONTRAST_TO_NOISE)


def _grey_levels(seen: Appearance) -> Finding | None:
    if seen.grey_levels >= GREY_LEVELS:
        return None
    return Finding("few_grey_levels", "review", f"the tissue has only {seen.grey_levels} grey values (expected "
                   f"{GREY_LEVELS} or more), so small motion is lost in rounding. Record with more bits or contrast, "
                   "and do not convert to 8 bits", float(seen.grey_levels), float(GREY_LEVELS))


def _saturation(seen: Appearance) -> Finding | None:
    share = sum(seen.cut_off)
    if not share > CUT_OFF:
        return None
    end = "bright" if seen.cut_off[1] >= seen.cut_off[0] else "dark"
    limit = MUCH_CUT_OFF if share > MUCH_CUT_OFF else CUT_OFF
    return Finding("saturated", "info" if limit == CUT_OFF else "review", f"{share:.1%} of the tissue lies at the "
                   f"{end} end of the grey scale (limit {limit:.1%}) and shows nothing to follow there. "
                   + ("Less light or shorter exposure" if end == "bright" else "More light, or a lower black level"),
                   share, limit)


def _flicker(seen: Appearance, copes: bool) -> Finding | None:
    second = [np.diff(run, 2) for run in _runs(seen) if len(run) >= FEWEST_FOR_RHYTHM]
    if not second:
        return None
    jump = float(np.median(np.abs(np.concatenate(second))) / (0.6745 * np.sqrt(6.0)))
    if not jump > FLICKER:
        return None
    level: Level = "info" if copes and jump < FLICKER_UNDONE else "review"
    return Finding("flicker", level, f"the brightness jumps by {jump:.1%} from frame to frame (limit {FLICKER:.0%}); "
                   + ("this method takes that out. " if level == "info" else "")
                   + "A steady lamp, or an exposure of whole periods of the mains", jump, FLICKER)


def _flashes(seen: Appearance, copes: bool) -> Finding | None:
    if len(seen.frames) < FEWEST_FOR_RHYTHM:
        return None
    # Runs of a long movie are judged one by one, for the light may have changed between them.
    out = np.concatenate([stands_out(run) for run in _runs(seen)])
    if not out.any():
        return None
    first = int(seen.frames[np.flatnonzero(out)[0]])
    return Finding("flash", "info" if copes else "review", f"{int(out.sum())} of {len(out)} frames are much brighter "
                   f"or darker than those around them, first frame {first}"
                   + (". This method takes that out" if copes else ": leave them out with reading.drop_flashes"),
                   float(out.sum()), 0.0)


def _brightness_drift(seen: Appearance, copes: bool) -> Finding | None:
    if len(seen.frames) < FEWEST_FOR_RHYTHM:
        return None
    good = np.abs(seen.brightness - np.median(seen.brightness)) < 0.5  # a flash is no drift
    t = seen.frames[good] - seen.frames[good].mean()
    slope = float((t * seen.brightness[good]).sum() / max(float((t * t).sum()), 1e-300))
    change = slope * float(seen.frames[-1] - seen.frames[0])
    if not abs(change) > BRIGHTNESS_DRIFT:
        return None
    return Finding("brightness_drift", "info" if copes else "review", f"the picture becomes "
                   f"{'brighter' if change > 0 else 'darker'} by {abs(change):.0%} over the movie (limit "
                   f"{BRIGHTNESS_DRIFT:.0%}); " + ("this method takes that out. " if copes else "")
                   + "The lamp warms up, or the dye bleaches: let the light settle first", abs(change),
                   BRIGHTNESS_DRIFT)


def _repeats(seen: Appearance, count: int) -> Finding | None:
    repeated = np.zeros(len(seen.frames), bool)
    for change in seen.change.T:
        repeated |= repeats(change)
    if not repeated.any():
        return None
    first = int(seen.frames[np.flatnonzero(repeated)[0]])
    of = "" if len(seen.frames) == count else f" of the {len(seen.frames)} looked at"
    return Finding("repeated_frames", "review", f"{int(repeated.sum())} frames{of} repeat the frame before, first "
                   f"frame {first}: the camera or a converter filled gaps, so velocities and times are wrong there. "
                   "Export the frames as they were recorded", float(repeated.sum()), 0.0)


def repeats(change: Floats) -> Bools:
    """Tell which frames repeat the one before, by how much their noise (n,) differs; NaN where that is not known.

    Frames without noise that rest look the same too; so nothing is told unless the others differ by a steady amount.
    """
    known = np.isfinite(change)
    none = np.zeros(len(change), bool)
    if known.sum() < FEWEST_FOR_RHYTHM:
        return none
    usual = float(np.quantile(change[known], 0.75))
    alike = known & (change < REPEATED * usual)
    others = change[known & ~alike]
    if usual <= 0 or float(np.quantile(others, 0.05)) < STEADY * usual:
        return none
    return np.asarray(alike)


def _gaps(movie: Movie) -> Finding | None:
    if movie.time_s is None or movie.count < FEWEST_FOR_RHYTHM:
        return None
    steps = np.diff(movie.time_s)
    usual = float(np.median(steps))
    late = np.flatnonzero(steps > GAP * usual)
    if not len(late):
        return None
    lost = float(np.maximum(np.rint(steps[late] / usual) - 1, 1).sum())
    return Finding("dropped_frames", "review", f"by their time stamps, about {lost:.0f} frames are missing in "
                   f"{len(late)} gap{'s' * (len(late) > 1)}, the first after frame {late[0]}; times are right, but "
                   "peaks may have been missed. Record to a faster disk, or fewer frames a second", lost, 0.0)


def _calibration(movie: Movie) -> Finding | None:
    missing = [text for text, known in (("pixel size (um_per_px)", movie.um_per_px), ("frame rate (fps)", movie.time_s))
               if known is None]
    if not missing:
        return None
    return Finding("calibration_unknown", "info", f"{' and '.join(missing)} not known: results are in "
                   f"{' and '.join(u for u, k in (('px', movie.um_per_px), ('frames', movie.time_s)) if k is None)}. "
                   "Give what is missing", float(len(missing)), 0.0)


def _runs(seen: Appearance) -> list[Floats]:
    """Brightness of each run of consecutive frames."""
    return np.split(seen.brightness, np.flatnonzero(np.diff(seen.frames) > 1) + 1)
