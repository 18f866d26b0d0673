"""Replay a person's decisions on beats: leave some out, and put others where the person marked them.

A marked beat takes the place of those whose peaks lie within it; its neighbours end where it begins. The person says
that the tissue rests at its first and last frames and moves between them, so the relaxed states are found anew. The
findings tell of every decision, also of one that no longer fits the movie.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from .beats import Without, at_rest, signal_from, with_findings
from .data import Beats, Bools, Finding, Tracks
from .decisions import Decision, Decisions, DropBeat, MarkBeat


def decide_beats(beats: Beats, tracks: Tracks, decisions: Decisions) -> Beats:
    """Change beats as a person decided, in the order of the decisions, and add findings that say so.

    The published method's beats can be left out, but not marked: what it does with them is fixed.
    """
    told: list[Finding] = []
    changed = False
    for one in decisions.listed:
        if isinstance(one, DropBeat):
            beats, why_not = _without_beat(beats, one.peak_frame)
        elif isinstance(one, MarkBeat):
            beats, why_not = _with_beat(beats, tracks, one)
        else:
            continue
        changed |= not why_not
        told.append(_told(one, beats, why_not))
    if changed:
        beats = with_findings(beats, Without("every beat is left out or cut off"))
    return replace(beats, findings=(*beats.findings, *told))


def _without_beat(beats: Beats, frame: int) -> tuple[Beats, str]:
    """Leave out the beat that a frame belongs to; the second value says why that cannot be."""
    here = np.flatnonzero((beats.start <= frame) & (frame < beats.stop))
    if len(here) == 0:
        return beats, f"no beat was found at frame {frame}"
    out = np.array(beats.left_out)
    out[here[0]] = True
    return replace(beats, left_out=out, complete=beats.complete & ~out), ""


def _with_beat(beats: Beats, tracks: Tracks, mark: MarkBeat) -> tuple[Beats, str]:
    """Put a beat where a person marked it; the second value says why that cannot be."""
    first, stop = mark.start_frame, mark.stop_frame
    if beats.method == "paper":
        return beats, "the method paper takes the published program's beats"
    if stop > len(beats.signal_px):
        return beats, f"the movie has only {len(beats.signal_px)} frames"
    keep = (beats.peak < first) | (beats.peak >= stop)
    before = beats.peak[keep] < first
    starts = np.where(before, beats.start[keep], np.maximum(beats.start[keep], stop))
    stops = np.where(before, np.minimum(beats.stop[keep], first), beats.stop[keep])
    peaks = np.append(beats.peak[keep], mark.peak_frame)
    order = np.argsort(peaks)
    peaks = peaks[order]
    # Where no beat was found every frame counts as relaxed, which a person who marks one denies.
    relaxed = _resting(beats.relaxed & (len(beats) > 0), first, stop)
    changed = Beats(beats.signal_px, beats.noise_px, np.append(starts, first)[order], peaks,
                    np.append(stops, stop)[order], np.append(beats.complete[keep], True)[order], relaxed,
                    *at_rest(tracks, relaxed, peaks), beats.method, beats.detection_limit_px,
                    left_out=np.append(beats.left_out[keep], False)[order])
    return replace(changed, signal_px=signal_from(tracks, changed.relaxed_px)), ""


def _resting(relaxed: Bools, first: int, stop: int) -> Bools:
    """The relaxed frames (T,), of which within a marked beat only those count that lie at its ends."""
    out = np.array(relaxed)
    inner = np.array(relaxed[first:stop])
    moving = np.flatnonzero(~inner)
    if len(moving):
        inner[moving[0]:moving[-1] + 1] = False
    else:
        inner[:] = False
    inner[[0, -1]] = True
    out[first:stop] = inner
    return out


def _told(one: Decision, beats: Beats, why_not: str) -> Finding:
    what = (f"the beat at frame {one.peak_frame} is left out" if isinstance(one, DropBeat) else
            f"a beat lies at frames {one.start_frame} to {one.stop_frame}, with its peak at {one.peak_frame}"
            if isinstance(one, MarkBeat) else "")
    if why_not:
        return Finding("decision_not_replayed", "review", f"a person decided that {what}{one.signed}, but {why_not}. "
                       "Decide again")
    key = "beat_left_out" if isinstance(one, DropBeat) else "beat_marked"
    return Finding(key, "info", f"by a person's decision {what}{one.signed}; {int(beats.complete.sum())} whole beats "
                   "count")

