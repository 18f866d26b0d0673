"""Draw the frames of a movie of a result: the tissue, its displacement or strain in colours, and what stands around it.

All that stays the same (title, colour bar, scale bar, axes and trace) is drawn once, with the trace faint and with the
trace dark. A frame is then a copy in which the picture, the time, and the part of the trace that has been played are
put in place, so that it costs milliseconds, and memory holds one frame.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

import cv2
import numpy as np
from numpy.typing import NDArray

from .data import Floats, Image, Movie
from .geometry import rotation, to_image, to_tissue
from .motion import Motion
from .shown import MARGIN, Shown
from .style import (
    DIVERGING,
    FAINT,
    INK,
    MOVIE_OVERLAY,
    PEAK,
    SEQUENTIAL,
    colour_map,
    limits_of,
    nice_ticks,
    plain,
    round_size,
    settings,
)

if TYPE_CHECKING:
    from matplotlib.backends.backend_agg import FigureCanvasAgg

Rgb = NDArray[np.uint8]
Show = Literal["displacement", "strain"]

CELL = 4
"""Pixels of the picture between two points of the lattice on which displacement is computed."""
EDGE, HEAD, FOOT, BAR, TRACE, BELOW, LEFT = 12, 30, 26, 74, 84, 42, 44
"""Room in px: at the sides, for the title, the scale bar, the colour bar, the trace, its time axis, and its numbers."""
NARROWEST = 400
DPI = 100
SAMPLED = 8
SUBPIXEL = 4
"""Binary digits after the point in OpenCV's drawing."""
DIGITS = "0123456789.- "
PITCH, NARROW, TALL = 8, 5, 16
"""Widths in px that a digit and a point of the time take, and their height."""


@dataclass(frozen=True)
class Window:
    """The part of the image that the movie shows, and how it is turned and enlarged."""

    origin_px: Floats
    """Image position (2,) of the picture's first pixel."""
    turn: Floats
    """(2, 2): image step of a picture step of one row (first column of the matrix) and one column."""
    shape: tuple[int, int]
    """Rows and columns of the picture, multiples of the lattice's cell."""

    def image_points(self, points: Floats) -> Floats:
        """Image positions (..., 2) of picture positions (..., 2)."""
        return np.asarray(points @ self.turn.T + self.origin_px)

    def picture_points(self, points_px: Floats) -> Floats:
        """Picture positions (..., 2) of image positions (..., 2)."""
        return np.asarray((points_px - self.origin_px) @ np.linalg.inv(self.turn).T)

    @property
    def step(self) -> float:
        """Pixels of the image in one of the picture."""
        return float(np.sqrt(abs(np.linalg.det(self.turn))))

    def cut(self, frame: Image, *, outside: float | None = None) -> Floats:
        """Cut the picture (R, C), float32, out of a frame; beyond the frame it is `outside`, or goes on as at its edge.
        """
        shrink = max(int(self.step), 1)
        if frame.dtype not in (np.uint8, np.uint16, np.float32):
            frame = frame.astype(np.float32)
        if shrink > 1:
            frame = cv2.resize(frame, (frame.shape[1] // shrink, frame.shape[0] // shrink),
                               interpolation=cv2.INTER_AREA)
        matrix = np.zeros((2, 3))
        matrix[:, :2] = self.turn[::-1, ::-1] / shrink
        matrix[:, 2] = (self.origin_px[::-1] + 0.5) / shrink - 0.5
        return np.asarray(cv2.warpAffine(frame, matrix, (self.shape[1], self.shape[0]), borderValue=outside or 0,
                                         borderMode=cv2.BORDER_REPLICATE if outside is None else cv2.BORDER_CONSTANT,
                                         flags=cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP), np.float32)


def window(shown: Shown, longest: int, *, level: bool) -> Window:
    """Show the tissue and its pillars with a margin, `longest` px long; `level` turns the tissue level."""
    analysis = shown.analysis
    if level:
        seen = analysis.masks.tissue.copy()
        for mask in () if analysis.pillars is None else analysis.pillars.pillars.masks:
            seen |= mask
        axis = analysis.masks.axis
        points = to_tissue(np.argwhere(seen).astype(float), axis.center_px, axis.direction)
        room = MARGIN * float(np.ptp(points, axis=0).max()) + 1
        low, high = points.min(axis=0) - room, points.max(axis=0) + room + 1
    else:
        r0, r1, c0, c1 = shown.box
        low, high = np.array([r0, c0], float), np.array([r1, c1], float)
    step = float((high - low).max()) / longest
    rows, cols = (max(int((b - a) / step) // CELL * CELL, 4 * CELL) for a, b in zip(low, high, strict=True))
    turn = np.eye(2) * step
    if level:
        corners = to_image(low + step * np.array([[0.0, 0], [1, 0], [0, 1]]), axis.center_px, axis.direction)
        return Window(corners[0], (corners[1:] - corners[0]).T, (rows, cols))
    return Window(low, turn, (rows, cols))


class Painter:
    """Draws one frame after the other: `painter(t, frame)` is the picture (rows, cols, 3) of frame t."""

    def __init__(self, movie: Movie, shown: Shown, show: Show, view: Window,
                 limits: tuple[float, float] | None) -> None:
        self.shown, self.view = shown, view
        self._colour = colouring(shown, show, view)
        self.limits = limits or self._colour.limits()
        self._outside = view.cut(np.ones(movie.shape, np.float32), outside=0.0) < 0.5
        name = SEQUENTIAL if show == "displacement" else DIVERGING
        self._table = (255 * colour_map(name)(np.linspace(0, 1, 256))[:, :3]).round().astype(np.uint8)
        sample = np.unique(np.linspace(0, movie.count - 1, SAMPLED).astype(int))
        grey = np.median([np.percentile(view.cut(movie.frames[int(t)])[~self._outside], [0.5, 99.5])
                          for t in sample], axis=0)
        self._black, self._white = float(grey[0]), max(float(grey[1]), float(grey[0]) + 1e-6)
        label = (f"Displacement ({shown.length_unit})" if show == "displacement" else "Strain $E_{cc}$ (%)")
        self.frame = Frame(shown, view, name, self.limits, label)

    def __call__(self, t: int, frame: Image) -> Rgb:
        grey = self.view.cut(frame)
        grey = np.clip((grey - self._black) * (255 / (self._white - self._black)), 0, 255).astype(np.uint8)
        picture = cv2.cvtColor(grey, cv2.COLOR_GRAY2RGB)
        picture = self._colour.over(picture, t, self._table, self.limits)
        picture[self._outside] = 255
        return self.frame.filled(t, picture)


def colouring(shown: Shown, show: Show, view: Window) -> _Displacement | _Tiles:
    """Make what lays the colours of displacement or strain over the pictures of a window."""
    return _Displacement(shown, view) if show == "displacement" else _Tiles(shown, view)


class _Displacement:
    """Colours the tissue by how far it has moved, where it is in each frame."""

    def __init__(self, shown: Shown, view: Window) -> None:
        self._shown, self._view = shown, view
        rows, cols = view.shape
        row, col = ((np.arange(n // CELL) + 0.5) * CELL - 0.5 for n in (rows, cols))
        self._place = np.stack(np.meshgrid(row, col, indexing="ij"), axis=-1).astype(np.float32)
        points = view.image_points(self._place.astype(float)).reshape(-1, 2)
        self._motion = Motion(shown.analysis, points)
        self._inside = shown.analysis.inside(points)
        self._to_picture = np.linalg.inv(view.turn).T.astype(np.float32)
        self._tissue = np.clip(view.cut(cv2.GaussianBlur(shown.analysis.masks.tissue.astype(np.float32), (0, 0), 1.0)
                                        ) * 2 - 0.5, 0, 1)

    def limits(self) -> tuple[float, float]:
        """From 0 to the largest displacement in the frames in which the tissue is contracted most."""
        beats = self._shown.analysis.beats
        frames = beats.peak if len(beats) else np.argsort(np.nan_to_num(beats.signal_px))[-SAMPLED:]
        frames = frames[np.unique(np.linspace(0, len(frames) - 1, 3 * SAMPLED).astype(int))]
        sizes = [np.hypot(*self._motion.at(int(t))[self._inside].T) * self._shown.px for t in frames]
        return limits_of(np.percentile(np.stack(sizes), 99.8, axis=1), symmetric=False)

    def over(self, picture: Rgb, t: int, table: Rgb, limits: tuple[float, float]) -> Rgb:
        """Lay the colours over a picture."""
        rows, cols = self._view.shape
        moved = np.asarray(self._motion.at(t), np.float32)
        size = np.hypot(moved[:, 0], moved[:, 1]).reshape(self._place.shape[:2]) * np.float32(self._shown.px)
        shift = (moved @ self._to_picture).reshape(self._place.shape)
        # The tissue that is at x now rests at X = x - u(X).
        home = self._place - shift
        for _ in range(2):
            home = self._place - _sampled(shift, home)
        value = cv2.resize(_sampled(size, home), (cols, rows), interpolation=cv2.INTER_LINEAR)
        fine = np.asarray(cv2.resize(home, (cols, rows), interpolation=cv2.INTER_LINEAR), np.float32)
        _extended(fine)
        cover = cv2.remap(self._tissue, fine[..., 1], fine[..., 0], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
        np.nan_to_num(value, copy=False)
        shade = np.clip((value - limits[0]) * (255 / (limits[1] - limits[0])), 0, 255).round().astype(np.uint8)
        cover = np.nan_to_num(cover) * np.float32(MOVIE_OVERLAY)
        return np.asarray(cv2.blendLinear(picture, table[shade], 1 - cover, cover), np.uint8)


def _extended(fine: Floats) -> None:
    """Beyond the outermost points of the lattice `resize` repeats the last place: go on with the picture's step."""
    half = (CELL - 1) / 2
    for axis in (0, 1):
        ends = fine.swapaxes(0, axis)
        for k in range(CELL // 2):
            ends[k, :, axis] -= half - k
            ends[-1 - k, :, axis] += half - k


def _sampled(values: Floats, place: Floats) -> Floats:
    """Values of the lattice at places of the picture."""
    at = ((place + np.float32(0.5)) / np.float32(CELL) - np.float32(0.5)).astype(np.float32)
    return np.asarray(cv2.remap(values, at[..., 1], at[..., 0], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE))


class _Tiles:
    """Colours the sub-domains by E_cc, and draws them where they are and as they are deformed in each frame."""

    def __init__(self, shown: Shown, view: Window) -> None:
        strain = shown.analysis.strain
        assert strain is not None
        self._view, self._strain = view, strain
        angle = np.deg2rad(strain.angle_deg)
        self._turn = rotation(np.array([np.sin(angle), np.cos(angle)]))
        middle = strain.corner_px.mean(axis=1)
        self._half = (strain.corner_px - middle[:, None]) @ self._turn.T

    def limits(self) -> tuple[float, float]:
        """Symmetric ones that hold E_cc in all frames."""
        return limits_of(100 * self._strain.E[..., 1, 1].ravel(), symmetric=True)

    def over(self, picture: Rgb, t: int, table: Rgb, limits: tuple[float, float]) -> Rgb:
        """Lay the sub-domains over a picture."""
        F = self._strain.F[t]
        known = np.isfinite(F).all(axis=(1, 2)) & np.isfinite(self._strain.center_px[t]).all(axis=1)
        E_cc = 50 * (F[:, 0, 1] ** 2 + F[:, 1, 1] ** 2 - 1)
        shade = (np.nan_to_num(E_cc) - limits[0]) * (255 / (limits[1] - limits[0]))
        moved = np.einsum("sij,skj->ski", F, self._half) @ self._turn + self._strain.center_px[t][:, None]
        corners = np.where(known[:, None, None], moved, self._strain.corner_px)
        drawn = np.rint(self._view.picture_points(corners)[..., ::-1] * 2**SUBPIXEL).astype(np.int32)
        cover, colour = np.zeros(picture.shape[:2], np.uint8), np.zeros_like(picture)
        for s in np.flatnonzero(known):
            tint = [int(c) for c in table[int(np.clip(round(float(shade[s])), 0, 255))]]
            cv2.fillConvexPoly(cover, drawn[s], 255, cv2.LINE_AA, SUBPIXEL)
            cv2.fillConvexPoly(colour, drawn[s], tint, cv2.LINE_8, SUBPIXEL)
        weight = cover.astype(np.float32) * np.float32(MOVIE_OVERLAY / 255)
        out = cv2.blendLinear(picture, colour, 1 - weight, weight)
        cv2.polylines(out, list(drawn), True, (255, 255, 255), 1, cv2.LINE_AA, SUBPIXEL)
        return np.asarray(out, np.uint8)


class Frame:
    """What stands around the picture: title, colour bar, scale bar, time, and the trace below."""

    def __init__(self, shown: Shown, view: Window, colours: str, limits: tuple[float, float], label: str) -> None:
        self._shown = shown
        rows, cols = view.shape
        width = max(EDGE + cols + BAR, NARROWEST)
        height = HEAD + rows + FOOT + TRACE + BELOW
        self.shape = height + height % 2, width + width % 2
        self._picture = slice(HEAD, HEAD + rows), slice(EDGE, EDGE + cols)
        self._line = slice(HEAD + rows + FOOT, HEAD + rows + FOOT + TRACE), slice(LEFT, self.shape[1] - EDGE)
        with settings():
            self._faint, self._dot = self._drawn(view, colours, limits, label, FAINT)
            self._dark, _ = self._drawn(view, colours, limits, label, INK)
            self._digits = _digits()
        step = float(np.median(np.diff(shown.time))) if len(shown.time) > 1 else 1.0
        self._decimals = 0 if shown.time_unit != "s" else int(np.clip(np.ceil(-np.log10(step)), 1, 4))

    def filled(self, t: int, picture: Rgb) -> Rgb:
        """Put the picture of frame t in place (rows, cols, 3)."""
        out = self._faint.copy()
        out[self._picture] = picture
        col, row = self._dot[t]
        rows, cols = self._line
        here = slice(cols.start, max(round(float(col)), cols.start))
        out[rows, here] = self._dark[rows, here]
        if np.isfinite(row):
            at = (round(float(col) * 2**SUBPIXEL), round(float(row) * 2**SUBPIXEL))
            cv2.circle(out, at, 4 * 2**SUBPIXEL, _rgb(PEAK), -1, cv2.LINE_AA, SUBPIXEL)
        text = f"{self._shown.time[t]:.{self._decimals}f}"
        right = self._picture[1].stop - (14 if self._shown.time_unit == "s" else 0)
        for digit in reversed(text):
            drawn = self._digits[digit]
            right -= drawn.shape[1]
            out[8:8 + TALL, right:right + drawn.shape[1]] = drawn
        return out

    def _drawn(self, view: Window, colours: str, limits: tuple[float, float], label: str,
               ink: str) -> tuple[Rgb, Floats]:
        """All that stands still, with the trace in one colour, and where its dot is in each frame (T, 2): col, row."""
        from matplotlib.backends.backend_agg import FigureCanvasAgg
        from matplotlib.cm import ScalarMappable
        from matplotlib.colors import Normalize
        from matplotlib.figure import Figure

        (height, width), (rows, cols), shown = self.shape, view.shape, self._shown
        figure = Figure(figsize=(width / DPI, height / DPI), dpi=DPI, facecolor="white")
        canvas = FigureCanvasAgg(figure)

        def axes(left: float, top: float, wide: float, high: float):  # type: ignore[no-untyped-def]
            return figure.add_axes((left / width, 1 - (top + high) / height, wide / width, high / height))

        def text(left: float, top: float, words: str, **style: object) -> None:
            figure.text(left / width, 1 - top / height, words, va="center", fontsize=8, **style)  # type: ignore[arg-type]

        text(EDGE, 16, label)
        if shown.time_unit == "s":
            text(EDGE + cols - 12, 16, "s")
        else:
            text(EDGE + cols - len(str(len(shown.time))) * PITCH - 6, 16, "frame", ha="right")
        bar = figure.colorbar(ScalarMappable(Normalize(*limits), colour_map(colours)),
                              cax=axes(EDGE + cols + 10, HEAD, 12, rows))
        bar.ax.tick_params(labelsize=7.5, width=0.6, length=2.5, pad=2)
        bar.outline.set_linewidth(0.5)
        bar.locator = nice_ticks(5)
        bar.update_ticks()
        size = round_size(0.25 * cols * view.step * shown.px)
        long, low = size / (view.step * shown.px), HEAD + rows + 10
        scale = axes(EDGE, low - 2, long, 4)
        scale.set_axis_off()
        scale.axhspan(0, 1, color=INK)
        scale.set_xlim(0, 1)
        scale.set_ylim(0, 1)
        text(EDGE + long + 6, low, f"{size:g} {shown.length_unit}")
        line_rows, line_cols = self._line
        line = plain(axes(line_cols.start, line_rows.start, line_cols.stop - line_cols.start, TRACE))
        line.plot(shown.time, shown.signal, color=ink, lw=1.1)
        line.set_xlim(shown.time[0], shown.time[-1])
        known = shown.signal[np.isfinite(shown.signal)]
        line.set_ylim(min(0.0, float(known.min(initial=0))), 1.12 * max(float(known.max(initial=0)), 1e-9))
        line.set_ylabel(f"Mean ({shown.length_unit})", fontsize=8)
        line.set_xlabel("Time (s)" if shown.time_unit == "s" else "Frame", fontsize=8)
        line.tick_params(labelsize=7.5)
        line.yaxis.set_major_locator(nice_ticks(3))
        line.yaxis.set_label_coords(-(LEFT - 18) / (line_cols.stop - line_cols.start), 0.5)
        canvas.draw()  # type: ignore[no-untyped-call]
        dots = line.transData.transform(np.stack([shown.time, shown.signal], axis=1))
        dots[:, 1] = height - dots[:, 1]
        return _pixels(canvas), dots - 0.5


def _digits() -> dict[str, Rgb]:
    """Pictures of the digits, all as wide and as high as each other, and of the point."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(PITCH * len(DIGITS) / DPI, TALL / DPI), dpi=DPI, facecolor="white")
    canvas = FigureCanvasAgg(figure)
    for k, digit in enumerate(DIGITS):
        figure.text((k + 0.5) / len(DIGITS), 0.5, digit.replace("-", "−"), ha="center", va="center_baseline",
                    fontsize=8.5, color=INK)
    canvas.draw()  # type: ignore[no-untyped-call]
    every = _pixels(canvas)
    wide = {digit: NARROW if digit == "." else PITCH for digit in DIGITS}
    middle = [int((k + 0.5) * PITCH) for k in range(len(DIGITS))]
    return {digit: every[:, m - wide[digit] // 2:m - wide[digit] // 2 + wide[digit]].copy()
            for m, digit in zip(middle, DIGITS, strict=True)}


def _pixels(canvas: FigureCanvasAgg) -> Rgb:
    return np.asarray(canvas.buffer_rgba())[..., :3].copy()  # type: ignore[no-untyped-call]


def _rgb(colour: str) -> tuple[int, int, int]:
    return int(colour[1:3], 16), int(colour[3:5], 16), int(colour[5:7], 16)
