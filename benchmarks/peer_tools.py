"""Ways to measure displacement, all asked the same question: how other programs are called by `peers.py`.

Each tool is a function of frames (T, R, C), the number of the relaxed reference frame, points (P, 2) of that frame in
the order (row, col), and the tissue's mask (R, C). It gives the displacement (T, P, 2) of these points from the
reference frame to every frame, in px. Other programs are called with the settings that their documentation names or
that they have by default; windows and meshes are chosen for this tissue, and `TOOLS` says which. A program that is not
installed raises ImportError.
"""

from __future__ import annotations

import contextlib
import io
import logging
import os
import tempfile
from collections.abc import Callable, Iterator

import cv2
import numpy as np
from scipy import ndimage
from scipy.interpolate import CloughTocher2DInterpolator, RectBivariateSpline, RegularGridInterpolator

from microbundle import Config, Movie, analyze
from microbundle.config import Method
from microbundle.data import Bools, Floats, Image

Tool = Callable[[Image, int, Floats, Bools], Floats]

GRID_PX, MARGIN_PX = 8, 8
"""Spacing of the points that pyidi follows, on whole pixels; a cubic spline through them gives the rest."""


def microbundle(method: Method) -> Tool:
    """One of this package's own methods."""
    def run(frames: Image, reference: int, points: Floats, tissue: Bools) -> Floats:
        config = Config.from_dict({"method": method, "tracking": {"reference_frame": reference},
                                   "registration": {"threads": 1}})
        return np.asarray(analyze(Movie.from_array(frames, fps=30, tissue_mask=tissue), config).displacement_at(points))
    return run


def eight_bits(frames: Image, tissue: Bools) -> Image:
    """The whole movie in 8 bits, scaled once by the tissue's grey values, for programs that take nothing else."""
    low, high = np.percentile(frames[:, tissue], (0.5, 99.5))
    return np.asarray(np.clip(np.rint((frames - low) / (high - low) * 255), 0, 255), np.uint8)


def lucas_kanade(frames: Image, reference: int, points: Floats, tissue: Bools) -> Floats:
    """OpenCV's pyramidal Lucas-Kanade at the points themselves."""
    grey = eight_bits(frames, tissue)
    start = points[:, None, ::-1].astype(np.float32)
    criteria = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 50, 0.001)
    ends = [cv2.calcOpticalFlowPyrLK(grey[reference], frame, start, None, winSize=(21, 21), maxLevel=3,
                                     criteria=criteria)[0] for frame in grey]
    return np.stack(ends)[:, :, 0, ::-1] - start[None, :, 0, ::-1]


def dense(flow: Callable[[Image, Image], Image]) -> Tool:
    """A flow (R, C, 2), x before y, between two frames of 8 bits, sampled at the points."""
    def run(frames: Image, reference: int, points: Floats, tissue: Bools) -> Floats:
        grey = eight_bits(frames, tissue)
        out = np.empty((len(frames), len(points), 2))
        for t, frame in enumerate(grey):
            field = flow(grey[reference], frame)
            for axis in (0, 1):
                out[t, :, axis] = ndimage.map_coordinates(field[..., 1 - axis], points.T, order=1)
        return out
    return run


def dis(first: Image, second: Image) -> Image:
    """OpenCV's dense inverse search, preset MEDIUM."""
    return np.asarray(cv2.DISOpticalFlow_create(cv2.DISOPTICAL_FLOW_PRESET_MEDIUM).calc(first, second, None))


def farneback(first: Image, second: Image) -> Image:
    """OpenCV's polynomial expansion, with the larger neighbourhoods that its documentation advises for noise."""
    return np.asarray(cv2.calcOpticalFlowFarneback(first, second, None, 0.5, 3, 31, 10, 7, 1.5,
                                                   cv2.OPTFLOW_FARNEBACK_GAUSSIAN))


def mps_motion(algorithm: str) -> Tool:
    """MPS-motion with its default settings."""
    def run(frames: Image, reference: int, points: Floats, tissue: Bools) -> Floats:
        from mps_motion.motion_tracking import OpticalFlow
        from mps_motion.utils import MPSData

        grey = np.moveaxis(eight_bits(frames, tissue), 0, 2)
        data = MPSData(grey, np.arange(len(frames), dtype=float), {"um_per_pixel": 1.0})
        with quiet():
            found = OpticalFlow(data, algorithm).get_displacements(unit="pixels", reference_image=grey[:, :, reference])
        field = np.asarray(found.array)  # (R, C, T, 2), x before y
        return np.stack([[ndimage.map_coordinates(field[:, :, t, 1 - axis], points.T, order=1) for axis in (0, 1)]
                         for t in range(len(frames))]).transpose(0, 2, 1)
    return run


def pyidi(name: str, side_px: int) -> Tool:
    """pyidi on a grid of whole pixels, from the reference frame, which is put before the movie."""
    def run(frames: Image, reference: int, points: Floats, _tissue: Bools) -> Floats:
        import pyidi

        rows, cols = around(points, GRID_PX, MARGIN_PX)
        grid = np.stack(np.meshgrid(rows, cols, indexing="ij"), axis=-1)
        movie = np.concatenate([frames[reference:reference + 1], frames])
        with quiet(), tempfile.TemporaryDirectory() as folder:
            method = getattr(pyidi, name)(pyidi.VideoReader(movie, root=folder))
            method.set_points(grid.reshape(-1, 2).astype(int))
            method.configure(roi_size=(side_px, side_px), verbose=0, show_pbar=False)
            moved = np.asarray(method.get_displacements(autosave=False))
        return from_grid(rows, cols, moved[:, 1:].transpose(1, 0, 2).reshape(len(frames), *grid.shape), points)
    return run


def openpiv(frames: Image, reference: int, points: Floats, _tissue: Bools) -> Floats:
    """OpenPIV's window deformation in three passes; only the later picture is deformed."""
    from openpiv.settings import PIVSettings
    from openpiv.windef import simple_multipass

    settings = PIVSettings()
    settings.windowsizes, settings.overlap, settings.num_iterations = (64, 32, 32), (32, 24, 24), 3
    settings.deformation_method = "second image"
    grey = frames.astype(np.float64)
    out = np.empty((len(frames), len(points), 2))
    for t, frame in enumerate(grey):
        with quiet():
            x, y, u, v, _ = simple_multipass(grey[reference], frame, settings)
        # Its y points up: rows are given from the largest y to the smallest, and v is positive upward.
        rows, cols = np.sort(y[:, 0]), x[0]
        moved = np.stack([-np.asarray(v), np.asarray(u)], axis=-1)
        out[t] = from_grid(rows, cols, moved[None], points)[0]
    return out


def mudic(kind: str, element_px: float) -> Tool:
    """muDIC on a mesh that reaches beyond the points; the reference picture is never updated."""
    def run(frames: Image, reference: int, points: Floats, _tissue: Bools) -> Floats:
        import muDIC

        low, high = points.min(axis=0) - MARGIN_PX, points.max(axis=0) + MARGIN_PX
        rows, cols = (max(2, round(float(side) / element_px)) for side in high - low)
        pictures = [frames[reference].astype(float), *frames.astype(float)]
        with quiet():
            stack = muDIC.image_stack_from_list(pictures)
            mesher = muDIC.Mesher(type="q4") if kind == "q4" else muDIC.Mesher(deg_e=3, deg_n=3, type="spline")
            mesh = mesher.mesh(stack, Xc1=float(low[1]), Xc2=float(high[1]), Yc1=float(low[0]), Yc2=float(high[0]),
                               n_elx=cols, n_ely=rows, GUI=False)
            task = muDIC.DICInput(mesh, stack, noconvergence="ignore", maxit=50, ref_update_frames=[])
            results = muDIC.DICAnalysis(task).run()
            if kind == "q4":
                x, y = results.xnodesT, results.ynodesT  # (nodes, T)
            else:
                place = muDIC.Fields(results, seed=60).coords()[0]
                x, y = place[0].reshape(-1, place.shape[-1]), place[1].reshape(-1, place.shape[-1])
        home = np.stack([y[:, 0], x[:, 0]], axis=1)
        moved = np.stack([y[:, 1:] - y[:, :1], x[:, 1:] - x[:, :1]], axis=-1)
        if kind == "q4":
            return in_elements(home, moved, points)
        return np.asarray(CloughTocher2DInterpolator(home, moved.reshape(len(home), -1))(points)).reshape(
            len(points), -1, 2).transpose(1, 0, 2)
    return run


def in_elements(nodes: Floats, moved: Floats, points: Floats) -> Floats:
    """Displacement (T, P, 2) at points from that of the nodes (N, T, 2) of a level mesh, linear in each element."""
    rows, cols = (np.unique(nodes[:, axis].round(6)) for axis in (0, 1))
    order = np.lexsort((nodes[:, 1].round(6), nodes[:, 0].round(6)))
    values = moved[order].reshape(len(rows), len(cols), -1)
    return RegularGridInterpolator((rows, cols), values)(points).reshape(len(points), -1, 2).transpose(1, 0, 2)


def around(points: Floats, spacing: int, margin: int) -> tuple[Floats, Floats]:
    """Rows and columns of whole pixels that cover the points and a margin."""
    low, high = np.floor(points.min(axis=0)) - margin, np.ceil(points.max(axis=0)) + margin
    return np.arange(low[0], high[0] + spacing, spacing), np.arange(low[1], high[1] + spacing, spacing)


def from_grid(rows: Floats, cols: Floats, moved: Floats, points: Floats) -> Floats:
    """Displacement (T, P, 2) at points by a cubic spline through that on a grid (T, K, L, 2)."""
    return np.stack([[RectBivariateSpline(rows, cols, frame[..., axis])(*points.T, grid=False) for axis in (0, 1)]
                     for frame in moved]).transpose(0, 2, 1)


@contextlib.contextmanager
def quiet() -> Iterator[None]:
    """Keep a program from printing, and let it leave its files in a folder that goes away."""
    logging.disable(logging.INFO)
    here = os.getcwd()
    with tempfile.TemporaryDirectory() as folder, contextlib.redirect_stdout(io.StringIO()):
        os.chdir(folder)
        try:
            yield
        finally:
            os.chdir(here)
            logging.disable(logging.NOTSET)


TOOLS: dict[str, Tool] = {
    "microbundle accurate": microbundle("accurate"),
    "microbundle fast": microbundle("fast"),
    "microbundle paper": microbundle("paper"),
    "OpenCV Lucas-Kanade, 21 px": lucas_kanade,
    "OpenCV DIS, medium": dense(dis),
    "OpenCV Farneback, 31 px": dense(farneback),
    "MPS-motion, Farneback": mps_motion("farneback"),
    "MPS-motion, TV-L1": mps_motion("dualtvl1"),
    "OpenPIV, 32 px": openpiv,
    "pyidi Lucas-Kanade, 21 px": pyidi("LucasKanade", 21),
    "pyidi DIC affine, 21 px": pyidi("DIC", 21),
    "pyidi DIC affine, 31 px": pyidi("DIC", 31),
    "muDIC cubic, 12 px": mudic("spline", 12.0),
    "muDIC Q4, 20 px": mudic("q4", 20.0),
}
