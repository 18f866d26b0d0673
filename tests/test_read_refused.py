"""What cannot be read is refused with one clear error that names the file."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest
import tifffile

from microbundle.errors import MovieUnreadable
from microbundle.read import read_movie

from .test_read import SHAPE, noise, refused, stack, write


def test_missing_movie_is_refused(tmp_path: Path) -> None:
    assert "there is no such file" in refused(tmp_path / "nothing")
    refused(tmp_path / ("x" * 300))


def test_empty_folder_is_refused(tmp_path: Path) -> None:
    assert "expected TIFF files (.tif, .tiff, any case); found none" in refused(tmp_path)


@pytest.mark.parametrize(("content", "said"), [(b"", "an empty file"), (b"hello, this is text", "starts with b'hell'")])
def test_what_is_no_tiff_is_refused_by_its_first_bytes(tmp_path: Path, content: bytes, said: str) -> None:
    file = tmp_path / "m.tif"
    file.write_bytes(content)
    assert said in refused(file)
    with pytest.raises(MovieUnreadable, match=r"m.tif: expected a TIFF"):
        read_movie(tmp_path)


@pytest.mark.parametrize("content", [b"", b"hello, this is text", b"II*\0\xff\xff\xff\xff"])
def test_a_damaged_file_among_good_ones_is_named(tmp_path: Path, content: bytes) -> None:
    write(tmp_path, noise(3))
    (tmp_path / "f001.tif").write_bytes(content)
    with pytest.raises(MovieUnreadable, match=r"f001.tif: the TIFF cannot be decoded"):
        stack(read_movie(tmp_path))


@pytest.mark.parametrize("share", [0.02, 0.3, 0.5, 0.8])
@pytest.mark.parametrize("kind", ["pages", "block", "listed", "imagej", "ome", "compressed"])
def test_a_file_that_was_cut_off_is_refused_not_shortened(tmp_path: Path, kind: str, share: float) -> None:
    file, frames = tmp_path / "m.tif", noise(8)
    match kind:
        case "block" | "listed":
            tifffile.imwrite(file, frames, truncate=kind == "listed")
        case "imagej" | "ome":
            tifffile.imwrite(file, frames, imagej=kind == "imagej", ome=kind == "ome", metadata={"axes": "TYX"})
        case _:
            with tifffile.TiffWriter(file) as out:
                for frame in frames:
                    out.write(frame, contiguous=False, metadata=None,
                              compression="zlib" if kind == "compressed" else None)
    np.testing.assert_array_equal(stack(read_movie(file)), frames)
    whole = file.read_bytes()
    file.write_bytes(whole[:int(share * len(whole))])
    refused(file)


def test_a_frame_that_was_cut_off_is_refused(tmp_path: Path) -> None:
    write(tmp_path, noise(3))
    file = tmp_path / "f002.tif"
    file.write_bytes(file.read_bytes()[:-300])
    with pytest.raises(MovieUnreadable, match=r"f002.tif"):
        stack(read_movie(tmp_path))


def test_a_frame_of_another_size_is_refused(tmp_path: Path) -> None:
    write(tmp_path / "m", noise(3))
    tifffile.imwrite(tmp_path / "m" / "f001.tif", noise(1)[0][:10])
    with pytest.raises(MovieUnreadable, match=r"f001.tif: expected 20 x 30 px as in the first frame; found 10 x 30"):
        stack(read_movie(tmp_path / "m"))
    with tifffile.TiffWriter(tmp_path / "p.tif") as file:
        for i, frame in enumerate(noise(5)):
            file.write(frame[:10] if i == 3 else frame, contiguous=False, metadata=None)
    assert "expected frames of one size; found 10 x 30 and 20 x 30" in refused(tmp_path / "p.tif")


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
def test_frames_that_are_not_numbers_are_refused(tmp_path: Path, value: float) -> None:
    frames = noise(5, "float32")
    frames[1, 2:4, 5] = value
    tifffile.imwrite(tmp_path / "m.tif", frames)
    assert "frame 1: expected numbers; found NaN or infinity in 2 pixels" in refused(tmp_path / "m.tif")


def test_mixtures_of_channels_planes_and_times_are_refused(tmp_path: Path) -> None:
    mixed = np.zeros((3, 2, 4, *SHAPE), "uint16")
    tifffile.imwrite(tmp_path / "m.tif", mixed, imagej=True, metadata={"axes": "TZCYX"})
    assert "found axes T 3, Z 2, C 4. Choose with --reading.z (0 to 1)" in refused(tmp_path / "m.tif")
    tifffile.imwrite(tmp_path / "o.ome.tif", mixed[:, 0], ome=True, metadata={"axes": "TCYX"})
    assert "T 3, C 4" in refused(tmp_path / "o.ome.tif")


def test_channels_alone_are_taken_as_time_for_review(tmp_path: Path) -> None:
    tifffile.imwrite(tmp_path / "m.ome.tif", noise(3), ome=True, metadata={"axes": "CYX"})
    assert [(f.key, f.level) for f in read_movie(tmp_path / "m.ome.tif").findings] == [("c_as_time", "review")]


def test_a_folder_of_movies_is_refused(tmp_path: Path) -> None:
    for name in "ab":
        tifffile.imwrite(tmp_path / f"{name}.tif", noise(5))
    assert "A folder of movies is not one movie" in refused(tmp_path)
    (tmp_path / "a.tif").unlink()
    tifffile.imwrite(tmp_path / "0.tif", noise(1)[0])
    with pytest.raises(MovieUnreadable, match=r"b.tif: expected one frame, as in 0.tif; found 5"):
        stack(read_movie(tmp_path))


@pytest.mark.parametrize("dtype", ["bool", "complex64"])
def test_what_is_no_grey_value_is_refused(tmp_path: Path, dtype: str) -> None:
    assert f"expected grey values; found {dtype}" in refused_first(write(tmp_path, noise(2).astype(dtype)))


def refused_first(folder: Path) -> str:
    with pytest.raises(MovieUnreadable) as caught:
        read_movie(folder)
    return str(caught.value)


@pytest.mark.skipif(not hasattr(os, "geteuid") or os.geteuid() == 0, reason="the superuser may read everything")
def test_unreadable_permissions_are_reported(tmp_path: Path) -> None:
    folder = write(tmp_path / "m", noise(2))
    (folder / "f000.tif").chmod(0)
    with pytest.raises(MovieUnreadable, match=r"f000.tif: the file cannot be read: Permission denied"):
        read_movie(folder)
    folder.chmod(0)
    try:
        assert "Permission denied" in refused(folder)
    finally:
        folder.chmod(0o700)
