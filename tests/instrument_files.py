"""Write small files as instruments do, for tests: ND2, LIF, CZI, Micro-Manager and videos.

ND2 and LIF have no writer anywhere; these are made by hand, with the few parts that a reader needs.
"""

from __future__ import annotations

import json
import struct
from collections.abc import Sequence
from fractions import Fraction
from pathlib import Path
from typing import Any

import av
import numpy as np
import tifffile
from numpy.typing import NDArray

Image = NDArray[Any]


# --- ND2 ------------------------------------------------------------------------------------------------------------

ND2_MAGIC = 0x0ABECEDA
MAP_NAME, MAP_END = b"ND2 FILEMAP SIGNATURE NAME 0001!", b"ND2 CHUNK MAP SIGNATURE 0000001!"


def lite(name: str, value: Any) -> bytes:
    """One entry of Nikon's binary tree: a dict, list, text, bool, whole number (32 bits) or number."""
    kind = {dict: 11, list: 11, str: 8, bool: 1, int: 3, float: 6}[type(value)]
    head = struct.pack("BB", kind, len(name) + 1) + (name + "\0").encode("utf-16-le")
    if isinstance(value, dict | list):
        items = value.items() if isinstance(value, dict) else (("", v) for v in value)
        inner = b"".join(lite(k, v) for k, v in items)
        return head + struct.pack("<IQ", len(value), len(head) + 12 + len(inner)) + inner + bytes(8 * len(value))
    if isinstance(value, str):
        return head + (value + "\0").encode("utf-16-le")
    return head + struct.pack({1: "<B", 3: "<I", 6: "<d"}[kind], value)


def write_nd2(file: Path, frames: Image, *, positions: int = 1, um_per_px: float = 0.65,
              times_s: Sequence[float] = (), channel_names: Sequence[str] = ()) -> Path:
    """Write (T, Y, X) or (T, C, Y, X) frames of uint16; with several positions T runs within each."""
    if frames.ndim == 3:
        frames = frames[:, None]
    count, channels, rows, cols = frames.shape
    times = count // positions
    time_loop = {"eType": 1, "uLoopPars": {"uiCount": times, "dStart": 0.0, "dPeriod": 50.0, "dDuration": 0.0}}
    loop: dict[str, Any] = time_loop
    if positions > 1:
        points = [{"dPosX": 1.0, "dPosY": 2.0, "dPosName": f"well {i}"} for i in range(positions)]
        loop = {"eType": 2, "uLoopPars": {"uiCount": positions, "Points": points}, "ppNextLevelEx": [time_loop]}
    probe = {"m_ExcitationSpectrum": {"uiCount": 0}, "m_EmissionSpectrum": {"uiCount": 0}}
    planes = {f"a{i}": {"uiCompCount": 1, "sDescription": (list(channel_names) or ["c"] * channels)[i], "uiColor": 255,
                        "pFluorescentProbe": probe}
              for i in range(channels)}
    chunks: dict[bytes, bytes] = {
        b"ImageAttributesLV!": lite("SLxImageAttributes", {
            "uiWidth": cols, "uiWidthBytes": cols * 2 * channels, "uiHeight": rows, "uiComp": channels,
            "uiBpcInMemory": 16, "uiBpcSignificant": 12, "uiSequenceCount": count, "eCompression": 2}),
        b"ImageMetadataLV!": lite("SLxExperiment", loop),
        b"ImageMetadataSeqLV|0!": lite("SLxPictureMetadata", {
            "dTimeMSec": 0.0, "bCalibrated": True, "dCalibration": um_per_px, "dAspect": 1.0,
            "sPicturePlanes": {"uiCount": channels, "uiCompCount": channels, "sPlaneNew": planes}}),
        b"CustomData|AcqTimesCache!": (1000 * np.array(times_s or np.arange(count) * 0.05, "<f8")).tobytes(),
    }
    for i, frame in enumerate(frames):
        chunks[b"ImageDataSeq|%d!" % i] = bytes(8) + np.moveaxis(frame, 0, -1).astype("<u2").tobytes()
    out = struct.pack("<IIQ", ND2_MAGIC, 32, 64) + b"ND2 FILE SIGNATURE CHUNK NAME01!" + b"Ver3.0".ljust(64, b"\0")
    listed = b""
    for name, data in chunks.items():
        out = out.ljust(-(-len(out) // 4096) * 4096, b"\0")
        listed += name + struct.pack("<QQ", len(out), len(data))
        out += struct.pack("<IIQ", ND2_MAGIC, 4072, len(data)) + name.ljust(4072, b"\0") + data
    place = len(out)
    listed += MAP_END + struct.pack("<Q", place)
    out += struct.pack("<IIQ", ND2_MAGIC, len(MAP_NAME), len(listed)) + MAP_NAME + listed
    file.write_bytes(out)
    return file


# --- LIF ------------------------------------------------------------------------------------------------------------

LIF_AXES = {"X": 1, "Y": 2, "Z": 3, "T": 4}


def write_lif(file: Path, images: dict[str, Image], *, um_per_px: float = 0.65, step_s: float = 0.05,
              times_s: Sequence[float] = ()) -> Path:
    """Write images by name, each (T, Y, X) or (T, C, Y, X), of uint8 or uint16."""
    elements, blocks = "", b""
    for number, (name, image) in enumerate(images.items()):
        if image.ndim == 3:
            image = image[:, None]
        count, channels, rows, cols = image.shape
        size = image.dtype.itemsize
        dims = (("X", cols, size, (cols - 1) * um_per_px * 1e-6, "m"),
                ("Y", rows, size * cols, (rows - 1) * um_per_px * 1e-6, "m"),
                ("T", count, size * cols * rows * channels, (count - 1) * step_s, "s"))
        listed = "".join(f'<DimensionDescription DimID="{LIF_AXES[a]}" NumberOfElements="{n}" Origin="0" '
                         f'Length="{length}" Unit="{unit}" BitInc="0" BytesInc="{step}"/>'
                         for a, n, step, length, unit in dims)
        told = "".join(f'<ChannelDescription DataType="0" ChannelTag="0" Resolution="{8 * size}" '
                       f'NameOfMeasuredQuantity="" Min="0" Max="1" Unit="" LUTName="Gray{c}" IsLUTInverted="0" '
                       f'BytesInc="{c * size * rows * cols}" BitInc="0"/>' for c in range(channels))
        stamps = " ".join(f"{int(116444736000000000 + 1.6e16 + t * 1e7):x}" for t in times_s)
        elements += (f'<Element Name="{name}"><Memory Size="{image.nbytes}" MemoryBlockID="MemBlock_{number}"/>'
                     f"<Data><Image><ImageDescription><Channels>{told}</Channels><Dimensions>{listed}</Dimensions>"
                     f'</ImageDescription><TimeStampList NumberOfTimeStamps="{len(times_s)}">{stamps}</TimeStampList>'
                     "</Image></Data></Element>")
        label = f"MemBlock_{number}".encode("utf-16-le")
        blocks += struct.pack("<IIBQBI", 0x70, 14 + len(label), 0x2A, image.nbytes, 0x2A, len(label) // 2)
        blocks += label + image.tobytes()
    text = (f'<LMSDataContainerHeader Version="2"><Element Name="project"><Data/><Children>{elements}</Children>'
            "</Element></LMSDataContainerHeader>").encode("utf-16-le")
    file.write_bytes(struct.pack("<IIBI", 0x70, len(text) + 5, 0x2A, len(text) // 2) + text + blocks)
    return file


# --- CZI ------------------------------------------------------------------------------------------------------------


def write_czi(file: Path, frames: Image, *, um_per_px: float = 0.65, scenes: int = 1) -> Path:
    """Write (T, Y, X) or (T, C, Y, X) frames with Zeiss's own library."""
    from pylibCZIrw import czi

    if frames.ndim == 3:
        frames = frames[:, None]
    with czi.create_czi(str(file)) as out:
        for scene in range(scenes):
            for t, planes in enumerate(frames):
                for c, plane in enumerate(planes):
                    out.write(plane[..., None] + scene, plane={"T": t, "C": c, "Z": 0}, scene=scene,
                              location=(scene * 100, 0))
        out.write_metadata("test", scale_x=um_per_px * 1e-6, scale_y=um_per_px * 1e-6,
                           channel_names={c: f"ch{c}" for c in range(frames.shape[1])})
    return file


# --- Micro-Manager --------------------------------------------------------------------------------------------------


def write_micromanager(folder: Path, frames: Image, *, times_s: Sequence[float], um_per_px: float = 0.65,
                       version: int = 2) -> Path:
    """Write (T, C, Y, X) frames as `img_*.tif` with `metadata.txt`, by the names of version 1 or 2."""
    folder.mkdir(parents=True, exist_ok=True)
    listed: dict[str, Any] = {"Summary": {"Frames": len(frames), "ChNames": ["BF", "DAPI"], "PixelSize_um": um_per_px}}
    for t, planes in enumerate(frames):
        for c, plane in enumerate(planes):
            name = f"img_{t:09}_{'BF' if c == 0 else 'DAPI'}_000.tif" if version == 1 else \
                f"img_channel{c:03}_position000_time{t:09}_z000.tif"
            tifffile.imwrite(folder / name, plane)
            entry = {"ElapsedTime-ms": 1000 * times_s[t] + c, "PixelSizeUm": um_per_px}
            if version == 1:
                listed[f"FrameKey-{t}-{c}-0"] = entry | {"FileName": name}
            else:
                listed[f"Metadata-Default/{name}"] = entry
    (folder / "metadata.txt").write_text(json.dumps(listed))
    return folder


# --- videos ---------------------------------------------------------------------------------------------------------


def write_video(file: Path, frames: Image, codec: str = "ffv1", pix_fmt: str = "gray",
                ticks: Sequence[int] | None = None, **options: str) -> Path:
    """Write grey frames (T, R, C) of 8 bits; `ticks` are the frames' times in hundredths of a second."""
    with av.open(str(file), "w") as out:
        stream: Any = out.add_stream(codec, rate=20)
        stream.height, stream.width = frames.shape[1:3]
        stream.pix_fmt, stream.time_base, stream.options = pix_fmt, Fraction(1, 100), options
        stream.codec_context.time_base = Fraction(1, 100)
        for t, frame in enumerate(frames):
            picture = av.VideoFrame.from_ndarray(frame, format="gray" if frame.ndim == 2 else "rgb24")
            if pix_fmt != picture.format.name:
                picture = picture.reformat(format=pix_fmt, src_color_range="JPEG", dst_color_range="JPEG")
            picture.pts, picture.time_base = 5 * t if ticks is None else ticks[t], Fraction(1, 100)
            out.mux(stream.encode(picture))
        out.mux(stream.encode())
    return file
