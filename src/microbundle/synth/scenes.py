"""What a validation movie shows: a picture that rests, and the motion that it is put into.

A scene is data. It makes its picture and its motion when asked, and always the same ones. `Analytic` beats by a
formula (`motion.TissueMotion`: activation that travels, an inclusion of opposite strain, beats that differ, a stage
that drifts and turns), so its motion is no product of a shape and a time course. `Elements` is a finite-element
bundle between two pillars, as in the paper (S1 Appendix), and `Sheet` the thin sheet of the paper's Type 2. Solutions
are kept in the user's cache folder, for a solve takes some seconds.
"""

from __future__ import annotations

import hashlib
import os
import sys
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import Literal, Protocol

import numpy as np
from scipy import ndimage

from ..data import Bools, Floats
from ..errors import OutputError, ResultUnreadable
from .activation import Fibres, PassiveCore, clipped_cosine
from .membrane import ALIGNED, FIBROUS, fibrous_sheet, solve_membrane
from .motion import Inclusion, Motion, Rhythm, RigidMotion, TissueMotion
from .outline import Bundle, inside
from .render import Tapered
from .solution import TissueSolution
from .texture import TissuePicture, procedural_tissue
from .tissue import solve_tissue

UM_PER_PX = 4.0
FPS = 30.0
USUAL_FRAMES = 72
"""Frames of usual beats in which the amplitude of a motion is looked up."""


@dataclass(frozen=True)
class Domain:
    """The square in the middle of the tissue in which errors are measured, divided into 2 x 2 sub-domains."""

    center_px: tuple[float, float]
    side_px: float = 90.0
    angle_deg: float = 0.0
    """Angle from the col axis to the tissue's axis, positive clockwise on the screen."""
    spacing_px: float = 4.0
    """Distance between the points of the dense grid, about."""

    @property
    def direction(self) -> Floats:
        """Unit vector (2,) along the tissue."""
        a = np.deg2rad(self.angle_deg)
        return np.array([np.sin(a), np.cos(a)])

    @property
    def points_px(self) -> Floats:
        """Dense grid (4, n, 2): the points of each sub-domain, row by row (A1, A2, B1, B2)."""
        half = self.side_px / 2
        n = max(4, round(half / self.spacing_px))
        line = (np.arange(n) + 0.5) / n * half
        tile = np.stack(np.meshgrid(line, line, indexing="ij"), axis=-1).reshape(-1, 2)
        level = np.stack([tile + corner for corner in half * np.array([[-1, -1], [-1, 0], [0, -1], [0, 0]])])
        along = self.direction
        across = np.array([along[1], -along[0]])
        return np.asarray(self.center_px + level[..., :1] * across + level[..., 1:] * along)


@dataclass(frozen=True)
class Picture:
    """A relaxed tissue and where its parts are."""

    image: Floats
    """(R, C), 0 black to 1 white."""
    tissue: Bools
    body: Bools
    """(R, C): everything that moves, pillars included."""
    pillars: tuple[Bools, ...]
    center_px: tuple[float, float]
    half_length_px: float
    """Distance from the centre to either pillar."""
    half_width_px: float
    angle_deg: float


class Scene(Protocol):
    """What a case shows, without its noise."""

    def prepare(self) -> None:
        """Compute what is slow and shared between cases, and keep it."""
        ...

    def picture(self) -> Picture:
        """The relaxed tissue."""
        ...

    def motion(self, picture: Picture) -> tuple[Motion, RigidMotion | None]:
        """Motion of the tissue, and that of the stage on top."""
        ...

    def domain(self, picture: Picture) -> Domain:
        """Where errors are measured."""
        ...

    @property
    def um_per_px(self) -> float: ...

    @property
    def rhythm(self) -> Rhythm | None: ...


@dataclass(frozen=True)
class Analytic:
    """A bundle that beats by a formula, with a given peak of the mean absolute displacement in the domain."""

    mad_px: float
    """Peak over time, at a beat of usual strength, of the mean absolute displacement in the domain; 0 is still."""
    seed: int
    shape: tuple[int, int] = (256, 448)
    """Rows and columns; a bundle of the size of the columns is painted, and rows are cut off above and below."""
    frames: int = 96
    angle_deg: float = 0.0
    side_px: float = 80.0
    inclusion: bool = False
    """A passive region in sub-domain B2 that is stretched while the rest shortens."""
    delay_frames: float = 2.0
    rise: float = 0.36
    active: float = 0.55
    first_beat: float = 0.3
    variation: float = 0.06
    """Standard deviation of the beats' strength; that of their length is half of it."""
    drift_px: tuple[float, float] = (0.0, 0.0)
    """Shift of the stage per frame."""
    turn_deg: float = 0.0
    """Turn of the stage over the whole movie."""

    @property
    def um_per_px(self) -> float:
        return UM_PER_PX

    @property
    def rhythm(self) -> Rhythm:
        """When it beats."""
        return Rhythm(self.frames, 24.0, first_beat=self.first_beat, active=self.active, rise=self.rise,
                      amplitude_variation=self.variation, period_variation=self.variation / 2, seed=self.seed)

    def prepare(self) -> None:
        """See `Scene.prepare`; nothing is slow here."""

    def picture(self) -> Picture:
        """See `Scene.picture`."""
        return painted(self.shape, self.seed, self.angle_deg)

    def domain(self, picture: Picture) -> Domain:
        """See `Scene.domain`."""
        return Domain(picture.center_px, self.side_px, self.angle_deg)

    def motion(self, picture: Picture) -> tuple[Motion, RigidMotion | None]:
        """See `Scene.motion`."""
        rhythm, domain = self.rhythm, self.domain(picture)
        passive = None
        if self.inclusion:
            middle = domain.points_px[3].mean(axis=0)
            passive = Inclusion((float(middle[0]), float(middle[1])), 0.17 * self.side_px)
        usual = replace(rhythm, count=USUAL_FRAMES, amplitude_variation=0.0)
        unit = TissueMotion(usual, picture.center_px, picture.half_length_px, picture.half_width_px, 1.0,
                            angle_deg=self.angle_deg, delay_frames=self.delay_frames, inclusion=passive)
        points = domain.points_px.reshape(-1, 2)
        top = max(float(np.hypot(*unit.displacement_px(points, t).T).mean()) for t in range(USUAL_FRAMES))
        stage = None
        if any(self.drift_px) or self.turn_deg:
            stage = RigidMotion.drift(self.frames, self.drift_px, np.deg2rad(self.turn_deg) / (self.frames - 1),
                                      picture.center_px)
        return replace(unit, rhythm=rhythm, peak_px=self.mad_px / top), stage


@dataclass(frozen=True)
class Elements:
    """A finite-element bundle after the paper: 200 frames, 8 beats of a clipped cosine with red noise."""

    seed: int
    """Of the texture and of the red noise."""
    passive: bool = False
    """A passive inclusion of 130 um in the middle (continuous rule), which makes the domain move less than a pixel."""
    fibres: Literal["length", "depth"] = "length"
    """Along which the fibre angle varies: the paper's X or Z."""
    frames: int = 200
    resolution: Literal["coarse", "medium", "fine"] = "coarse"
    shape: tuple[int, int] = (288, 512)

    @property
    def um_per_px(self) -> float:
        return UM_PER_PX

    @property
    def rhythm(self) -> None:
        return None

    def prepare(self) -> None:
        """See `Scene.prepare`."""
        self.solution()

    def picture(self) -> Picture:
        """See `Scene.picture`."""
        return painted(self.shape, self.seed)

    def domain(self, picture: Picture) -> Domain:
        """See `Scene.domain`."""
        return Domain(picture.center_px, 90.0)

    def motion(self, picture: Picture) -> tuple[Motion, None]:  # noqa: ARG002
        """See `Scene.motion`."""
        return self.solution().motion(self.activation, self.um_per_px), None

    @property
    def activation(self) -> Floats:
        """(T,): 25 frames a beat, with red noise."""
        return clipped_cosine(self.frames, self.frames / 25, seed=self.seed)

    def solution(self) -> TissueSolution:
        """Solve the bundle, or read the solution from the cache; one geometry serves all textures."""
        one = painted(self.shape, 1)
        inclusion = PassiveCore(radius_um=130.0) if self.passive else None
        fibres = Fibres(along=self.fibres)
        name = repr(("elements", self.shape, self.passive, self.fibres, self.resolution, self.um_per_px))
        return _kept(name, lambda: solve_tissue(
            Bundle.from_mask(one.tissue, self.um_per_px), fibres=fibres, inclusion=inclusion,
            resolution=self.resolution))


@dataclass(frozen=True)
class Sheet:
    """A thin, strongly aligned sheet between two plates on soft posts, after the paper's Type 2."""

    seed: int
    frames: int = 120
    shape: tuple[int, int] = (300, 560)

    @property
    def um_per_px(self) -> float:
        return 1.0

    @property
    def rhythm(self) -> None:
        return None

    def prepare(self) -> None:
        """See `Scene.prepare`."""
        self.solution()

    def picture(self) -> Picture:
        """See `Scene.picture`."""
        return _sheet_picture(self.shape, self.seed)

    def domain(self, picture: Picture) -> Domain:
        """See `Scene.domain`."""
        return Domain(picture.center_px, 56.0)

    def motion(self, picture: Picture) -> tuple[Motion, None]:  # noqa: ARG002
        """See `Scene.motion`."""
        return self.solution().motion(self.activation, self.um_per_px), None

    @property
    def activation(self) -> Floats:
        """(T,): 24 frames a beat, with red noise."""
        return clipped_cosine(self.frames, self.frames / 24, seed=self.seed)

    def solution(self) -> TissueSolution:
        """Solve the sheet, or read the solution from the cache."""
        return _kept(repr(("sheet",)), lambda: solve_membrane(fibrous_sheet(), fibres=ALIGNED, law=FIBROUS))


def painted(shape: tuple[int, int], seed: int, angle_deg: float = 0.0) -> Picture:
    """Paint a bundle as wide as the picture, and cut off the rows above and below that do not fit."""
    return cut_rows(procedural_tissue((shape[1], shape[1]), seed, angle_deg=angle_deg), shape[0])


def cut_rows(picture: TissuePicture, rows: int) -> Picture:
    """Keep the middle rows of a painted bundle."""
    first = (picture.image.shape[0] - rows) // 2
    keep = slice(first, first + rows)
    center = (picture.center_px[0] - first, picture.center_px[1])
    return Picture(picture.image[keep], picture.tissue[keep], picture.body[keep],
                   tuple(p[keep] for p in picture.pillars), center, picture.half_length_px, picture.half_width_px,
                   picture.angle_deg)


def _sheet_picture(shape: tuple[int, int], seed: int) -> Picture:
    """Paint the sheet: dark fibres along the columns on bright ground, and two plates that are darker still."""
    rng = np.random.default_rng(np.random.SeedSequence([seed, 22]))
    bundle = fibrous_sheet()
    pixels = np.stack(np.meshgrid(*map(np.arange, shape), indexing="ij"), axis=-1).reshape(-1, 2).astype(float)
    body = inside(pixels, bundle.outline_um).reshape(shape)
    plates = tuple(inside(pixels, p.polygon_um(10.0)).reshape(shape) for p in bundle.pillars)

    def grain(across: float, along: float) -> Floats:
        noise = ndimage.gaussian_filter(rng.standard_normal(shape), (across, along))
        return np.asarray(noise / noise.std())

    fibres = 0.45 + 0.05 * grain(0.9, 6.0) + 0.05 * grain(1.6, 14.0) + 0.03 * grain(1.0, 1.0) + 0.03 * grain(5, 9)
    ground = 0.85 + 0.01 * grain(2.0, 2.0) + 0.015 * grain(12, 12)
    edge = ndimage.gaussian_filter(body.astype(float), 1.2)
    image = ground + (fibres - ground) * edge
    for plate in plates:
        w = ndimage.gaussian_filter(plate.astype(float), 1.2)
        image = image * (1 - w) + (0.15 + 0.02 * grain(1.5, 1.5)) * w
    tissue = body & ~np.any(plates, axis=0)
    center = tuple(float(v) for v in np.mean([p.center_um for p in bundle.pillars], axis=0))
    return Picture(np.clip(image, 0.02, 0.98), tissue, body, plates, (center[0], center[1]), 200.0, 34.0, 0.0)


def band_px(motion: Motion, picture: Picture) -> float:
    """Width of the transition to still ground that a motion needs, so that the picture does not fold."""
    points = np.argwhere(picture.body)[::41].astype(float)
    frames = range(0, motion.count, max(1, motion.count // 60))
    most = max(float(np.hypot(*motion.displacement_px(points, t).T).max()) for t in frames)
    return max(20.0, 7.0 * most)


def tapered(motion: Motion, picture: Picture) -> Motion:
    """Let a motion act on the picture's body alone."""
    return Tapered(motion, picture.body, band_px(motion, picture))


def cache_folder() -> Path:
    """Folder for solutions that are slow to compute: MICROBUNDLE_CACHE, or the system's place for caches."""
    if chosen := os.environ.get("MICROBUNDLE_CACHE"):
        return Path(chosen)
    if sys.platform == "win32":
        return Path(os.environ.get("LOCALAPPDATA", Path.home() / "AppData" / "Local")) / "microbundle" / "Cache"
    if sys.platform == "darwin":
        return Path.home() / "Library" / "Caches" / "microbundle"
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "microbundle"


@lru_cache(maxsize=1)
def mechanics_fingerprint() -> str:
    """Hash of the programs that a solution depends on, so that an old one is not taken for a new one."""
    here = Path(__file__).parent
    names = ("activation", "elements", "equilibrium", "material", "membrane", "mesh", "outline", "solution", "surface",
             "texture", "tissue")
    return hashlib.sha256(b"".join((here / f"{n}.py").read_bytes() for n in names)).hexdigest()


_solved: dict[str, TissueSolution] = {}


def _kept(name: str, solve: object) -> TissueSolution:
    """Give a solution from memory, from the cache folder, or by solving; a cache that cannot be written is no error."""
    key = hashlib.sha256(f"{name} {mechanics_fingerprint()}".encode()).hexdigest()[:24]
    if key in _solved:
        return _solved[key]
    file = cache_folder() / "solutions" / f"{key}.npz"
    try:
        solution = TissueSolution.load(file)
    except ResultUnreadable:
        solution = solve()  # type: ignore[operator]
        try:
            file.parent.mkdir(parents=True, exist_ok=True)
            solution.save(file)
        except (OSError, OutputError):
            pass
    _solved[key] = solution
    return solution
