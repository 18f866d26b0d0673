"""Write pictures into a movie file one after the other: MP4 (H.264) or GIF, by the name's ending.

MP4 is what browsers, slides and phones play: H.264, 4:2:0, colours by BT.709, index at the front. GIF has one palette
of 255 colours for all frames. A file appears whole or not at all.
"""

from __future__ import annotations

import os
import tempfile
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from fractions import Fraction
from pathlib import Path
from typing import TYPE_CHECKING, Any

import cv2
import numpy as np
from numpy.typing import NDArray

from .errors import ConfigError, OutputError

if TYPE_CHECKING:
    import av

Rgb = NDArray[np.uint8]
"""A picture (rows, cols, 3)."""

SUFFIXES = (".mp4", ".gif")
QUALITY = "20"
"""x264's constant rate factor: 18 looks lossless, 23 is its default."""
BT709, LIMITED = 1, 1
COLOURS = 255
STILL = 6
"""A GIF keeps a pixel as it was while no channel has changed by more, so that noise costs nothing."""
SAMPLED = 10_000
"""Pixels that the palette is chosen from."""


@contextmanager
def encoder(path: Path, shape: tuple[int, int], fps: float, sample: Sequence[Rgb], *,
            overwrite: bool = False) -> Iterator[Callable[[Rgb], None]]:
    """Open a movie file for pictures of `shape` (rows, cols, both even), and give the function that adds one.

    `sample` are typical pictures, of which a GIF takes its palette. Raises ConfigError for another ending, OutputError
    where the file exists (unless `overwrite`) or cannot be written. After any error nothing is left.
    """
    if path.suffix.lower() not in SUFFIXES:
        raise ConfigError(f"{path}: expected a name that ends in {' or '.join(SUFFIXES)}; found {path.suffix!r}")
    if path.exists() and not overwrite:
        raise OutputError(f"{path}: expected a new file; there is one of that name. Choose another name")
    partial: Path | None = None
    sink: _Mp4 | _Gif | None = None
    try:
        with _writing(path):
            path.parent.mkdir(parents=True, exist_ok=True)
            handle, name = tempfile.mkstemp(prefix=f".{path.stem}.partial-", suffix=path.suffix.lower(),
                                            dir=path.parent)
            os.close(handle)
            partial = Path(name)
            sink = _Mp4(partial, shape, fps) if path.suffix.lower() == ".mp4" else _Gif(partial, shape, fps, sample)

        def add(picture: Rgb) -> None:
            with _writing(path):
                sink.add(picture)

        yield add
        with _writing(path):
            sink.finish()
            partial.chmod(0o644)
            os.replace(partial, path)
    finally:
        if sink is not None:
            sink.container.close()
        if partial is not None:
            with suppress(OSError):
                partial.unlink()


@contextmanager
def _writing(path: Path) -> Iterator[None]:
    """Turn what goes wrong while a file is written into OutputError."""
    import av

    try:
        yield
    except (OSError, av.FFmpegError) as error:
        raise OutputError(f"{path}: the movie cannot be written: {getattr(error, 'strerror', None) or error}") from None


class _Mp4:
    """H.264 in an MP4 file."""

    def __init__(self, file: Path, shape: tuple[int, int], fps: float) -> None:
        import av

        self.container = av.open(str(file), "w", format="mp4", options={"movflags": "+faststart"})
        stream = _stream(self.container, "libx264", shape, Fraction(fps).limit_denominator(1000))
        stream.pix_fmt = "yuv420p"
        stream.options = {"crf": QUALITY, "preset": "veryfast"}
        stream.codec_context.thread_count = 1  # more threads hold more frames
        for name in ("color_primaries", "color_trc", "colorspace", "color_range"):
            setattr(stream.codec_context, name, LIMITED if name == "color_range" else BT709)
        self._stream = stream

    def add(self, picture: Rgb) -> None:
        import av
        from av.video.reformatter import ColorRange, Colorspace

        frame = av.VideoFrame.from_ndarray(picture, format="rgb24").reformat(
            format="yuv420p", dst_colorspace=Colorspace.ITU709, dst_color_range=ColorRange.MPEG)
        self.container.mux(self._stream.encode(frame))

    def finish(self) -> None:
        self.container.mux(self._stream.encode())
        self.container.close()


class _Gif:
    """A GIF whose frames share one palette; it ends with a transparent entry, for what does not change."""

    def __init__(self, file: Path, shape: tuple[int, int], fps: float, sample: Sequence[Rgb]) -> None:
        import av

        colours = _palette(sample)
        self._nearest = _nearest(colours)
        self._palette = np.zeros((256, 4), np.uint8)
        self._palette[:COLOURS, 0], self._palette[:COLOURS, 1:] = 255, colours
        self._shown = np.zeros((*shape, 3), np.uint8)
        self._index: NDArray[np.uint8] | None = None
        self.container = av.open(str(file), "w", format="gif")
        # A GIF counts its times in hundredths of a second.
        self._stream = _stream(self.container, "gif", shape, Fraction(100, max(round(100 / fps), 2)))
        self._stream.pix_fmt = "pal8"

    def add(self, picture: Rgb) -> None:
        import av

        index = self._nearest[picture[..., 0] >> 3, picture[..., 1] >> 2, picture[..., 2] >> 3]
        changed = cv2.absdiff(picture, self._shown).max(axis=2) > STILL
        if self._index is None:
            changed[:] = True
        else:
            index = np.where(changed, index, self._index)
        self._index = index
        self._shown[changed] = picture[changed]
        frame = av.VideoFrame.from_ndarray((index, self._palette), format="pal8")  # type: ignore[arg-type]
        self.container.mux(self._stream.encode(frame))

    def finish(self) -> None:
        self.container.mux(self._stream.encode())
        self.container.close()


def _stream(container: av.container.OutputContainer, codec: str, shape: tuple[int, int], rate: Fraction) -> Any:
    stream = container.add_stream(codec, rate=rate)
    stream.height, stream.width = shape  # type: ignore[union-attr]
    return stream


def _palette(sample: Sequence[Rgb]) -> Rgb:
    """Choose the 255 colours (255, 3) that stand for the pixels of some pictures best."""
    every = np.concatenate([picture.reshape(-1, 3) for picture in sample])
    # Half of them by area, half one of each colour, so that rare colours, as of thin lines, count too.
    parts = [part[np.linspace(0, len(part) - 1, SAMPLED // 2).astype(int)]
             for part in (every, np.unique(every >> 2, axis=0) << 2)]
    pixels = np.concatenate(parts).astype(np.float32)
    cv2.setRNGSeed(1)
    _, _, centers = cv2.kmeans(pixels, COLOURS, None,  # type: ignore[call-overload]
                               (cv2.TERM_CRITERIA_MAX_ITER, 10, 0.0), 1, cv2.KMEANS_PP_CENTERS)
    colours = np.clip(np.rint(centers), 0, 255).astype(np.uint8)
    colours[np.argmax(colours.sum(axis=1, dtype=int))] = 255  # paper stays white
    return np.asarray(colours)


def _nearest(colours: Rgb) -> NDArray[np.uint8]:
    """Number (32, 64, 32) of the nearest of the colours, for every colour of 5, 6 and 5 bits."""
    from scipy.spatial import cKDTree

    levels = (np.arange(32) * 8 + 4, np.arange(64) * 4 + 2, np.arange(32) * 8 + 4)
    every = np.stack(np.meshgrid(*levels, indexing="ij"), axis=-1)
    out = np.asarray(cKDTree(colours.astype(float)).query(every.reshape(-1, 3))[1], np.uint8).reshape(32, 64, 32)
    out[-1, -1, -1] = np.argmax(colours.sum(axis=1, dtype=int))
    return out
