"""How near the registration comes to the smallest error that noise allows: the tables "Noise" of docs/benchmarks.md.

    python benchmarks/cramer_rao.py [REALISATIONS]

The Cramer-Rao bound is the smallest error that any unbiased method can have. Here the picture, its gradient and the
displacement are known exactly: g(X + u(X)) = f(X) with a painted texture f and a displacement u that the knots can
hold. With J the change of the moving picture's grey values with the knots' coefficients and the six brightness
parameters, and white noise of standard deviation s, the covariance of the coefficients is at least s^2 (J'J)^-1, and
that of the displacement follows from it. Where both pictures are noisy, s^2 is twice as large. Errors are root mean
squares of the vector's length, in px, over points at least one knot spacing inside the mask (nearer to the border
the bound is larger). The registration is not unbiased: its bending energy K, a mild demand for a smooth displacement,
lowers the spread below the bound and puts a bias in its place, which is listed apart (the mean error over all
realisations of the noise). `expected` is the spread that a perfect least-squares fit with this bending energy would
have, that of (J'J + K)^-1 J'J (J'J + K)^-1 s^2, so that `RMSE / expected` tells what the fixed gradient, the
interpolation and a noisy template lose.

The second table is the whole pipeline on a beating movie: by its pooling of frames the error falls below the bound
for one pair of pictures.
"""

from __future__ import annotations

import sys
from dataclasses import dataclass

import numpy as np
from scipy import ndimage, sparse

from microbundle import Config, analyze, bspline
from microbundle.bspline import Float32
from microbundle.data import Bools, Floats
from microbundle.lattice import BRIGHTNESS, Knots, Template
from microbundle.register import KNOT_LEAD_PX, Window
from microbundle.synth.cases import CLEAN_LARGE, Case
from microbundle.synth.noise import NoiseModel
from microbundle.synth.render import with_noise
from microbundle.synth.scenes import Analytic
from microbundle.synth.scores import compare, score
from microbundle.synth.texture import SplineTexture, band_limited, procedural_tissue

SIGMAS = (0.002, 0.005, 0.01, 0.02)
"""Standard deviation of the noise as a share of full scale."""
SPACING_PX = 12
SHAPE = (256, 448)
PEAK_PX = 0.8
ITERATIONS, TOLERANCE_PX = 40, 1e-5
SLOPE_STEP_PX = 0.01


@dataclass(frozen=True)
class Pair:
    """A relaxed picture and a displaced one, both without noise, and the exact displacement."""

    relaxed: Floats
    """(R, C), 0 black to 1 white."""
    moved: Floats
    """(R, C)"""
    knots: Knots
    p: Floats
    """Coefficients (2, K, L) of the displacement."""
    information: Floats
    """J'J (n + 6, n + 6) of the coefficients, component after component, and the brightness."""
    points: Floats
    """(P, 2): where errors are measured."""


def make_pair(seed: int) -> Pair:
    """Paint a tissue and displace it smoothly by up to PEAK_PX."""
    painted = procedural_tissue(SHAPE, seed)
    texture = band_limited(painted.image)
    mask = inner(painted.tissue)
    knots = Knots(mask, KNOT_LEAD_PX, SPACING_PX, reach=6)
    k, l = np.meshgrid(*(np.linspace(0, 1, n) for n in knots.shape[1:]), indexing="ij")
    p = PEAK_PX * np.stack([0.4 * np.sin(2 * np.pi * l + 1) * np.cos(np.pi * k), np.cos(np.pi * l) * np.cos(1.5 * k)])

    pixels = np.stack(np.meshgrid(*(np.arange(float(n)) for n in SHAPE), indexing="ij"), axis=-1).reshape(-1, 2)
    material = pixels.copy()  # X with X + u(X) = x
    for _ in range(30):
        material = pixels - displacement(knots, p, material)
    moved = texture.sample(material)
    inside = ndimage.map_coordinates(mask.astype(float), material.T, order=0) > 0.5
    seen = material[inside]
    gradient = np.einsum("pi,pij->pj", slope(texture, seen), np.linalg.inv(deformation(knots, p, seen)))
    J2 = information(knots, gradient, moved[inside], seen)
    return Pair(texture.sample(pixels).reshape(SHAPE), moved.reshape(SHAPE), knots, p, J2, well_inside(mask))


def inner(tissue: Bools) -> Bools:
    """Mask of the tissue without its border and with a margin to the picture's sides, for the knots and the motion."""
    mask = np.zeros_like(tissue)
    inside = slice(KNOT_LEAD_PX + 8, -KNOT_LEAD_PX - 8)
    mask[inside, inside] = ndimage.binary_erosion(tissue, iterations=4)[inside, inside]
    return mask


def well_inside(mask: Bools) -> Floats:
    """Points (P, 2) at least a knot spacing inside the mask, 3 px apart."""
    deep = np.argwhere(ndimage.distance_transform_edt(mask) >= SPACING_PX)
    return np.asarray(deep[(deep % 3 == 0).all(axis=1)], float)


def displacement(knots: Knots, p: Floats, points: Floats) -> Floats:
    """Displacement (P, 2) at points (P, 2)."""
    return np.asarray(knots.basis(points) @ p.reshape(2, -1).T)


def slope(texture: SplineTexture, points: Floats) -> Floats:
    """Gradient (P, 2) of a texture at points (P, 2)."""
    steps = SLOPE_STEP_PX * np.eye(2)
    return np.stack([texture.sample(points + step) - texture.sample(points - step) for step in steps],
                    axis=1) / (2 * SLOPE_STEP_PX)


def deformation(knots: Knots, p: Floats, points: Floats) -> Floats:
    """Deformation gradient (P, 2, 2) at points (P, 2)."""
    steps = SLOPE_STEP_PX * np.eye(2)
    change = [displacement(knots, p, points + step) - displacement(knots, p, points - step) for step in steps]
    return np.eye(2) + np.stack(change, axis=2) / (2 * SLOPE_STEP_PX)


def information(knots: Knots, gradient: Floats, grey: Floats, material: Floats) -> Floats:
    """J'J (n + 6, n + 6) of the knots' coefficients, component after component, and the brightness parameters.

    `gradient` (P, 2) and `grey` (P,) are those of the picture's pixels, `material` (P, 2) the relaxed points they show.
    """
    basis = knots.basis(material)
    lever = 2 * (material - material.mean(axis=0)) / np.ptp(material, axis=0)
    plane = np.column_stack([np.ones(len(material)), lever])
    bright = np.hstack([(grey - grey.mean())[:, None] * plane, plane])
    J = sparse.hstack([sparse.diags(gradient[:, 0]) @ basis, sparse.diags(gradient[:, 1]) @ basis, bright]).tocsr()
    return np.asarray((J.T @ J).toarray())


def bound(information: Floats) -> Floats:
    """Smallest covariance that an unbiased method can have, for noise of variance 1."""
    # A knot that the mask hardly touches is not determined, and no point well inside the mask depends on it.
    return np.asarray(np.linalg.pinv(information, rcond=1e-13, hermitian=True))


def expected(information: Floats, template: Template) -> Floats:
    """Covariance of the least-squares fit with the template's bending energy, for noise of variance 1."""
    knots = template.knots
    order = knots.flat(np.arange(knots.count).reshape(knots.shape))
    penalty = np.zeros_like(information)
    penalty[np.ix_(order, order)] = template.penalty.toarray()
    inverse = np.linalg.pinv(information + penalty, rcond=1e-13, hermitian=True)
    return np.asarray(inverse @ information @ inverse)


def rms_error(knots: Knots, covariance: Floats, points: Floats) -> float:
    """Root mean square length over points (P, 2) of the displacement's error, by the covariance of the coefficients."""
    basis = knots.basis(points)
    n = basis.shape[1]
    total = covariance[:n, :n] + covariance[n:2 * n, n:2 * n]
    return float(np.sqrt(np.asarray(basis.multiply(basis @ total).sum(axis=1)).mean()))


def errors(pair: Pair, sigma: float, both: bool, count: int) -> Floats:
    """Error (count, P, 2) of the registration for as many realisations of the noise."""
    true = displacement(pair.knots, pair.p, pair.points)
    out = np.empty((count, *true.shape))
    rng = np.random.default_rng(7)
    template = Template(pair.knots, spline(pair.relaxed))
    still, dark = np.zeros(pair.knots.shape, np.float32), np.zeros(BRIGHTNESS)
    for i in range(count):
        if both:
            template = Template(pair.knots, spline(pair.relaxed + sigma * rng.standard_normal(SHAPE)))
        moved = spline(pair.moved + sigma * rng.standard_normal(SHAPE))
        fit = template.fit([moved], [still], [dark], ITERATIONS, TOLERANCE_PX)[0]
        out[i] = displacement(pair.knots, fit.p.astype(float), pair.points) - true
    return out


def spline(picture: Floats) -> Float32:
    """Quintic B-spline coefficients of a picture."""
    out = np.array(picture, np.float32, order="C")
    bspline.prefilter(out)
    return out


def rms(vectors: Floats) -> float:
    """Root mean square length of vectors (..., 2)."""
    return float(np.sqrt((vectors**2).sum(axis=-1).mean()))


def print_pairs(count: int, textures: range) -> None:
    """Print the table of single pairs of pictures."""
    print("| noise s (% of full scale) | noisy pictures | bound | RMSE | RMSE / bound | RMSE / expected | bias |\n"
          + "|---" * 7 + "|")
    pairs = [make_pair(seed) for seed in textures]
    least = mean_square([rms_error(p.knots, bound(p.information), p.points) for p in pairs])
    usual = mean_square([rms_error(p.knots, expected(p.information, Template(p.knots, spline(p.relaxed))), p.points)
                         for p in pairs])
    print(f"| 0 | | | {mean_square([rms(errors(p, 0.0, False, 1)) for p in pairs]):.5f} | | | |")
    for sigma in SIGMAS:
        for both in (False, True):
            s = sigma * np.sqrt(1 + both)
            found = [errors(p, sigma, both, count) for p in pairs]
            total = mean_square([rms(e) for e in found])
            mean = mean_square([rms(e.mean(axis=0)) for e in found])
            spread = mean_square([rms(e - e.mean(axis=0)) for e in found])
            bias = np.sqrt(max(mean**2 - spread**2 / (count - 1), 0))  # a mean of noisy results is noisy too
            print(f"| {100 * sigma:g} | {'both' if both else 'one'} | {s * least:.5f} | {total:.5f} | "
                  f"{total / (s * least):.2f} | {total / (s * usual):.2f} | {bias:.5f} |", flush=True)


def mean_square(values: list[float]) -> float:
    """Root mean square."""
    return float(np.sqrt(np.mean(np.square(values))))


def pooled(sigma: float, seed: int) -> tuple[float, float, float]:
    """Bound for one pair of pictures, error of the analysis, and its error without noise, in the domain of a movie of
    100 frames."""
    scene = Analytic(0.8, seed, shape=SHAPE, frames=100)
    case = Case("pooled", CLEAN_LARGE, scene)
    clean = case.make()
    perfect = np.stack([clean.rendered.perfect(t) for t in range(clean.movie.count)])
    rmse = []
    for noise in (NoiseModel(read_noise=sigma, seed=seed), NoiseModel()):
        movie = with_noise(clean, noise).drawn(perfect)
        result = analyze(movie.movie, Config(method="accurate"))
        rmse.append(score(compare(movie, result, case.domain)).rmse_px)
    window = Window(result.masks.tissue, result.image)
    knots = Knots(window.mask, KNOT_LEAD_PX, SPACING_PX, reach=6)
    texture = clean.rendered.texture
    assert isinstance(texture, SplineTexture)
    places = np.argwhere(window.mask).astype(float)
    image = places + window.origin
    covariance = bound(information(knots, slope(texture, image), texture.sample(image), places))
    points = case.domain.points_px.reshape(-1, 2) - window.origin
    return sigma * rms_error(knots, covariance, points), rmse[0], rmse[1]


def print_pooled(textures: range) -> None:
    """Print the table of the whole pipeline."""
    print("| noise s (% of full scale) | bound for one pair | RMSE | RMSE / bound | RMSE without noise |"
          "\n" + "|---" * 5 + "|")
    for sigma in SIGMAS:
        least, noisy, clean = np.sqrt(np.mean(np.square([pooled(sigma, seed) for seed in textures]), axis=0))
        print(f"| {100 * sigma:g} | {least:.5f} | {noisy:.5f} | {noisy / least:.2f} | {clean:.5f} |", flush=True)


if __name__ == "__main__":
    print_pairs(int(sys.argv[1]) if len(sys.argv) > 1 else 40, range(71, 74))
    print()
    print_pooled(range(71, 74))
