"""Choose the points of the tissue that are followed: Shi-Tomasi corners inside the mask.

Source: paper, "Sparse optical flow algorithm for tracking"; J. Shi and C. Tomasi, Good features to track, CVPR 1994.
The quality level and the spacing are tuned to the texture until there is one marker for every 40 pixels of tissue.
`paper` follows the published program step by step, also where its loops work against their purpose.
"""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np

from .config import Config, MarkerParams
from .data import Bools, Finding, Floats, Markers, Masks, Movie
from .errors import NoTexture
from .geometry import to_tissue
from .published import PaperFrame, paper_frame, without_border
from .scaling import Gray8, movie_scaling, stretch_each

MIN_MARKERS = 12
BLOCK_PX = 3
EDGE_PX = 3
"""Corners this close to the mask's border are the tissue's outline against the ground, not its texture."""
STRONG_QUANTILE = 0.98
LOWEST_QUALITY = 0.01
"""Lowest corner strength, as a share of the tissue's strong corners."""
SPACING = 0.6
"""Smallest distance between markers, as a share of the mean distance that the wanted coverage gives."""
QUALITY_STEP = 10 ** (-0.1)
QUALITY_ROUNDS = 15
LATTICE_POINTS = 600
"""Points at which a displacement field is sampled at least."""
TILE_PX = 20
SPARSE_SHARE = 0.25


def place_markers(movie: Movie, masks: Masks, reference_frame: int, config: Config) -> Markers:
    """Find markers inside the tissue mask on the reference frame.

    Raises NoTexture where fewer than 12 points can be told apart.
    """
    if config.method == "paper":
        markers = _paper_markers(movie, masks.tissue, config)
    else:
        markers = _even_markers(movie, masks.tissue, reference_frame, config)
    if config.method == "accurate" and len(markers) >= MIN_MARKERS:
        markers = replace(markers, position_px=_lattice(masks.tissue, config.markers))
    if len(markers) < MIN_MARKERS:
        raise NoTexture(f"{movie.name}: expected at least {MIN_MARKERS} points that can be followed in the tissue; "
                        f"found {len(markers)}. Is the movie in focus, and does the mask lie on the tissue?")
    return markers


def _even_markers(movie: Movie, tissue: Bools, reference_frame: int, config: Config) -> Markers:
    """Corners above a quality that is relative to the tissue's strong corners, not to the single strongest."""
    params = config.markers
    scaling = movie_scaling(movie, tissue)
    image = scaling(movie.frames[reference_frame])
    brush = np.ones((2 * EDGE_PX + 1,) * 2, np.uint8)
    inside = np.asarray(cv2.erode(scaling.tissue.astype(np.uint8), brush), np.uint8)
    corner = cv2.cornerMinEigenVal(image, BLOCK_PX)[inside > 0]
    if corner.size == 0 or corner.max() <= 0:
        raise NoTexture(f"{movie.name}: expected texture in the tissue; found {corner.size} pixels without any. "
                        "Is the movie in focus, and does the mask lie on the tissue?")
    # OpenCV takes the strongest corners first, so one call at the lowest acceptable quality does what the paper's
    # loop over falling qualities does.
    quality = LOWEST_QUALITY * float(np.quantile(corner[corner > 0], STRONG_QUANTILE) / corner.max())
    wanted = min(params.max_count, max(MIN_MARKERS, int(np.ceil(tissue.sum() / params.coverage_px))))
    spacing = max(2.0, SPACING * np.sqrt(params.coverage_px))
    found = _corners(image, inside, quality, spacing, wanted)
    findings = _sparse_findings(found, scaling.tissue)
    return Markers(found + scaling.origin, reference_frame, quality, spacing,
                   float(tissue.sum()) / max(len(found), 1), findings)


def _lattice(tissue: Bools, params: MarkerParams) -> Floats:
    """Points of a square lattice in the tissue, where a displacement field is sampled evenly."""
    area = float(tissue.sum())
    spacing = np.sqrt(max(min(params.coverage_px, area / LATTICE_POINTS), area / params.max_count))
    rows, cols = np.flatnonzero(tissue.any(axis=1)), np.flatnonzero(tissue.any(axis=0))
    lines = [np.arange(a[0] + 0.5 * spacing, a[-1] + 1, spacing) for a in (rows, cols)]
    points = np.stack(np.meshgrid(*lines, indexing="ij"), axis=-1).reshape(-1, 2)
    near = np.minimum(np.rint(points).astype(int), np.array(tissue.shape) - 1)
    return np.asarray(points[tissue[tuple(near.T)]])


def _paper_markers(movie: Movie, tissue: Bools, config: Config) -> Markers:
    """The published program's two nested loops: quality in the inner, spacing in the outer."""
    image = stretch_each(movie.frames[0])
    inside = without_border(tissue).astype(np.uint8)
    pixels, quality, spacing = int(inside.sum()), 0.1, 3
    frame = paper_frame(tissue)

    def lowered(quality: float, found: Floats) -> tuple[float, Floats]:
        for _ in range(QUALITY_ROUNDS):
            if pixels / max(len(found), 1) <= config.markers.coverage_px:
                break
            quality *= QUALITY_STEP
            found = _corners(image, inside, quality, spacing, config.markers.max_count)
        return quality, found

    quality, found = lowered(quality, _corners(image, inside, quality, spacing, config.markers.max_count))
    for _ in range(2):
        local = _paper_local_coverage(frame, found)
        if len(local) < 3 or np.sort(local)[-3] < 50:
            break
        spacing += 1
        quality, found = lowered(quality, _corners(image, inside, quality, spacing, config.markers.max_count))
    return Markers(found, 0, quality, float(spacing), pixels / max(len(found), 1))


def _corners(image: Gray8, inside: Gray8, quality: float, spacing: float, count: int) -> Floats:
    found = cv2.goodFeaturesToTrack(image, count, quality, spacing, mask=inside, blockSize=BLOCK_PX)
    return np.empty((0, 2)) if found is None else found.reshape(-1, 2)[:, ::-1].astype(float)


def tile_counts(tissue: Bools, points_px: Floats, box: tuple[int, int, int, int],
                side: int = TILE_PX) -> tuple[Floats, Floats]:
    """Count tissue pixels and points in square tiles of a box (first row, end row, first column, end column).

    Remainders that fill no whole tile are left out. Points on a tile's edge belong to none, as in the published tool.
    Returns two arrays (tile rows, tile columns).
    """
    r0, r1, c0, c1 = box
    rows, cols = (r1 - r0) // side, (c1 - c0) // side
    if rows < 1 or cols < 1:
        return np.zeros((0, 0)), np.zeros((0, 0))
    part = tissue[r0:r0 + rows * side, c0:c0 + cols * side]
    pixels = part.reshape(rows, side, cols, side).sum(axis=(1, 3))
    place = (points_px - (r0, c0)) / side
    index = np.floor(place).astype(int)
    inner = (place > index).all(axis=1) & (index >= 0).all(axis=1) & (index < (rows, cols)).all(axis=1)
    points = np.zeros((rows, cols))
    np.add.at(points, tuple(index[inner].T), 1)
    return pixels.astype(float), points


def _paper_local_coverage(frame: PaperFrame, points: Floats) -> Floats:
    """Tissue pixels per marker of each tile with tissue; a tile without markers counts as 0, as published."""
    rows, cols = np.flatnonzero(frame.level.any(axis=1)), np.flatnonzero(frame.level.any(axis=0))
    r0, r1, c0, c1 = int(rows[0]), int(rows[-1]), int(cols[0]), int(cols[-1])
    dr, dc = int(0.15 * (r1 - r0)), int(0.15 * (c1 - c0))
    turned = to_tissue(points, frame.center, frame.direction)
    pixels, counts = tile_counts(frame.level, turned, (r0 + dr, r1 - dr, c0 + dc, c1 - dc))
    coverage = np.divide(pixels, counts, out=np.zeros(pixels.shape), where=counts > 0)
    return np.asarray(coverage[pixels > 0])


def _sparse_findings(points: Floats, tissue: Bools) -> tuple[Finding, ...]:
    """Say where much of the tissue has nothing to follow."""
    pixels, counts = tile_counts(tissue, points, (0, tissue.shape[0], 0, tissue.shape[1]))
    full = pixels > 0.8 * TILE_PX**2
    if not full.any():
        return ()
    empty = float((counts[full] == 0).mean())
    if empty <= SPARSE_SHARE:
        return ()
    return (Finding("texture_sparse", "review",
                    f"{empty:.0%} of the tissue shows nothing that can be followed; strain there rests on few markers",
                    empty, SPARSE_SHARE),)
