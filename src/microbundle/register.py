"""Measure the displacement field: every frame is registered against one relaxed picture of the tissue.

1. Frames are cut to the tissue, normalised once for the movie, and kept in floating point.
2. Pass A, each frame from the relaxed reference frame: coarse to fine, as far as half resolution.
3. Where the residual is structured and it helps, frames are filtered to make their noise white.
4. The template is the mean of all frames pulled back to the reference.
5. Pass B registers every frame against the template; frames are independent, and run in parallel.
6. Only motion patterns that recur in time are kept.

Everything downstream samples the field. Only the coefficients grow with the number of frames.
"""

from __future__ import annotations

import os
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from typing import TypeVar

import cv2
import numpy as np
from scipy import ndimage

from . import bspline
from .bspline import Float32, Runs
from .config import Config
from .data import Bools, Finding, Floats, Image, Markers, Masks, Movie, Tracks
from .draws import SEED, Draws, draw_errors, join
from .errors import CannotMeasure
from .field import TEXTURE_CELL_PX, Field
from .lattice import BENDING, BRIGHTNESS, Fit, Knots, Template, finer
from .modes import FRAMES_AT_ONCE, find_modes
from .whiten import STRUCTURED, flatness, noise_spectrum, whitening_kernel

EDGE_PX = 4
"""Pixels this near to the mask's border do not count: the ground shines through there."""
LEAD_PX = 24
"""Margin around the tissue, for motion and for filters; a multiple of 8."""
KNOT_LEAD_PX = 16
"""Where the knots begin: TEMPLATE_MARGIN_PX and more before the tissue."""
LEVELS = (8, 4, 2, 1)
"""Reductions of the picture, coarse to fine."""
FEWEST_PIXELS = 150
"""A reduced picture with fewer pixels of tissue says nothing reliable."""
COARSE_BENDING = 0.1
COARSE_STEPS, COARSE_TOLERANCE_PX = 5, 3e-2
FINEST = 2
"""Reduction at which pass A ends: half resolution is right to 0.05 px already, which blurs no template."""
TEMPLATE_STEPS, TEMPLATE_TOLERANCE_PX = 6, 3e-3
"""Of pass B, for the knot that moves most; real movies are then 0.0001 px (root mean square) from where 60 steps lead,
after three steps."""
TEMPLATE_MARGIN_PX = 6
BATCH = 4
"""Frames that share one pass over the factorised matrix."""
SPECTRUM_FRAMES, TRIAL_FRAMES, TRIAL_SPACING_PX = 8, 24, 24
OUTLIER = 3.0
"""A frame whose residual is this many times the usual one shows something else."""
LOWEST_GAIN = 0.3
FEWEST_FOLLOWED = 0.3
GLARE_PERCENT = (0.5, 99.5)
"""Grey values beyond these percentiles of the tissue by more than their distance are cut off."""
WORTH = 0.8
"""Filtering is used where it lowers the displacement's noise to this share."""


Item = TypeVar("Item")
Result = TypeVar("Result")


class Window:
    """The part of the frames around the tissue, normalised: zero mean and unit standard deviation in the tissue."""

    def __init__(self, tissue: Bools, reference: Image, edge_px: int = EDGE_PX) -> None:
        data = ndimage.binary_erosion(tissue, iterations=edge_px)
        if not data.any():
            data = tissue
        rows, cols = np.flatnonzero(data.any(axis=1)), np.flatnonzero(data.any(axis=0))
        self.origin = np.array([rows[0] - LEAD_PX, cols[0] - LEAD_PX])
        size = np.array([rows[-1] + 1 - rows[0] + LEVELS[0], cols[-1] + 1 - cols[0]]) + 2 * LEAD_PX
        self.size = tuple(int(n) for n in -(-size // LEVELS[0]) * LEVELS[0])
        self.mask = self._cut(data, constant=True)
        self.kernel: Float32 | None = None
        self._nearest = self._ground(reference, tissue)
        inside = reference[data].astype(float)  # of which a few glaring pixels count for nothing
        low, high = np.percentile(inside, GLARE_PERCENT)
        self._limits = low - (high - low), high + (high - low)
        self._mean, self._sd = float(inside.mean()), max(float(inside.std()), 1e-12)

    def __call__(self, frame: Image) -> Float32:
        """Cut and normalise one frame."""
        picture: Image = self._cut(frame).astype(np.float32)
        if self._nearest is not None:
            picture = picture[self._nearest]
        np.clip(picture, *self._limits, out=picture)
        picture -= self._mean
        picture /= self._sd
        if self.kernel is not None:
            picture = np.asarray(cv2.filter2D(picture, cv2.CV_32F, self.kernel, borderType=cv2.BORDER_REFLECT))
        return np.asarray(picture, np.float32)

    def texture(self, template: Template) -> Floats:
        """Mean squared slope of the template in cells of 4 px inside the margin, NaN where there is no tissue."""
        energy = np.zeros(self.size, np.float32)
        energy[self.mask] = template.gr**2 + template.gc**2
        cells = [a[KNOT_LEAD_PX:, KNOT_LEAD_PX:] for a in (energy, self.mask.astype(np.float32))]
        total, share = (_reduced(np.ascontiguousarray(a), TEXTURE_CELL_PX) for a in cells)
        return np.divide(total, share, out=np.full(share.shape, np.nan, np.float32), where=share > 0.3)

    def _cut(self, frame: Image, constant: bool = False) -> Image:
        first = np.maximum(self.origin, 0)
        stop = np.minimum(self.origin + self.size, frame.shape)
        part = frame[first[0]:stop[0], first[1]:stop[1]]
        around = [(int(a), int(b)) for a, b in zip(first - self.origin, self.origin + self.size - stop, strict=True)]
        if not any(map(any, around)):
            return np.asarray(part)
        return np.pad(part, around) if constant else np.pad(part, around, mode="edge")

    def _ground(self, reference: Image, tissue: Bools) -> tuple[Image, ...] | None:
        """For padding of exact zeros: the nearest picture pixel of each, so that no edge rings into the tissue."""
        empty = self._cut((reference == 0) & ~tissue, constant=True)
        if empty.mean() < 0.02:
            return None
        empty = ndimage.binary_dilation(ndimage.binary_opening(empty, iterations=2), iterations=3)
        return tuple(ndimage.distance_transform_edt(empty, return_distances=False, return_indices=True))


def register(movie: Movie, masks: Masks, markers: Markers, config: Config, tell: Callable[[float], None]) -> Tracks:
    """Register every frame of a movie against its relaxed tissue, and sample the field at the markers.

    `tell` hears the share that is done. A frame that cannot be registered (a flash, another picture) is lost: its
    positions are NaN.
    """
    reference, params = markers.reference_frame, config.registration
    threads = params.threads or os.cpu_count() or 1
    window = Window(masks.tissue, movie.frames[reference])
    passes = _Passes(movie, window, reference, threads, params.knot_px)
    coefficients, bright, mean = passes.coarse_to_fine(lambda share: tell(0.5 * share))
    if params.whiten == "auto":
        spectrum = passes.residual_spectrum()
        if flatness(spectrum) < STRUCTURED and passes.worth_filtering(whitening_kernel(spectrum)):
            window.kernel = whitening_kernel(spectrum)
            passes = _Passes(movie, window, reference, threads, params.knot_px)
            coefficients, bright, mean = passes.coarse_to_fine(lambda share: tell(0.5 * share))
    template = passes.template(mean)
    coefficients, bright, residual = passes.against(template, coefficients, bright,
                                                    lambda share: tell(0.5 + 0.5 * share))
    good = followed(residual, bright)
    if good.mean() < FEWEST_FOLLOWED:
        raise CannotMeasure(f"{movie.name}: expected a tissue whose picture can be followed; only {good.mean():.0%} of "
                            "the frames could be followed. Is there tissue under the mask, and is it in focus?")
    draws, faintest = pool_frames(coefficients, good, template)
    field = Field(coefficients, window.origin + float(KNOT_LEAD_PX), float(params.knot_px),
                  window.texture(template), draws)
    position = field.at(markers.position_px) + markers.position_px.astype(np.float32)
    position[~good] = np.nan
    ok = np.broadcast_to(good[:, None], position.shape[:2]).copy()
    return Tracks(position, ok, "accurate", reference, params.knot_px, field=field, residual=residual,
                  faintest_px=faintest / template.contraction_size(masks.axis.direction), findings=_lost_findings(good))


def followed(residual: Floats, bright: Floats) -> Bools:
    """Tell which frames (T,) show the same tissue, by their residual (T,) and brightness (T, 6)."""
    gain = 1 + bright[:, 0]
    usual = float(np.median(residual))
    return np.asarray((residual < max(OUTLIER * usual, usual + 0.3)) & (gain > LOWEST_GAIN) & (gain < 1 / LOWEST_GAIN))


def pool_frames(coefficients: Float32, good: Bools, template: Template) -> tuple[Draws, float]:
    """Keep in place only the motion patterns that recur in time, draw what they may be wrong by, and tell the peak
    size, in the metric of the matrix, of the faintest beats that can be found. Frames that are not good take no
    part."""
    frames = np.flatnonzero(good)
    rng = np.random.default_rng(SEED)
    stretches, faintest = [], []
    for part in np.array_split(frames, -(-len(frames) // FRAMES_AT_ONCE)):
        unknowns = template.knots.flat(coefficients[part]).astype(float)
        modes = find_modes(unknowns, template.factor)
        stretches.append((part, draw_errors(unknowns, modes, template, rng)))
        faintest.append(modes.faintest)
        coefficients[part] = modes.project(coefficients[part])
    return join(stretches, len(good)), float(np.median(faintest))


def _lost_findings(good: Bools) -> tuple[Finding, ...]:
    lost = int((~good).sum())
    if lost == 0:
        return ()
    return (Finding("frames_lost", "review" if lost < 0.5 * len(good) else "fail",
                    f"{lost} frames do not show the tissue of the others (flash, focus, another picture) and were left "
                    "out", float(lost), 0.0),)


class _Passes:
    """The passes over a movie, with what they share."""

    def __init__(self, movie: Movie, window: Window, reference_frame: int, threads: int, spacing_px: int,
                 finest: int = FINEST) -> None:
        self.movie, self.window, self.reference, self.threads = movie, window, reference_frame, threads
        self.spacing = spacing_px
        first = window(movie.frames[reference_frame])
        pixels = window.mask.sum()
        self.reductions = [n for n in LEVELS if n >= finest and (n == 1 or pixels / n**2 >= FEWEST_PIXELS)] or [1]
        self.levels = [self._level(n, first) for n in self.reductions]
        self.knots = Knots(window.mask, KNOT_LEAD_PX, spacing_px, TEMPLATE_MARGIN_PX)
        self.around = Runs.of(ndimage.binary_dilation(window.mask, iterations=TEMPLATE_MARGIN_PX))

    def _level(self, reduction: int, first: Float32) -> Template:
        share = _reduced(self.window.mask.astype(np.float32), reduction)
        mask = share > 0.99 if (share > 0.99).any() else share > 0.5
        knots = Knots(mask, KNOT_LEAD_PX // reduction, self.spacing, TEMPLATE_MARGIN_PX)
        return Template(knots, _coefficients(_reduced(first, reduction)),
                        BENDING if reduction == 1 else COARSE_BENDING, even_light=reduction > 1)

    def coarse_to_fine(self, tell: Callable[[float], None] = lambda _: None,
                       frames: range | None = None) -> tuple[Float32, Floats, Float32]:
        """Pass A: coefficients (T, 2, K, L), brightness (T, 6), and the mean (P,) of the frames pulled back."""
        chosen = frames or range(self.movie.count)
        coefficients = np.empty((len(chosen), *self.knots.shape), np.float32)
        bright = np.empty((len(chosen), BRIGHTNESS))
        total: Floats = np.zeros(self.around.count)
        used = 0
        residual = np.empty(len(chosen))

        def one(item: tuple[int, Float32]) -> tuple[int, Fit, Float32]:
            t, picture = item
            fit = self._coarse_to_fine(picture)
            return t, fit, self._pulled_back(picture, fit)

        pictures = ((t, self.window(self.movie.frames[t])) for t in chosen)
        for done, (t, fit, relaxed) in enumerate(_in_order(one, pictures, self.threads), 1):
            coefficients[t - chosen.start], bright[t - chosen.start] = fit.p, fit.bright
            residual[done - 1] = fit.rms
            if followed(residual[:done], bright[:done])[-1]:  # judged by the frames so far
                total = total + relaxed
                used += 1
            tell(done / len(chosen))
        return coefficients, bright, (total / used).astype(np.float32)

    def _coarse_to_fine(self, picture: Float32) -> Fit:
        p: Float32 = np.zeros(self.levels[0].knots.shape, np.float32)
        bright: Floats = np.zeros(BRIGHTNESS)
        following = [*(level.knots.shape for level in self.levels[1:]), self.knots.shape]
        for level, reduction, shape in zip(self.levels, self.reductions, following, strict=True):
            part = _coefficients(_reduced(picture, reduction))
            fit = level.fit([part], [p], [bright], COARSE_STEPS, COARSE_TOLERANCE_PX)[0]
            p, bright = finer(fit.p, shape) if reduction > 1 else fit.p, fit.bright
        return Fit(p, bright, fit.rms, fit.iterations)

    def _pulled_back(self, picture: Float32, fit: Fit) -> Float32:
        """A frame's grey values at the displaced pixels around the tissue, with its brightness undone."""
        out = np.empty(self.around.count, np.float32)
        bspline.pull_back(_coefficients(picture), *self.around.arrays, self.knots.table, self.knots.lead, fit.p, out)
        mean, (gain, offset) = self.levels[-1].scale[0], fit.bright[[0, 3]].astype(np.float32)
        out -= mean + offset
        out /= max(1 + gain, LOWEST_GAIN)  # below, the frame takes no part
        out += mean
        return out

    def template(self, mean: Float32) -> Template:
        """The template of the mean relaxed picture, with the reference frame's ground around it."""
        picture = self.window(self.movie.frames[self.reference])
        row, col = self.around.pixels()
        picture[row, col] = mean
        return Template(self.knots, _coefficients(picture))

    def against(self, template: Template, coefficients: Float32, bright: Floats,
                tell: Callable[[float], None]) -> tuple[Float32, Floats, Floats]:
        """Pass B: coefficients (T, 2, K, L), brightness (T, 6) and residual (T,) of every frame."""
        rms = np.empty(self.movie.count)

        def some(item: tuple[int, list[Float32]]) -> tuple[int, list[Fit]]:
            first, pictures = item
            part = slice(first, first + len(pictures))
            return first, template.fit([_coefficients(p) for p in pictures], list(coefficients[part]),
                                       list(bright[part]), TEMPLATE_STEPS, TEMPLATE_TOLERANCE_PX)

        batches = ((first, [self.window(self.movie.frames[t])
                            for t in range(first, min(first + BATCH, self.movie.count))])
                   for first in range(0, self.movie.count, BATCH))
        for first, fits in _in_order(some, batches, self.threads):
            for t, fit in enumerate(fits, first):
                coefficients[t], bright[t], rms[t] = fit.p, fit.bright, fit.rms
            tell((first + len(fits)) / self.movie.count)
        return coefficients, bright, rms

    def residual_spectrum(self) -> Floats:
        """Spectrum of what few knots leave unexplained, over frames spread through the movie."""
        trial, pictures = self._trial(), []
        for t in np.unique(np.linspace(0, self.movie.count - 1, SPECTRUM_FRAMES).astype(int)):
            if t == self.reference:
                continue
            picture = self.window(self.movie.frames[int(t)])
            fit = trial._coarse_to_fine(picture)
            residual = np.zeros(self.window.size, np.float32)
            residual[self.window.mask] = trial.levels[-1].residual(_coefficients(picture), fit)
            pictures.append(residual)
        return noise_spectrum(pictures, self.window.mask)

    def _trial(self) -> _Passes:
        """The same at full resolution, with few knots."""
        return _Passes(self.movie, self.window, self.reference, self.threads, TRIAL_SPACING_PX, finest=1)

    def worth_filtering(self, kernel: Float32) -> bool:
        """Try a filter on some consecutive frames, with few knots: does it lower the displacement's own noise?"""
        first = max(0, min(self.reference, self.movie.count - TRIAL_FRAMES))
        frames = range(first, min(first + TRIAL_FRAMES, self.movie.count))
        noise = []
        for tried in (None, kernel):
            self.window.kernel = tried
            trial = self._trial()
            noise.append(_quiet_noise(trial, trial.coarse_to_fine(frames=frames)[0]))
        self.window.kernel = None
        return noise[1] < WORTH * noise[0]


def _in_order(work: Callable[[Item], Result], items: Iterable[Item], threads: int) -> Iterator[Result]:
    """Work on items in threads and give the results in order; items are made in this thread, few of them ahead."""
    if threads == 1:
        yield from map(work, items)
        return
    with ThreadPoolExecutor(threads) as pool:
        waiting: deque[Future[Result]] = deque()
        for item in items:
            waiting.append(pool.submit(work, item))
            if len(waiting) > threads:
                yield waiting.popleft().result()
        while waiting:
            yield waiting.popleft().result()


def _quiet_noise(trial: _Passes, coefficients: Float32) -> float:
    """Displacement noise in px, from second differences in time of the quietest frames."""
    row, col = np.nonzero(trial.window.mask)
    points = np.stack([row, col], axis=1)[::37].astype(float)
    basis = trial.knots.basis(points)
    flat = basis @ coefficients.reshape(2 * len(coefficients), -1).T
    moved = flat.reshape(len(points), len(coefficients), 2)
    second = moved[:, :-2] - 2 * moved[:, 1:-1] + moved[:, 2:]
    return float(np.percentile(np.sqrt((second**2).mean(axis=(0, 2)) / 6), 25))


def _reduced(picture: Float32, reduction: int) -> Float32:
    if reduction == 1:
        return picture
    size = (picture.shape[1] // reduction, picture.shape[0] // reduction)
    return np.asarray(cv2.resize(picture, size, interpolation=cv2.INTER_AREA), np.float32)


def _coefficients(picture: Float32) -> Float32:
    out = np.array(picture, np.float32, order="C")
    bspline.prefilter(out)
    return out
