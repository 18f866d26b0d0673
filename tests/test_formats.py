"""Instruments' files and videos: what is taken from each, how a part is chosen, and that frames travel to processes."""

from __future__ import annotations

import json
import pickle
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tifffile
from numpy.typing import NDArray

from microbundle.cli import run
from microbundle.config import Reading
from microbundle.data import Movie
from microbundle.errors import ChoiceMissing, ConfigError, MovieUnreadable
from microbundle.formats import opened, video
from microbundle.read import describe, prepare, read_movie

from .instrument_files import write_czi, write_lif, write_micromanager, write_nd2, write_video
from .test_read import keys, stack

Image = NDArray[Any]
TIMES = [0.0, 0.05, 0.1, 0.2, 0.25, 0.3]
TICKS = [0, 5, 10, 20, 25, 30]


def grey(dtype: str = "uint16", channels: int = 0) -> Image:
    shape = (6, channels, 20, 30) if channels else (6, 20, 30)
    return np.random.default_rng(0).integers(1, 250, shape).astype(dtype)


def smooth(count: int = 40) -> Image:
    """Frames (T, 64, 96) of 8 bits that a lossy codec keeps apart: a gradient, brighter from frame to frame."""
    return np.add.outer(np.arange(count) * 4, np.add.outer(np.arange(64), np.arange(96)) // 4).astype("uint8")


def needs_czi() -> None:
    pytest.importorskip("czifile", reason="czifile needs Python 3.12")
    pytest.importorskip("pylibCZIrw")
    if sys.version_info < (3, 12):
        pytest.skip("czifile needs Python 3.12")


WRITERS: dict[str, Callable[[Path, Image], Path]] = {
    "nd2": lambda folder, frames: write_nd2(folder / "m.nd2", frames, times_s=TIMES),
    "lif": lambda folder, frames: write_lif(folder / "m.lif", {"a": frames}, times_s=TIMES),
    "czi": lambda folder, frames: write_czi(folder / "m.czi", frames),
    "imagej": lambda folder, frames: _tiff(folder / "m.tif", frames, imagej=True),
    "ome": lambda folder, frames: _tiff(folder / "m.ome.tif", frames, ome=True),
    "micromanager1": lambda folder, frames: _mm(folder, frames, 1),
    "micromanager2": lambda folder, frames: _mm(folder, frames, 2),
}


def _tiff(file: Path, frames: Image, **options: Any) -> Path:
    axes = "TYX" if frames.ndim == 3 else "TCYX"
    scale: dict[str, Any] = {"axes": axes, "unit": "um", "finterval": 0.05} if "imagej" in options else {
        "axes": axes, "PhysicalSizeX": 0.65, "PhysicalSizeY": 0.65, "TimeIncrement": 0.05}
    tifffile.imwrite(file, frames, resolution=(1 / 0.65, 1 / 0.65), metadata=scale, **options)
    return file


def _mm(folder: Path, frames: Image, version: int) -> Path:
    return write_micromanager(folder / "Pos0", frames[:, None] if frames.ndim == 3 else frames, times_s=TIMES,
                              version=version)


def write(kind: str, folder: Path, frames: Image) -> Path:
    if kind == "czi":
        needs_czi()
    elif kind in ("nd2", "lif"):
        pytest.importorskip({"nd2": "nd2", "lif": "liffile"}[kind])
    return WRITERS[kind](folder, frames)


# --- every format ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("kind", WRITERS)
def test_frames_pixel_size_and_times_are_those_of_the_file(tmp_path: Path, kind: str) -> None:
    frames = grey()
    movie = read_movie(write(kind, tmp_path, frames))
    np.testing.assert_array_equal(stack(movie), frames)
    assert movie.um_per_px == pytest.approx(0.65, rel=1e-5)
    assert movie.um_per_px_source == "file"
    if kind == "czi":  # its writer writes no times
        assert movie.time_source == "unknown"
    else:
        stamped = kind in ("nd2", "lif", "micromanager1", "micromanager2")
        np.testing.assert_allclose(movie.time_s, TIMES if stamped else np.arange(6) * 0.05, atol=1e-9)
        assert movie.time_source == "file"
    assert movie.findings == ()


@pytest.mark.parametrize("kind", WRITERS)
def test_a_channel_is_chosen_never_guessed(tmp_path: Path, kind: str) -> None:
    frames = grey(channels=2)
    path = write(kind, tmp_path, frames)
    with pytest.raises(ChoiceMissing, match=r"found axes T 6, C 2. Choose with --reading.channel \(0"):
        read_movie(path)
    for channel in (0, 1):
        movie = read_movie(path, channel=channel)
        np.testing.assert_array_equal(stack(movie), frames[:, channel])
        assert movie.taken["channel"] == channel
        assert keys(movie) == ["part_taken"]
    with pytest.raises(MovieUnreadable, match="expected channel from 0 to 1, which the file has; found 2"):
        read_movie(path, channel=2)


@pytest.mark.parametrize("kind", [*WRITERS, "avi", "mkv"])
def test_an_opened_movie_travels_to_another_process(tmp_path: Path, kind: str) -> None:
    frames = grey("uint8")
    path = write_video(tmp_path / f"m.{kind}", frames) if kind in ("avi", "mkv") else write(kind, tmp_path, frames)
    movie = prepare(read_movie(path), Reading(first_frame=1))
    movie.frames[2]
    copy: Movie = pickle.loads(pickle.dumps(movie))
    np.testing.assert_array_equal(stack(copy), frames[1:])


@pytest.mark.parametrize("kind", ["nd2", "lif", "czi"])
def test_the_name_says_nothing(tmp_path: Path, kind: str) -> None:
    path = write(kind, tmp_path, grey())
    np.testing.assert_array_equal(stack(read_movie(path.rename(tmp_path / "Gewebe µ 1.tif"))), grey())


@pytest.mark.parametrize("kind", ["nd2", "lif", "czi", "ome", "imagej"])
def test_what_changes_while_it_is_read_is_refused(tmp_path: Path, kind: str) -> None:
    path = write(kind, tmp_path, grey())
    movie = read_movie(path)
    with path.open("r+b") as stream:
        stream.truncate(path.stat().st_size // 2)
    with pytest.raises(MovieUnreadable, match="the file has changed since it was opened"):
        movie.frames[5]
    path.unlink()
    with pytest.raises(MovieUnreadable, match="the file can no longer be read"):
        movie.frames[5]


@pytest.mark.parametrize("kind", ["nd2", "lif", "czi"])
@pytest.mark.parametrize("share", [0.1, 0.5, 0.95])
def test_a_file_that_was_cut_off_is_refused(tmp_path: Path, kind: str, share: float) -> None:
    path = write(kind, tmp_path, grey())
    path.write_bytes(path.read_bytes()[:int(share * path.stat().st_size)])
    with pytest.raises(MovieUnreadable, match=rf"m.{kind}"):
        stack(read_movie(path))


@pytest.mark.parametrize(("kind", "library", "extra"), [("nd2", "nd2", "nd2"), ("lif", "liffile", "lif"),
                                                        ("czi", "czifile", "czi")])
def test_a_missing_library_is_named_with_the_line_that_installs_it(
        tmp_path: Path, kind: str, library: str, extra: str, monkeypatch: pytest.MonkeyPatch) -> None:
    path = write(kind, tmp_path, grey())
    monkeypatch.setitem(sys.modules, library, None)
    with pytest.raises(MovieUnreadable, match=rf'pip install "microbundle\[{extra}\]"'):
        read_movie(path)


@pytest.mark.parametrize(("place", "value", "said"), [
    ("header", 0, "expected its list of pictures; there is none"),
    ("count", 2**30, "found one of 1073741824 entries"),
    ("axes", 2**20, "expected pictures of at most 64 axes"),
    ("size", 2**29, "expected pictures that cover at most"),
])
def test_czi_lists_that_its_library_would_follow_without_end_are_refused(
        tmp_path: Path, place: str, value: int, said: str) -> None:
    needs_czi()
    file = write_czi(tmp_path / "m.czi", grey())
    raw = bytearray(file.read_bytes())
    listed = raw.find(b"ZISRAWDIRECTORY")
    at = {"header": 84, "count": listed + 32, "axes": listed + 160 + 28, "size": listed + 160 + 32 + 8}[place]
    raw[at:at + 4] = value.to_bytes(4, "little")
    file.write_bytes(raw)
    with pytest.raises(MovieUnreadable, match=said):
        read_movie(file)


@pytest.mark.skipif(sys.version_info >= (3, 12), reason="here czifile can be installed")
def test_czi_says_that_it_needs_a_newer_python(tmp_path: Path) -> None:
    (tmp_path / "m.czi").write_bytes(b"ZISRAWFILE".ljust(600, b"\0"))
    with pytest.raises(MovieUnreadable, match=r"needs Python 3.12 or newer; this is 3.11"):
        read_movie(tmp_path / "m.czi")


def test_reading_of_a_library_is_late() -> None:
    code = "import sys, microbundle.read; print([n for n in ('nd2', 'czifile', 'liffile', 'dask') if n in sys.modules])"
    import subprocess

    assert subprocess.run([sys.executable, "-c", code], capture_output=True, text=True).stdout.strip() == "[]"


# --- series, focal planes -------------------------------------------------------------------------------------------


def test_series_are_listed_and_chosen(tmp_path: Path) -> None:
    pytest.importorskip("liffile")
    frames, other = grey(), grey() + 7
    path = write_lif(tmp_path / "m.lif", {"relaxed": frames, "paced": other})
    with pytest.raises(ChoiceMissing, match=r"found 0: relaxed \(20 x 30 px, T 6\); 1: paced .*--reading.series"):
        read_movie(path)
    np.testing.assert_array_equal(stack(read_movie(path, series=1)), other)


def test_positions_of_nd2_are_series(tmp_path: Path) -> None:
    pytest.importorskip("nd2")
    frames = grey()
    path = write_nd2(tmp_path / "m.nd2", frames, positions=2)
    movie = read_movie(path, series=1)
    np.testing.assert_array_equal(stack(movie), frames[3:])
    assert "series 1 of 2 (well 1" in movie.findings[0].message


def test_scenes_of_czi_are_series(tmp_path: Path) -> None:
    needs_czi()
    path = write_czi(tmp_path / "m.czi", grey(channels=2), scenes=2)
    np.testing.assert_array_equal(stack(read_movie(path, series=1, channel=1)), grey(channels=2)[:, 1] + 1)


def test_positions_of_micromanager_are_series(tmp_path: Path) -> None:
    for i in range(2):
        write_micromanager(tmp_path / "run" / f"Pos{i}", grey()[:, None] + i, times_s=TIMES)
    with pytest.raises(ChoiceMissing, match=r"0: Pos0 .* 1: Pos1"):
        read_movie(tmp_path / "run")
    movie = read_movie(tmp_path / "run", series=1)
    np.testing.assert_array_equal(stack(movie), grey() + 1)
    np.testing.assert_allclose(movie.time_s, TIMES)


def test_a_broken_list_of_micromanager_costs_the_times_not_the_frames(tmp_path: Path) -> None:
    folder = write_micromanager(tmp_path / "Pos0", grey()[:, None], times_s=TIMES)
    whole = (folder / "metadata.txt").read_text()
    (folder / "metadata.txt").write_text(whole[:-1])  # an acquisition that was stopped
    assert read_movie(folder).time_s is not None
    (folder / "metadata.txt").write_text(whole[:-30])
    movie = read_movie(folder)
    assert (movie.count, movie.time_s, keys(movie)) == (6, None, ["metadata_unreadable"])
    (folder / "img_channel000_position000_time000000002_z000.tif").unlink()
    assert read_movie(folder).count == 5


@pytest.mark.parametrize("kind", ["imagej", "ome"])
def test_hyperstacks_give_any_channel_and_focal_plane(tmp_path: Path, kind: str) -> None:
    axes = "TZCYX"
    frames = np.random.default_rng(1).integers(0, 99, (5, 3, 2, 20, 30)).astype("uint16")
    name = "m.tif" if kind == "imagej" else "m.ome.tif"
    tifffile.imwrite(tmp_path / name, frames, imagej=kind == "imagej", ome=kind == "ome", metadata={"axes": axes})
    for z in range(3):
        movie = read_movie(tmp_path / name, channel=1, z=z)
        np.testing.assert_array_equal(stack(movie), frames[:, z, 1])
    with pytest.raises(ChoiceMissing, match=r"T 5, Z 3. Choose with --reading.z \(0 to 2\)"):
        read_movie(tmp_path / name, channel=1)


def test_images_of_one_ome_file_are_series(tmp_path: Path) -> None:
    with tifffile.TiffWriter(tmp_path / "m.ome.tif", ome=True) as out:
        out.write(grey(), metadata={"axes": "TYX", "Name": "first", "PhysicalSizeX": 1, "PhysicalSizeY": 1})
        out.write(grey()[:3, :10], metadata={"axes": "TYX", "Name": "second", "PhysicalSizeX": 2, "PhysicalSizeY": 2})
    movie = read_movie(tmp_path / "m.ome.tif", series=1)
    np.testing.assert_array_equal(stack(movie), grey()[:3, :10])
    assert movie.um_per_px == pytest.approx(2)
    with pytest.raises(ChoiceMissing, match=r"0: first .*1: second"):
        read_movie(tmp_path / "m.ome.tif")


def test_the_stamps_are_those_of_the_chosen_channel(tmp_path: Path) -> None:
    stamps = [t + c / 100 for t in TIMES for c in range(2)]
    stamps[-1] += 0.02
    tifffile.imwrite(tmp_path / "m.ome.tif", grey(channels=2), ome=True, metadata={
        "axes": "TCYX", "Plane": {"DeltaT": stamps, "DeltaTUnit": ["s"] * 12}})
    np.testing.assert_allclose(read_movie(tmp_path / "m.ome.tif", channel=0).time_s, TIMES)
    np.testing.assert_allclose(read_movie(tmp_path / "m.ome.tif", channel=1).time_s, [*TIMES[:-1], TIMES[-1] + 0.02])


def test_settings_and_the_opened_part_must_agree(tmp_path: Path) -> None:
    movie = read_movie(_tiff(tmp_path / "m.ome.tif", grey(channels=2), ome=True), channel=1)
    assert prepare(movie, Reading(channel=1)) is movie
    with pytest.raises(ConfigError, match=r"reading.channel is 0, but the movie was opened with 1"):
        prepare(movie, Reading(channel=0))


def test_compressed_tiff(tmp_path: Path) -> None:
    pytest.importorskip("imagecodecs")
    for compression in ("lzw", "zstd", "jpeg2000", "packbits"):
        tifffile.imwrite(tmp_path / "m.tif", grey(), compression=compression)
        np.testing.assert_array_equal(stack(read_movie(tmp_path / "m.tif")), grey())


# --- videos ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("codec", "ending", "pixels"), [
    ("rawvideo", "avi", "gray"), ("ffv1", "avi", "gray"), ("ffv1", "mkv", "gray"), ("png", "mov", "gray"),
    ("rawvideo", "avi", "rgb24"), ("ffv1", "mkv", "gray16le")])
def test_lossless_videos_give_every_pixel_and_the_true_times(tmp_path: Path, codec: str, ending: str,
                                                             pixels: str) -> None:
    frames = grey("uint8")
    movie = read_movie(write_video(tmp_path / f"m.{ending}", frames, codec, pixels, TICKS))
    found = stack(movie)
    np.testing.assert_array_equal(found // 257 if pixels == "gray16le" else found, frames)
    np.testing.assert_allclose(movie.time_s, TIMES, atol=1e-9)
    assert keys(movie) == (["colour_converted"] if pixels == "rgb24" else [])


@pytest.mark.parametrize(("codec", "ending", "pixels"), [
    ("libx264", "mp4", "yuv420p"), ("libx264", "mov", "yuv420p"), ("libx264", "avi", "yuv420p"),
    ("mpeg4", "avi", "yuv420p"), ("mjpeg", "avi", "yuvj420p"), ("libx264", "mkv", "yuv420p10le")])
def test_any_frame_of_a_compressed_video_is_the_right_one(tmp_path: Path, codec: str, ending: str, pixels: str,
                                                          monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(video, "CACHE_BYTES", 1)  # nothing is kept, so that every frame has to be found
    options = {"g": "7", "bf": "2"} if codec == "libx264" else {"g": "7"}
    path = write_video(tmp_path / f"m.{ending}", smooth(), codec, pixels, **options)
    movie = read_movie(path)
    assert movie.count == 40
    np.testing.assert_allclose(movie.time_s, np.arange(40) * 0.05, atol=1e-9)
    frames = movie.frames._frames  # type: ignore[attr-defined]  # without the cache of decoded frames
    order = np.random.default_rng(0).permutation(40)
    level = {int(t): float(frames[int(t)].mean()) for t in order}
    steps = np.diff([level[t] for t in range(40)])
    assert steps.min() > 0.5 * np.median(steps) > 0
    assert keys(movie) == ["compressed_video", "colour_converted"]
    assert movie.findings[0].level == "review"


def test_the_real_video_has_its_gaps(data_folder: Path) -> None:
    movie = read_movie(data_folder / "video" / "tissue_20fps.mov")
    assert (movie.count, movie.shape, movie.time_source) == (598, (540, 960), "file")
    assert sorted(set(np.round(np.diff(movie.time_s), 3))) == [0.05, 0.1]
    assert movie.frames[300].dtype == np.uint8


@pytest.mark.parametrize(("matrix", "turns"), [((0, 1, -1, 0), 3), ((0, -1, 1, 0), 1), ((-1, 0, 0, -1), 2)])
def test_a_video_that_is_marked_as_turned_is_turned(tmp_path: Path, matrix: tuple[int, ...], turns: int) -> None:
    frames = grey("uint8")
    path = write_video(tmp_path / "m.mov", frames, "png", "gray")
    raw = path.read_bytes()
    one = (1 << 16).to_bytes(4, "big")
    plain = one + bytes(12) + one  # the upper left of the matrix in the track's header
    start = raw.index(plain, raw.index(b"tkhd"))
    a, b, c, d = ((i * 65536).to_bytes(4, "big", signed=True) for i in matrix)
    path.write_bytes(raw[:start] + a + b + bytes(4) + c + d + raw[start + 20:])
    movie = read_movie(path)
    np.testing.assert_array_equal(stack(movie), np.rot90(frames, turns, axes=(1, 2)))
    assert keys(movie) == ["turned"]


@pytest.mark.parametrize("ending", ["avi", "mkv", "mp4"])
@pytest.mark.parametrize("share", [0.01, 0.3, 0.7, 0.99])
def test_a_video_that_was_cut_off_is_refused(tmp_path: Path, ending: str, share: float) -> None:
    codec, pixels = ("libx264", "yuv420p") if ending == "mp4" else ("ffv1", "gray")
    options = {} if ending != "mp4" else {"movflags": "faststart"}
    path = write_video(tmp_path / f"m.{ending}", smooth(), codec, pixels, **options)
    path.write_bytes(path.read_bytes()[:int(share * path.stat().st_size)])
    with pytest.raises(MovieUnreadable, match=rf"m.{ending}"):
        stack(read_movie(path))


def test_a_file_without_pictures_is_refused(tmp_path: Path) -> None:
    import av

    with av.open(str(tmp_path / "m.mp4"), "w") as out:
        stream: Any = out.add_stream("aac", rate=8000)
        frame = av.AudioFrame.from_ndarray(np.zeros((1, 1024), "float32"), format="fltp", layout="mono")
        frame.sample_rate = 8000
        out.mux(stream.encode(frame))
        out.mux(stream.encode(None))
    with pytest.raises(MovieUnreadable, match="expected pictures"):
        read_movie(tmp_path / "m.mp4")


# --- microbundle info -----------------------------------------------------------------------------------------------


def test_info_shows_what_is_inside(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = _tiff(tmp_path / "m.ome.tif", grey(channels=2), ome=True)
    assert run(["info", str(path), "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["format"] == "OME-TIFF"
    assert found["series"][0]["sizes"] == {"T": 6, "C": 2, "Y": 20, "X": 30}
    assert found["movie"] is None
    assert "--reading.channel" in found["to_choose"]
    assert run(["info", str(path), "--channel", "1", "--json"]) == 0
    movie = json.loads(capsys.readouterr().out)["movie"]
    assert (movie["frames"], movie["um_per_px"], movie["um_per_px_source"], movie["time_source"]) == \
        (6, pytest.approx(0.65), "file", "file")
    assert run(["info", str(path), "--channel", "1"]) == 0
    text = capsys.readouterr().out
    assert "6 frames of 20 x 30 px" in text
    assert "0.65 um (from the file)" in text


def test_info_of_what_cannot_be_read_is_an_error(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "m.nd2").write_bytes(b"version https://git-lfs.github.com/spec/v1\n")
    assert run(["info", str(tmp_path / "m.nd2")]) == 4
    assert "a pointer of Git LFS" in capsys.readouterr().err


def test_describe_agrees_with_the_movie(tmp_path: Path) -> None:
    found = describe(write_video(tmp_path / "m.avi", grey("uint8")))
    assert (found["format"], found["movie"]["number_type"], found["series"][0]["bits"]) == ("AVI", "uint8", 8)


# --- hostile files --------------------------------------------------------------------------------------------------


def test_headers_that_lie_about_the_size_cost_no_memory(tmp_path: Path) -> None:
    import tracemalloc

    path = tmp_path / "m.tif"
    tifffile.imwrite(path, grey(), metadata=None)
    raw = path.read_bytes()
    with tifffile.TiffFile(path) as tiff:
        places = [tiff.pages[0].tags[name].valueoffset for name in ("ImageWidth", "ImageLength")]  # type: ignore[union-attr]
    for value in (7000, 60000):
        changed = bytearray(raw)
        for place in places:
            changed[place:place + 2] = value.to_bytes(2, "little")
        path.write_bytes(changed)
        tracemalloc.start()
        with pytest.raises(MovieUnreadable, match=r"m.tif"):
            stack(read_movie(path))
        _, most = tracemalloc.get_traced_memory()
        tracemalloc.stop()
        assert most < 50e6


@pytest.mark.parametrize("shape", [(1, 20, 30), (2, 20, 30), (3, 1, 1), (1, 1, 1), (4, 1, 30), (4, 20, 1)])
def test_tiny_movies_are_read(tmp_path: Path, shape: tuple[int, ...]) -> None:
    frames = np.arange(np.prod(shape)).reshape(shape).astype("uint16")
    tifffile.imwrite(tmp_path / "m.ome.tif", frames, ome=True, metadata={"axes": "TYX"})
    np.testing.assert_array_equal(stack(read_movie(tmp_path / "m.ome.tif")), frames)


def test_a_constant_movie_is_read(tmp_path: Path) -> None:
    tifffile.imwrite(tmp_path / "m.tif", np.full((3, 20, 30), 7, "uint8"), photometric="minisblack")
    assert read_movie(tmp_path / "m.tif").frames[2].min() == 7


def test_one_corrupt_page_is_named(tmp_path: Path) -> None:
    path = tmp_path / "m.tif"
    tifffile.imwrite(path, np.tile(grey(), (1, 8, 8)), compression="zlib", metadata=None)
    with tifffile.TiffFile(path) as tiff:
        start = tiff.pages[3].dataoffsets[0]  # type: ignore[union-attr]
    raw = bytearray(path.read_bytes())
    raw[start:start + 40] = bytes(40)
    path.write_bytes(raw)
    movie = read_movie(path)
    movie.frames[2]
    with pytest.raises(MovieUnreadable, match="frame 3"):
        movie.frames[3]


def test_a_folder_that_vanishes_is_reported(tmp_path: Path) -> None:
    folder = write_micromanager(tmp_path / "Pos0", grey()[:, None], times_s=TIMES)
    movie = read_movie(folder)
    for file in folder.iterdir():
        file.unlink()
    folder.rmdir()
    with pytest.raises(MovieUnreadable, match="can no longer be read"):
        movie.frames[4]


def test_a_frame_that_nd2_does_not_hold_is_refused(tmp_path: Path) -> None:
    pytest.importorskip("nd2")
    path = write_nd2(tmp_path / "m.nd2", grey())
    raw = path.read_bytes()
    path.write_bytes(raw.replace(b"ImageDataSeq|3!", b"ImageDataSeq|9!"))
    movie = read_movie(path)
    with pytest.raises(MovieUnreadable, match=r"frame 3: .*missing"):
        movie.frames[3]


def test_flags_and_formats_have_the_same_names() -> None:
    assert set(opened.FLAGS.values()) <= {f"--reading.{name}" for name in Reading.model_fields}
