"""Read videos with PyAV: the time of each frame is its own time stamp, never its number times 1/fps.

The file is listed once without decoding. A frame is found by seeking the key frame before it and decoding from there;
what is decoded on the way is kept, within a fixed number of bytes. Grey is the video's own brightness (luma),
untouched. Videos with a mark to be shown turned by 90, 180 or 270 degrees are turned, as every player does.
"""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, BinaryIO

import av
import numpy as np

from ..calibration import Calibration
from ..data import Finding, Image, Ints
from ..errors import MicrobundleError, MovieUnreadable
from .grey import check_size, luminance, undecodable
from .opened import Contents, FileFrames, Opened, Selection, Series, choose

CACHE_BYTES = 32 * 2**20
FORMATS = {"avi": "AVI", "mov": "MP4 or QuickTime", "matroska": "Matroska"}
COST = ("on rendered tissues, good and poor compression cost 0.04 to 0.15 px, ten to thirty times the error without, "
        "and show motion of 0.4 px 8 to 40 % too small")
"""By `benchmarks/compressed_video.py`."""
QUICKTIME = (b"ftyp", b"moov", b"mdat", b"wide", b"free", b"skip", b"pnot")


def format_of(magic: bytes) -> str | None:
    """Tell a video by its first bytes: avi, mov (also MP4), matroska (also WebM), or None."""
    if magic[:4] == b"RIFF" and magic[8:12] == b"AVI ":
        return "avi"
    if magic[4:8] in QUICKTIME:
        return "mov"
    return "matroska" if magic[:4] == b"\x1a\x45\xdf\xa3" else None


def contents(file: Path) -> Contents:
    """List the video streams of a file. Raises MovieUnreadable."""
    listed = _listed(file)
    return Contents(FORMATS[listed[0].form], tuple(one.series for one in listed))


def open_movie(file: Path, selection: Selection) -> Opened:
    """Open one stream of a video. Raises MovieUnreadable and ChoiceMissing."""
    listed = _listed(file)
    inside = Contents(FORMATS[listed[0].form], tuple(one.series for one in listed))
    choice = choose(file, inside, selection)
    track = listed[choice.series]
    frames = VideoFrames(file, choice, track)
    frames[0]
    times = (track.stamps - track.stamps[0]) * track.unit_s
    return Opened(inside, choice, frames, (file,), Calibration(times), _notes(track, frames.turns))


@dataclass(frozen=True)
class _Track:
    """One stream of a video, as its packets list it."""

    form: str
    number: int
    series: Series
    stamps: Ints
    """Time stamp of each frame (T,), rising."""
    keys: Ints
    """Time stamps from which decoding can start."""
    unit_s: float
    lossy: bool
    colour: bool
    reordered: bool = False
    """Whether the stamps are those of decoding (AVI knows no other) and frames are shown in another order: then they
    are counted from the beginning, and reaching one takes longer."""


class VideoFrames(FileFrames):
    """Frames of one stream of a video."""

    def __init__(self, file: Path, choice: Any, track: _Track) -> None:
        super().__init__(file, choice)
        self._track = track
        self._kept: OrderedDict[int, Image] = OrderedDict()
        self.turns = 0
        """Quarter turns, against the clock, at which the video is to be shown."""

    def __getstate__(self) -> dict[str, Any]:
        return super().__getstate__() | {"_kept": OrderedDict()}

    def _open(self) -> _Decoder:
        return _Decoder(self.file, self._track)

    def _read(self, index: int) -> tuple[Image, str]:
        if index in self._kept:
            return self._kept[index], "YX"
        decoder: _Decoder = self._handle
        for start in decoder.starts(index):
            for place, frame in decoder.frames(start):
                if not frame.is_corrupt:
                    self.turns = round(float(frame.rotation) / 90) % 4
                    self._keep(place, np.rot90(_grey(frame), self.turns).copy())
                if place >= index:
                    break
            if index in self._kept:
                return self._kept[index], "YX"
        raise ValueError("the frame is listed, but cannot be decoded; the file is damaged or cut off")

    def _keep(self, index: int, frame: Image) -> None:
        self._kept[index] = frame
        self._kept.move_to_end(index)
        while len(self._kept) > max(1, CACHE_BYTES // frame.nbytes):
            self._kept.popitem(last=False)


class _Decoder:
    """An open video, and where in it decoding stands."""

    def __init__(self, file: Path, track: _Track) -> None:
        self._file, self._track = file, track
        self._flow: Iterator[Any] = iter(())
        self._at: int | None = None
        """Number of the last frame that was decoded."""
        self._rewind()

    def starts(self, index: int) -> Iterator[int | None]:
        """Give the ways to reach a frame: go on (None), from the key frame before it, from the beginning."""
        stamps = self._track.stamps
        before = self._track.keys[self._track.keys <= stamps[index]]
        key = int(before[-1]) if len(before) else int(stamps[0])
        if self._at is not None and self._at < index and key <= stamps[self._at]:
            yield None
        if key > stamps[0]:
            yield key
        yield int(stamps[0])

    def frames(self, start: int | None) -> Iterator[tuple[int, Any]]:
        """Decode from a time stamp, or go on from the last frame; gives each frame with its number."""
        stamps = self._track.stamps
        if start == int(stamps[0]):
            self._rewind()
        elif start is not None:
            try:
                self._container.seek(start, backward=True, any_frame=False, stream=self._stream)
                self._flow = self._container.decode(self._stream)
            except av.FFmpegError:
                self._rewind()
        for frame in self._flow:
            if self._track.reordered:
                place = 0 if self._at is None else self._at + 1
            elif frame.pts is not None:
                place = int(np.searchsorted(stamps, frame.pts))
            else:
                continue
            if place < len(stamps) and (self._track.reordered or stamps[place] == frame.pts):
                self._at = place
                yield place, frame

    def _rewind(self) -> None:
        # Seeking to the beginning fails in files whose first frame has an earlier decoding time.
        self._container = _container(self._file, self._track.form)
        self._stream = self._container.streams.video[self._track.number]
        self._flow = self._container.decode(self._stream)
        self._at = None


def _listed(file: Path) -> list[_Track]:
    """List the streams of a video with the time stamps of their frames."""
    with file.open("rb") as stream:
        form = format_of(stream.read(16))
    if form is None:
        raise MovieUnreadable(f"{file}: expected a video")
    try:
        _check_whole(file, form)
        with _container(file, form) as container:
            count = len(container.streams.video)
        found = [_track(file, form, number) for number in range(count)]
    except MicrobundleError:
        raise
    except Exception as error:  # the library raises many kinds on damaged files
        raise undecodable(file, error) from None
    if not found:
        raise MovieUnreadable(f"{file}: expected pictures; found a {FORMATS[form]} file without a video stream")
    return found


def _check_whole(file: Path, form: str) -> None:
    """Refuse a file that is shorter than its own outermost boxes say."""
    size = file.stat().st_size
    with file.open("rb") as stream:
        end = {"avi": _end_of_riff, "matroska": _end_of_segment, "mov": _end_of_boxes}[form](stream, size)
    if end > size:
        raise MovieUnreadable(f"{file}: expected {end} bytes, as the file says; found {size}. It is cut off")


def _end_of_riff(stream: BinaryIO, _: int) -> int:
    return 8 + int.from_bytes(stream.read(8)[4:], "little")


def _end_of_segment(stream: BinaryIO, _: int) -> int:
    head = stream.read(4096)
    start = head.find(b"\x18\x53\x80\x67") + 4
    first = head[start] if 4 <= start < len(head) else 0
    length = 9 - first.bit_length()
    inside = int.from_bytes(head[start:start + length], "big") & ((1 << 7 * length) - 1)
    # A size of ones alone means that it was not known when the file was begun.
    return start + length + inside if first and inside != (1 << 7 * length) - 1 else 0


def _end_of_boxes(stream: BinaryIO, size: int) -> int:
    place = 0
    while place + 8 <= size:
        stream.seek(place)
        head = stream.read(16)
        inside = int.from_bytes(head[:4], "big")
        if inside == 1:
            inside = int.from_bytes(head[8:], "big")
        if inside < 8:  # up to the end, or damaged
            break
        place += inside
    return place


def _container(file: Path, form: str) -> Any:
    # The prefix and the format keep a name or a content from being taken for an address.
    return av.open(f"file:{file.resolve()}", format=form)


def _track(file: Path, form: str, number: int) -> _Track:
    with _container(file, form) as container:
        stream = container.streams.video[number]
        context = stream.codec_context
        if context is None or context.format is None:
            raise MovieUnreadable(f"{file}: expected a video that can be decoded; found one of an unknown kind")
        check_size(file, context.height, context.width, 3)
        packets = [p for p in container.demux(stream) if p.size or p.dts is not None]
        shown = [p for p in packets if p.size and not p.is_discard]
        reordered = form == "avi" and bool(context.has_b_frames)
        whole = sum(not p.is_corrupt for p in packets)
        if whole < len(packets) or (form == "mov" and whole < stream.frames):
            raise MovieUnreadable(f"{file}: expected {max(stream.frames, len(packets))} whole frames, as the file "
                                  f"says; found {whole}. It is damaged or cut off")
        listed = [p.dts if reordered else p.pts for p in shown]
        stamps: list[Any] = sorted(listed) if None not in listed else []
        keys = np.array([] if reordered else sorted(p.pts for p in packets if p.is_keyframe and p.pts is not None), int)
        codec, pixels = context.codec, context.format
        unit, rows, cols = float(stream.time_base or 0), int(context.height), int(context.width)
    if not stamps or len(set(stamps)) < len(stamps):
        stamps = _decoded_stamps(file, form, number)
    if not stamps or unit <= 0:
        raise MovieUnreadable(f"{file}: expected frames with time stamps; found none. Save the video again, or as TIFF")
    series = Series("", {"T": len(stamps), "Y": rows, "X": cols}, (), int(pixels.components[0].bits), str(codec.name))
    grey = pixels.name.startswith("gray")
    return _Track(form, number, series, np.array(stamps, int), keys, unit, bool(codec.lossy), not grey,
                  reordered)


def _decoded_stamps(file: Path, form: str, number: int) -> list[int]:
    """Find the time stamps by decoding the whole video, for files that list none."""
    with _container(file, form) as container:
        stamps = [frame.pts for frame in container.decode(container.streams.video[number])]
    return sorted({int(stamp) for stamp in stamps if stamp is not None})


def _grey(frame: Any) -> Image:
    """Take the brightness of a frame as the file holds it; RGB as its luminance."""
    first = frame.format.components[0]
    if frame.format.name.startswith("gray") or (frame.format.is_planar
                                                and frame.format.name.startswith(("yuv", "nv", "p0"))):
        kind = "u1" if first.bits <= 8 else ">u2" if frame.format.is_big_endian else "<u2"
        plane = frame.planes[0]
        rows = np.frombuffer(plane, np.uint8).reshape(-1, plane.line_size)[:frame.height]
        return np.asarray(rows.view(kind)[:, :frame.width].astype(kind[-2:]))
    if first.bits > 8:
        return luminance(frame.to_ndarray(format="rgb48le"))
    return luminance(frame.to_ndarray(format="rgb24"))


def _notes(track: _Track, turns: int) -> tuple[Finding, ...]:
    notes = []
    if track.lossy:
        notes.append(Finding("compressed_video", "review", "the video may be compressed with losses "
                             f"({track.series.compression}): {COST}. Record without losses: TIFF, or FFV1"))
    if track.colour:
        notes.append(Finding("colour_converted", "info", "the video is in colour; its brightness was used"))
    if turns:
        notes.append(Finding("turned", "info", "the video is marked to be shown turned by "
                             f"{90 * turns} degrees against the clock; it was turned"))
    return tuple(notes)
