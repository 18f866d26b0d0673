"""Named sets of validation movies, as data.

    paper     416 movies after S1 Appendix: 16 clean ones (four finite-element simulations x four textures) and each of
              them under Perlin noise of 5 magnitudes x 5 octaves
    type2     a thin sheet on soft posts, clean and noisy
    frontier  what an accurate method must stand: clean and noisy, from 0.1 px to more than a pixel in a frame
    still     noisy movies in which nothing moves, for false alarms
    patchwork four movies drawn the paper's way, by warped tiles, whose truth is only nearly true: reported apart
    smoke     three tiny movies for tests

A case has a `group`, its regime in the table of results. The same case always gives the same movie, to the last
count. All movies but those of `patchwork` have the exact renderer's truth.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np

from ..data import Movie
from ..errors import ConfigError
from .motion import Composed
from .noise import NoiseModel
from .render import Rendered, SyntheticMovie, Truth
from .scenes import FPS, Analytic, Domain, Elements, Scene, Sheet, tapered
from .texture import band_limited

CLEAN_LARGE = "clean, > 1 px"
CLEAN_SMALL = "clean, sub-pixel"
NOISY_LARGE = "noisy, > 1 px"
NOISY_08 = "noisy, about 0.8 px"
NOISY_04 = "noisy, about 0.4 px"
NOISY_02 = "noisy, about 0.2 px"
NOISY_01 = "noisy, about 0.1 px"
STILL = "motionless"
GROUPS = (CLEAN_LARGE, CLEAN_SMALL, NOISY_LARGE, NOISY_08, NOISY_04, NOISY_02, NOISY_01, STILL)
"""Regimes, in the order of the table."""

MAGNITUDES = (0.02, 0.04, 0.08, 0.10, 0.12)
OCTAVES = (18, 24, 28, 32, 40)
"""The paper names the extremes, 8 and 10 %, and 32 octaves; the others between are ours."""
PAPER_SIDE_PX = 90
"""Side of the published synthetic pictures, on which octaves are counted."""


@dataclass(frozen=True)
class Case:
    """One validation movie."""

    name: str
    group: str
    scene: Scene
    noise: NoiseModel = field(default_factory=NoiseModel)
    octaves: int | None = None
    """Octaves of the Perlin noise as the paper counts them, on a picture 90 px wide."""
    how: Literal["exact", "paper"] = "exact"
    """`paper` draws frames by warped tiles, which move fine texture too little."""

    def make(self) -> SyntheticMovie:
        """Make the movie; no frame is drawn before it is asked for."""
        picture = self.scene.picture()
        motion, stage = self.scene.motion(picture)
        motion = tapered(motion, picture)
        if stage is not None:
            motion = Composed((motion, stage))
        shape = (int(picture.image.shape[0]), int(picture.image.shape[1]))
        frames = Rendered(band_limited(picture.image), motion, shape, self.noise, self.how)
        um = self.scene.um_per_px
        movie = Movie(name=self.name, frames=frames, shape=shape, time_s=np.arange(motion.count) / FPS,
                      time_source="user", um_per_px=um, um_per_px_source="user")
        truth = Truth(motion, picture.tissue, FPS, um, self.scene.rhythm)
        return SyntheticMovie(movie, truth, frames, picture.pillars)

    @property
    def domain(self) -> Domain:
        """Square in which errors are measured."""
        return self.scene.domain(self.scene.picture())

    @property
    def scene_key(self) -> str:
        """Name of everything but the noise: cases that share it show the same clean frames."""
        return hashlib.sha256(repr((self.scene, self.how)).encode()).hexdigest()[:16]

    @property
    def key(self) -> str:
        """Fingerprint of all that defines the movie."""
        return hashlib.sha256(repr(self).encode()).hexdigest()[:16]


def case_set(name: str) -> tuple[Case, ...]:
    """Give the cases of a named set. Raises ConfigError for another name."""
    if name not in SETS:
        raise ConfigError(f"--cases: expected one of {', '.join(SETS)}; found {name!r}")
    return SETS[name]()


def perlin(ratio: float, octaves: int, columns: int, seed: int) -> NoiseModel:
    """Make the paper's noise, with as many pixels to a lattice cell as on its pictures of 90 x 90 px."""
    return NoiseModel(perlin_ratio=ratio, perlin_octaves=octaves * columns / PAPER_SIDE_PX, seed=seed)


def camera(seed: int, *, electrons: float = 20_000, read: float = 0.002) -> NoiseModel:
    """Make the noise of a camera: shot and read noise, with a lamp that flickers by 0.2 %."""
    return NoiseModel(full_well_electrons=electrons, read_noise=read, flicker_gain=0.002, bits=12, seed=seed)


def paper_set() -> tuple[Case, ...]:
    """416 movies: the clean ones first, then the noisy ones texture by texture."""
    clean = []
    for passive in (False, True):
        for fibres in ("length", "depth"):
            for seed in (1, 2, 3, 4):
                name = f"{'heterogeneous' if passive else 'homogeneous'}-{'X' if fibres == 'length' else 'Z'}-{seed}"
                group = CLEAN_SMALL if passive else CLEAN_LARGE
                clean.append(Case(name, group, Elements(seed, passive, fibres)))
    noisy = []
    for case in clean:
        scene = case.scene
        assert isinstance(scene, Elements)
        group = NOISY_04 if scene.passive else NOISY_LARGE
        for ratio in MAGNITUDES:
            for octaves in OCTAVES:
                noise = perlin(ratio, octaves, scene.shape[1], 100 + scene.seed)
                noisy.append(replace(case, name=f"{case.name}-m{round(100 * ratio):02}-o{octaves}", group=group,
                                     noise=noise, octaves=octaves))
    return (*clean, *noisy)


def type2_set() -> tuple[Case, ...]:
    """A thin sheet on soft posts: clean, with Perlin noise and with a camera's."""
    return (
        Case("sheet-clean", CLEAN_SMALL, Sheet(1)),
        Case("sheet-m06-o32", NOISY_04, Sheet(2), perlin(0.06, 32, 560, 2), 32),
        Case("sheet-camera", NOISY_04, Sheet(3), camera(3)),
    )


def frontier_set() -> tuple[Case, ...]:
    """30 movies from a tenth of a pixel to more than a pixel in a frame; every one has a texture of its own."""
    tall = (336, 448)
    fast = {"rise": 0.22, "active": 0.4}
    contracted = {"first_beat": -0.2, "variation": 0.12}

    def clean(name: str, mad_px: float, seed: int, **scene: object) -> Case:
        group = CLEAN_LARGE if mad_px > 1 else CLEAN_SMALL
        return Case(f"clean-{mad_px:g}px-{name}", group, Analytic(mad_px, seed, **scene))  # type: ignore[arg-type]

    def noisy(name: str, mad_px: float, seed: int, noise: tuple[float, int] | NoiseModel, **scene: object) -> Case:
        group = NOISY_LARGE if mad_px > 1 else {0.8: NOISY_08, 0.4: NOISY_04, 0.2: NOISY_02, 0.1: NOISY_01}[mad_px]
        octaves = None
        if isinstance(noise, tuple):
            octaves, noise = noise[1], perlin(*noise, 448, seed)
        kind = f"noisy-{mad_px:g}px-{name}"
        return Case(kind, group, Analytic(mad_px, seed, **scene), noise, octaves)  # type: ignore[arg-type]

    return (
        clean("travelling", 1.6, 11, delay_frames=5.0),
        clean("inclusion", 1.2, 12, inclusion=True),
        clean("fast", 1.6, 13, **fast),
        clean("tilted-turning", 1.2, 14, shape=tall, angle_deg=18.0, turn_deg=1.5),
        clean("contracted-start", 1.2, 15, **contracted),
        clean("inclusion", 0.8, 16, inclusion=True),
        clean("travelling", 0.4, 17, delay_frames=5.0),
        clean("drift", 0.4, 18, drift_px=(0.012, -0.008)),
        clean("inclusion", 0.2, 19, inclusion=True),
        clean("tilted", 0.1, 20, shape=tall, angle_deg=-25.0),
        noisy("perlin-12-18", 1.2, 21, (0.12, 18), delay_frames=4.0),
        noisy("perlin-12-40", 1.6, 22, (0.12, 40), inclusion=True),
        noisy("perlin-06-28-fast", 1.6, 23, (0.06, 28), **fast),
        noisy("camera", 1.2, 24, camera(24), inclusion=True),
        noisy("weak-light-drift", 1.2, 25, camera(25, electrons=2_000, read=0.01), drift_px=(0.02, 0.015)),
        noisy("camera-contracted", 1.6, 26, camera(26), **contracted),
        noisy("perlin-06-28", 0.8, 27, (0.06, 28), inclusion=True),
        noisy("camera", 0.8, 28, camera(28), delay_frames=5.0),
        noisy("perlin-12-40", 0.4, 29, (0.12, 40)),
        noisy("perlin-06-28", 0.4, 30, (0.06, 28), inclusion=True),
        noisy("camera-inclusion", 0.4, 31, camera(31), inclusion=True),
        noisy("weak-light", 0.4, 32, camera(32, electrons=2_000, read=0.01), delay_frames=4.0),
        noisy("camera-drift", 0.4, 33, camera(33), drift_px=(0.01, 0.01)),
        noisy("perlin-06-40", 0.2, 34, (0.06, 40)),
        noisy("perlin-04-24", 0.2, 35, (0.04, 24), inclusion=True),
        noisy("camera", 0.2, 36, camera(36), inclusion=True),
        noisy("camera-tilted", 0.2, 37, camera(37), shape=tall, angle_deg=20.0),
        noisy("weak-light", 0.2, 38, camera(38, electrons=2_000, read=0.01)),
        noisy("camera", 0.1, 39, camera(39)),
        noisy("perlin-02-40", 0.1, 40, (0.02, 40)),
    )


def still_set() -> tuple[Case, ...]:
    """Movies in which the tissue rests, under every kind of noise: what is found in them is a false alarm."""
    def rest(name: str, seed: int, noise: NoiseModel, octaves: int | None = None, **scene: object) -> Case:
        return Case(f"still-{name}", STILL, Analytic(0.0, seed, **scene), noise, octaves)  # type: ignore[arg-type]

    lamp = replace(camera(64), flicker_gain=0.01, lamp_drift=0.03)
    focus = replace(camera(65), defocus_swing_px=0.4, defocus_period_frames=24.0)
    return (
        rest("camera", 61, camera(61)),
        rest("weak-light", 62, camera(62, electrons=2_000, read=0.01)),
        rest("drift", 63, camera(63), drift_px=(0.02, -0.01)),
        rest("lamp", 64, lamp),
        rest("focus", 65, focus),
        rest("perlin-02-40", 66, perlin(0.02, 40, 448, 66), 40),
        rest("perlin-06-28", 67, perlin(0.06, 28, 448, 67), 28),
        rest("perlin-12-18", 68, perlin(0.12, 18, 448, 68), 18),
    )


def patchwork_set() -> tuple[Case, ...]:
    """Clean movies drawn by the paper's 16 x 16 projective tiles: bundles of more and of less than a pixel."""
    return tuple(Case(f"patchwork-{case.name}", f"{case.group} (patchwork)", case.scene, how="paper")
                 for case in paper_set()[:16] if case.name.endswith(("X-1", "X-2")))


def smoke_set() -> tuple[Case, ...]:
    """Three tiny movies, for tests: clean, noisy, and one that rests."""
    small = {"shape": (128, 224), "frames": 84, "side_px": 40.0}
    return (
        Case("smoke-clean", CLEAN_LARGE, Analytic(1.2, 51, **small)),  # type: ignore[arg-type]
        Case("smoke-noisy", NOISY_04, Analytic(0.4, 52, **small), perlin(0.02, 40, 224, 52), 40),  # type: ignore[arg-type]
        Case("smoke-still", STILL, Analytic(0.0, 53, **small), camera(53)),  # type: ignore[arg-type]
    )


SETS: dict[str, Callable[[], tuple[Case, ...]]] = {
    "paper": paper_set, "type2": type2_set, "frontier": frontier_set, "still": still_set,
    "patchwork": patchwork_set, "smoke": smoke_set,
}
