"""How well points and bodies of sparse regions are followed, and at what cost: the tables of docs/methods.md.

    python benchmarks/sparse_regions.py

Painted textures move by a known affine motion (points) or rigid motion (a disk of 3,000 px), up to 3 px with one step
of 8 px, under white noise given as a share of full scale; three textures, with noise of their own. OpenCV's pyramidal
Lucas-Kanade follows the same points from the same frame, in 8 bits, with the same window of 21 px. Errors are root mean
squares of one component in px over all points and frames that were followed, `within` the share of 95 % intervals that
hold the truth. CPU milliseconds are those of one frame of 512 x 512 px, with decoding from memory.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import TypeVar

import cv2
import numpy as np

from microbundle import Movie, follow_body, follow_points
from microbundle.data import Floats, Image
from microbundle.synth.motion import Composed, Motion, RigidMotion, UniformStretch
from microbundle.synth.render import Rendered
from microbundle.synth.texture import band_limited, procedural_tissue

SHAPE, CENTER = (180, 220), (90.0, 110.0)
FRAMES = 20
SEEDS = range(3)
NOISES = (0.0, 0.001, 0.002, 0.005, 0.01, 0.02)
GREY = 60000
POINTS = np.stack(np.meshgrid(np.arange(28, 155, 11.3), np.arange(28, 195, 11.7), indexing="ij"), -1).reshape(-1, 2)
DISK = np.hypot(*(np.indices(SHAPE) - np.reshape(CENTER, (2, 1, 1)))) < 31
LARGE, TIMED_FRAMES = (512, 512), 40

Result = TypeVar("Result")


def motions(seed: int) -> tuple[Motion, RigidMotion]:
    """An affine and a rigid motion that begin at rest."""
    rng = np.random.default_rng(seed)
    shift = rng.uniform(-1.5, 1.5, (FRAMES, 2))
    shift[0], shift[5], shift[6] = 0, 0.5, (3, -7.4)
    stretch, turn = rng.uniform(-0.03, 0.03, (FRAMES, 2, 2)), rng.uniform(-0.02, 0.02, FRAMES)
    stretch[0], turn[0] = 0, 0
    return Composed((UniformStretch(np.eye(2) + stretch, CENTER), RigidMotion(shift))), RigidMotion(shift, turn, CENTER)


def perfect(motion: Motion, seed: int) -> Floats:
    """Frames (T, R, C), 0 to 1, of a painted tissue."""
    painted = procedural_tissue((512, 512), seed).image[166:346, 146:366]
    rendered = Rendered(band_limited(painted), motion, SHAPE)
    return np.stack([rendered.perfect(t) for t in range(FRAMES)])


def counts(frames: Floats, noise: float, seed: int) -> Image:
    """What a camera of 16 bits makes of them."""
    dirty = frames + noise * np.random.default_rng(seed).standard_normal(frames.shape)
    return np.clip(np.rint(GREY * dirty), 0, 65535).astype(np.uint16)


def lucas_kanade(frames: Image, points: Floats) -> Floats:
    """Positions (T, N, 2) by OpenCV, NaN where it says that a point is lost."""
    low, high = np.percentile(frames[0], (0.5, 99.5))
    grey = np.clip(np.rint((frames - low) / (high - low) * 255), 0, 255).astype(np.uint8)
    start = np.ascontiguousarray(points[:, ::-1], np.float32)
    criteria = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 50, 0.001)
    out = np.empty((len(frames), len(points), 2))
    for t, frame in enumerate(grey):
        end, status, _ = cv2.calcOpticalFlowPyrLK(grey[0], frame, start, start.copy(), winSize=(21, 21), maxLevel=3,
                                                  criteria=criteria)
        out[t] = np.where(status > 0, end, np.nan)[:, ::-1]
    return out


def rms(values: Floats) -> float:
    """Root mean square of what is known."""
    return float(np.sqrt(np.nanmean(values**2)))


def print_accuracy() -> None:
    """Print the errors of points and bodies against noise."""
    scenes = []
    for seed in SEEDS:
        affine, rigid = motions(seed)
        scenes.append((affine, perfect(affine, seed), rigid, perfect(rigid, seed)))
    print("| noise, % of full scale | follow_points, px | within, followed | Lucas-Kanade, px (median) | "
          "follow_body, px | degrees | within |\n" + "|---" * 7 + "|")
    for noise in NOISES:
        off, scores, followed, other, body, turns, body_scores = [], [], [], [], [], [], []
        for seed, (affine, bent, rigid, turned) in zip(SEEDS, scenes, strict=True):
            frames = counts(bent, noise, seed)
            true = POINTS + np.stack([affine.displacement_px(POINTS, t) for t in range(FRAMES)])
            tracks = follow_points(Movie.from_array(frames), POINTS)
            assert tracks.position_se_px is not None
            error = (tracks.position_px - true)[1:]
            off.append(error)
            scores.append((error / tracks.position_se_px[1:])[tracks.ok[1:]])
            followed.append(tracks.ok[1:].mean())
            other.append((lucas_kanade(frames, POINTS) - true)[1:])
            motion = follow_body(Movie.from_array(counts(turned, noise, seed)), DISK)
            assert rigid.angle_rad is not None
            way = np.column_stack([motion.translation_px - rigid.shift_px,
                                   motion.rotation_deg + np.degrees(rigid.angle_rad)])[1:]
            body.append(way[:, :2])
            turns.append(way[:, 2])
            body_scores.append(way / np.column_stack([motion.translation_se_px, motion.rotation_se_deg])[1:])
        beside = f"{rms(np.array(other)):.4f} ({np.nanmedian(np.abs(other)):.4f})"
        print(f"| {100 * noise:g} | {rms(np.array(off)):.4f} | {within(np.concatenate(scores)):.0%}, "
              f"{np.mean(followed):.1%} | {beside} | {rms(np.array(body)):.4f} | "
              f"{rms(np.array(turns)):.4f} | {within(np.array(body_scores)):.0%} |", flush=True)


def within(scores: Floats) -> float:
    """Share of 95 % intervals that hold the truth."""
    return float((np.abs(scores) < 1.96).mean())


def cpu_ms(work: Callable[[], Result]) -> float:
    """CPU milliseconds per frame, the best of three."""
    spent = []
    for _ in range(3):
        before = time.process_time()
        work()
        spent.append(time.process_time() - before)
    return 1000 * min(spent) / TIMED_FRAMES


def print_cost() -> None:
    """Print CPU milliseconds per frame."""
    cv2.setNumThreads(1)
    shift = 1.5 * np.sin(np.arange(TIMED_FRAMES)[:, None] / 4) * [0.3, 1.0]
    rendered = Rendered(band_limited(procedural_tissue(LARGE, 1).image), RigidMotion(shift), LARGE)
    frames = counts(np.stack([rendered.perfect(t) for t in range(TIMED_FRAMES)]), 0.002, 1)
    points = np.random.default_rng(0).uniform(150, 360, (1000, 2))
    mask = np.hypot(*(np.indices(LARGE) - 256)) < 31
    movie = Movie.from_array(frames)
    print("\n| what | CPU ms per frame |\n|---|---|")
    for name, work in (("follow_points, 1,000 points", lambda: follow_points(movie, points)),
                       ("Lucas-Kanade, 1,000 points", lambda: lucas_kanade(frames, points)),
                       ("follow_body, 3,000 px", lambda: follow_body(movie, mask))):
        print(f"| {name} | {cpu_ms(work):.2f} |", flush=True)


if __name__ == "__main__":
    print_accuracy()
    print_cost()
