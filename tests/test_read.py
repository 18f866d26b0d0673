"""Reading: every kind of file and folder a movie comes in, what is taken from it, and what is refused and how."""

from __future__ import annotations

import hashlib
import shutil
import tracemalloc
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tifffile
from numpy.typing import NDArray

from microbundle.config import Reading
from microbundle.data import Movie
from microbundle.errors import MovieUnreadable
from microbundle.formats.grey import luminance
from microbundle.read import CACHE_BYTES, Cached, content_hash, prepare, read_movie

Image = NDArray[Any]
SHAPE = (20, 30)


def noise(count: int = 6, dtype: str = "uint16", seed: int = 0) -> Image:
    return np.random.default_rng(seed).integers(0, 200, (count, *SHAPE)).astype(dtype)


def write(folder: Path, frames: Image, names: list[str] | None = None, **options: Any) -> Path:
    folder.mkdir(parents=True, exist_ok=True)
    for name, frame in zip(names or [f"f{i:03}.tif" for i in range(len(frames))], frames, strict=True):
        tifffile.imwrite(folder / name, frame, **options)
    return folder


def stack(movie: Movie) -> Image:
    return np.stack([movie.frames[t] for t in range(movie.count)])


def keys(movie: Movie) -> list[str]:
    return [finding.key for finding in movie.findings]


def refused(path: Path, **options: Any) -> str:
    """The message with which a movie is refused, when it is opened or when its frames are read."""
    with pytest.raises(MovieUnreadable) as caught:
        stack(read_movie(path, **options))
    message = str(caught.value)
    assert "\n" not in message
    assert message.startswith(str(path))
    return message


# --- folders --------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("ending", ["tif", "TIF", "tiff", "TIFF", "Tif"])
def test_extension_may_have_any_case(tmp_path: Path, ending: str) -> None:
    frames = noise(3)
    movie = read_movie(write(tmp_path / "m", frames, [f"{i}.{ending}" for i in range(3)]))
    np.testing.assert_array_equal(stack(movie), frames)
    assert (movie.count, movie.shape, movie.name) == (3, SHAPE, "m")
    assert movie.findings == ()


def test_frames_come_in_natural_order(tmp_path: Path) -> None:
    frames = noise(12)
    movie = read_movie(write(tmp_path, frames, [f"ex{i}.tif" for i in range(1, 13)]))
    np.testing.assert_array_equal(stack(movie), frames)
    assert [f.name for f in movie.files][:3] == ["ex1.tif", "ex2.tif", "ex3.tif"]


def test_order_does_not_hang_on_case_or_leading_zeros(tmp_path: Path) -> None:
    names = ["B_001.tif", "b_1.tif", "b_02.TIF", "B_3.tif"]
    movie = read_movie(write(tmp_path, noise(4), names))
    assert [f.name for f in movie.files] == names


def test_movie_subfolder_is_the_movie_and_names_it(tmp_path: Path) -> None:
    frames = noise(3)
    write(tmp_path / "well A1" / "movie", frames)
    (tmp_path / "well A1" / "notes.txt").write_text("x")
    for path in (tmp_path / "well A1", tmp_path / "well A1" / "movie"):
        movie = read_movie(path)
        np.testing.assert_array_equal(stack(movie), frames)
        assert movie.name == "well A1"


def test_hidden_and_other_files_and_folders_are_passed_over(tmp_path: Path) -> None:
    write(tmp_path, noise(2))
    (tmp_path / "._f000.tif").write_bytes(b"\0\5\x16\7")
    (tmp_path / "readme.txt").write_text("x")
    (tmp_path / "old.tif").mkdir()
    assert read_movie(tmp_path).count == 2


def test_unicode_and_spaces_in_paths(tmp_path: Path) -> None:
    folder = write(tmp_path / "Gewebe µ 組織", noise(2), ["bild é 1.tif", "bild é 2.tif"])
    assert read_movie(str(folder)).count == 2
    file = tmp_path / "ein film ö.tif"
    tifffile.imwrite(file, noise(4))
    assert read_movie(file).name == "ein film ö"


def test_gaps_in_the_numbers_are_reported(tmp_path: Path) -> None:
    movie = read_movie(write(tmp_path, noise(5), [f"f_{i}.tif" for i in (1, 2, 3, 6, 7)]))
    assert keys(movie) == ["frames_missing"]
    assert "f_3.tif" in movie.findings[0].message
    assert movie.findings[0].level == "review"


@pytest.mark.parametrize("numbers", [(1, 2, 3, 4), (0, 10, 20, 30), (7, 8)])
def test_regular_numbers_are_not_reported(tmp_path: Path, numbers: tuple[int, ...]) -> None:
    movie = read_movie(write(tmp_path, noise(len(numbers)), [f"run2_f{i}.tif" for i in numbers]))
    assert movie.findings == ()


def test_files_of_two_movies_in_a_folder_are_reported(tmp_path: Path) -> None:
    movie = read_movie(write(tmp_path, noise(4), ["a_1.tif", "a_2.tif", "b_1.tif", "b_2.tif"]))
    assert keys(movie) == ["names_differ"]
    assert "a_#, b_#" in movie.findings[0].message


def test_one_multi_page_file_in_a_folder_is_the_movie(tmp_path: Path) -> None:
    frames = noise(5)
    tifffile.imwrite(tmp_path / "all.tif", frames)
    np.testing.assert_array_equal(stack(read_movie(tmp_path)), frames)


def test_one_frame_is_a_movie(tmp_path: Path) -> None:
    frames = noise(1)
    assert read_movie(write(tmp_path / "m", frames)).count == 1
    assert read_movie(tmp_path / "m" / "f000.tif").count == 1


# --- kinds of numbers and colour ------------------------------------------------------------------------------------


@pytest.mark.parametrize("dtype", ["uint8", "uint16", "uint32", "int8", "int16", "int32", "float16", "float32",
                                   "float64"])
@pytest.mark.parametrize("order", ["<", ">"])
def test_every_number_type_is_kept(tmp_path: Path, dtype: str, order: str) -> None:
    frames = (noise(3, "int64") - (100 if dtype.startswith(("int", "float")) else 0)).astype(dtype)
    movie = read_movie(write(tmp_path / "folder", frames, byteorder=order))
    tifffile.imwrite(tmp_path / "pages.tif", frames, byteorder=order, photometric="minisblack")
    for found in (stack(movie), stack(read_movie(tmp_path / "pages.tif"))):
        np.testing.assert_array_equal(found, frames)
        assert found.dtype == np.dtype(dtype)


def test_twelve_bits_in_sixteen_are_kept(tmp_path: Path) -> None:
    frames = noise(2) * 20 + 95
    np.testing.assert_array_equal(stack(read_movie(write(tmp_path, frames))), frames)


@pytest.mark.parametrize("channels", [3, 4])
@pytest.mark.parametrize("planes", ["contig", "separate"])
@pytest.mark.parametrize("in_one_file", [False, True])
def test_colour_becomes_luminance_with_a_finding(tmp_path: Path, channels: int, planes: str, in_one_file: bool) -> None:
    rng = np.random.default_rng(1)
    colour = rng.integers(0, 255, (4, *SHAPE, channels)).astype("uint8")
    arranged = colour if planes == "contig" else np.moveaxis(colour, -1, 1)
    options: dict[str, Any] = {"photometric": "rgb", "planarconfig": planes}
    if channels == 4:
        options["extrasamples"] = ["unassalpha"]
    path = tmp_path / "movie.tif"
    if in_one_file:
        with tifffile.TiffWriter(path) as file:
            for frame in arranged:
                file.write(frame, contiguous=False, metadata=None, **options)
    else:
        path = write(tmp_path / "m", arranged, **options)
    movie = read_movie(path)
    expected = np.rint(colour[..., :3] @ [0.299, 0.587, 0.114]).astype("uint8")
    np.testing.assert_array_equal(stack(movie), expected)
    assert keys(movie) == ["colour_converted"]


def test_grey_that_is_stored_as_colour_keeps_its_numbers() -> None:
    grey = noise(1, "uint16")[0]
    np.testing.assert_array_equal(luminance(np.stack([grey] * 3, axis=-1)), grey)


# --- multi-page files and calibration -------------------------------------------------------------------------------


def test_multi_page_file_gives_its_pages(tmp_path: Path) -> None:
    frames = noise(7)
    tifffile.imwrite(tmp_path / "a.tif", frames)
    with tifffile.TiffWriter(tmp_path / "b.tif", bigtiff=True) as file:
        for frame in frames:
            file.write(frame, contiguous=False, compression="zlib", metadata=None)
    tifffile.imwrite(tmp_path / "c.tif", frames, truncate=True)  # one page is listed, as ImageJ does beyond 4 GB
    for name in "abc":
        movie = read_movie(tmp_path / f"{name}.tif")
        np.testing.assert_array_equal(stack(movie), frames)
        assert (movie.time_source, movie.um_per_px_source) == ("unknown", "unknown")


def test_a_preview_page_is_passed_over(tmp_path: Path) -> None:
    with tifffile.TiffWriter(tmp_path / "m.tif") as file:
        for frame in noise(4):
            file.write(frame, contiguous=False, metadata=None)
        file.write(noise(1)[0][::4, ::4], subfiletype=1, metadata=None)
    assert read_movie(tmp_path / "m.tif").count == 4


def test_print_resolution_is_not_taken_for_the_pixel_size(tmp_path: Path) -> None:
    tifffile.imwrite(tmp_path / "m.tif", noise(), resolution=(72, 72), resolutionunit="INCH")
    tifffile.imwrite(tmp_path / "cm.tif", noise(), imagej=True, resolution=(118, 118), metadata={"unit": "cm"})
    for name in ("m", "cm"):
        movie = read_movie(tmp_path / f"{name}.tif")
        assert (movie.um_per_px, movie.um_per_px_source) == (None, "unknown")
        assert movie.time_s is None


@pytest.mark.parametrize(("size", "unit", "um"), [(0.65, "µm", 0.65), (650, "nm", 0.65), (0.00065, "mm", 0.65),
                                                  (2, "pixel", None), (0, "µm", None)])
@pytest.mark.parametrize(("step", "time_unit", "s"), [(0.04, "s", 0.04), (40, "ms", 0.04), (40000, "µs", 0.04),
                                                      (1, "frame", None), (0, "s", None)])
def test_ome_gives_pixel_size_and_time(tmp_path: Path, size: float, unit: str, um: float | None, step: float,
                                       time_unit: str, s: float | None) -> None:
    tifffile.imwrite(tmp_path / "m.ome.tif", noise(), ome=True, metadata={
        "axes": "TYX", "PhysicalSizeX": size, "PhysicalSizeY": size, "PhysicalSizeXUnit": unit,
        "PhysicalSizeYUnit": unit, "TimeIncrement": step, "TimeIncrementUnit": time_unit})
    movie = read_movie(tmp_path / "m.ome.tif")
    assert movie.name == "m"
    assert movie.um_per_px == (None if um is None else pytest.approx(um))
    assert movie.um_per_px_source == ("unknown" if um is None else "file")
    assert movie.time_source == ("unknown" if s is None else "file")
    if s is not None:
        np.testing.assert_allclose(movie.time_s, np.arange(6) * s)
    assert movie.findings == ()


def test_ome_time_stamps_win_over_the_increment(tmp_path: Path) -> None:
    stamps = [10.0, 60.0, 110.0, 210.0, 260.0, 310.0]
    tifffile.imwrite(tmp_path / "m.ome.tif", noise(), ome=True, metadata={
        "axes": "TYX", "TimeIncrement": 1.0, "Plane": {"DeltaT": stamps, "DeltaTUnit": ["ms"] * 6}})
    np.testing.assert_allclose(read_movie(tmp_path / "m.ome.tif").time_s, (np.array(stamps) - 10) / 1000)


def test_ome_pixels_that_are_not_square_give_no_size_but_a_finding(tmp_path: Path) -> None:
    tifffile.imwrite(tmp_path / "m.ome.tif", noise(), ome=True, metadata={
        "axes": "TYX", "PhysicalSizeX": 1.0, "PhysicalSizeY": 2.0})
    movie = read_movie(tmp_path / "m.ome.tif")
    assert movie.um_per_px is None
    assert keys(movie) == ["pixels_not_square"]


def test_imagej_gives_interval_and_size(tmp_path: Path) -> None:
    for unit, name in (("um", "a"), ("micron", "b"), ("\\u00B5m", "c")):
        tifffile.imwrite(tmp_path / f"{name}.tif", noise(), imagej=True, resolution=(0.25, 0.25),
                         metadata={"axes": "TYX", "finterval": 0.05, "unit": unit})
        movie = read_movie(tmp_path / f"{name}.tif")
        assert movie.um_per_px == pytest.approx(4)
        np.testing.assert_allclose(movie.time_s, np.arange(6) * 0.05)
        assert (movie.time_source, movie.um_per_px_source) == ("file", "file")


def test_imagej_playing_speed_is_not_taken_for_the_frame_rate(tmp_path: Path) -> None:
    tifffile.imwrite(tmp_path / "m.tif", noise(), imagej=True, metadata={"axes": "TYX", "fps": 7.0})
    assert read_movie(tmp_path / "m.tif").time_s is None


def test_imagej_planes_are_taken_as_time_with_a_note(tmp_path: Path) -> None:
    tifffile.imwrite(tmp_path / "m.tif", noise(), imagej=True, metadata={"axes": "ZYX"})
    movie = read_movie(tmp_path / "m.tif")
    assert (movie.count, keys(movie)) == (6, ["z_as_time"])


def test_folder_of_calibrated_frames_is_calibrated(tmp_path: Path) -> None:
    folder = write(tmp_path, noise(3), [f"{i}.ome.tif" for i in range(3)], ome=True, metadata={
        "axes": "YX", "PhysicalSizeX": 0.5, "PhysicalSizeY": 0.5, "TimeIncrement": 20, "TimeIncrementUnit": "ms"})
    movie = read_movie(folder)
    assert (movie.count, movie.um_per_px) == (3, pytest.approx(0.5))
    np.testing.assert_allclose(movie.time_s, [0, 0.02, 0.04])


def test_the_user_wins_over_the_file(tmp_path: Path) -> None:
    tifffile.imwrite(tmp_path / "m.ome.tif", noise(), ome=True, metadata={
        "axes": "TYX", "PhysicalSizeX": 0.5, "PhysicalSizeY": 0.5, "TimeIncrement": 0.1})
    movie = read_movie(tmp_path / "m.ome.tif", fps=20, um_per_px=0.9)
    assert (movie.um_per_px, movie.um_per_px_source, movie.time_source) == (0.9, "user", "user")
    np.testing.assert_allclose(movie.time_s, np.arange(6) / 20)


@pytest.mark.parametrize("value", [0, -1, float("nan"), float("inf")])
@pytest.mark.parametrize("name", ["fps", "um_per_px"])
def test_calibration_must_be_positive(tmp_path: Path, name: str, value: float) -> None:
    write(tmp_path, noise(2))
    with pytest.raises(MovieUnreadable, match=f"{name}: expected a positive number"):
        read_movie(tmp_path, **{name: value})


# --- decoding on demand ---------------------------------------------------------------------------------------------


class Counting:
    """Frames of one size that count how often they are made."""

    def __init__(self, count: int, side: int) -> None:
        self.count, self.side, self.made = count, side, 0

    def __len__(self) -> int:
        return self.count

    def __getitem__(self, index: int) -> Image:
        self.made += 1
        return np.full((self.side, self.side), index, np.uint16)


def test_opening_reads_only_the_first_frame(tmp_path: Path) -> None:
    write(tmp_path, noise(5))
    (tmp_path / "f004.tif").write_bytes(b"damaged")
    movie = read_movie(tmp_path)
    movie.frames[3]
    with pytest.raises(MovieUnreadable, match=r"f004.tif"):
        movie.frames[4]


def test_memory_is_bounded_whatever_the_length() -> None:
    frames = Counting(400, 512)  # 200 MB in all
    tracemalloc.start()
    cached = Cached(frames)
    for t in range(len(cached)):
        cached[t]
    held, _ = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert held < 1.1 * CACHE_BYTES


def test_memory_is_bounded_by_the_crop() -> None:
    movie = Movie("m", Counting(2000, 256), (256, 256))
    tracemalloc.start()
    cropped = prepare(movie, Reading(crop_px=(0, 16, 0, 256)))
    for t in range(cropped.count):
        cropped.frames[t]
    held, _ = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert held < 2 * cropped.count * 16 * 256 * 2


def test_short_movies_are_decoded_once() -> None:
    frames = Counting(20, 64)
    cached = Cached(frames)
    for _ in range(3):
        assert [int(cached[t][0, 0]) for t in range(20)] == list(range(20))
    assert frames.made <= 21
    assert cached[-1] is cached[19]


def test_frames_are_a_sequence_and_cannot_be_written_to(tmp_path: Path) -> None:
    tifffile.imwrite(tmp_path / "m.tif", noise(5))
    movie = read_movie(tmp_path / "m.tif")
    assert len(list(movie.frames)) == 5  # type: ignore[call-overload]
    with pytest.raises(IndexError, match="frame 5 is not one of the 5 frames"):
        movie.frames[5]
    with pytest.raises(ValueError, match="read-only"):
        movie.frames[0][0, 0] = 1


# --- preprocessing --------------------------------------------------------------------------------------------------


def test_crop_and_time_window_keep_the_true_times() -> None:
    frames = noise(10)
    mask = np.ones(SHAPE, bool)
    movie = Movie.from_array(frames, fps=10, tissue_mask=mask)
    part = prepare(movie, Reading(crop_px=(2, 12, 5, 25), first_frame=3, stop_frame=8))
    np.testing.assert_array_equal(stack(part), frames[3:8, 2:12, 5:25])
    np.testing.assert_allclose(part.time_s, np.arange(3, 8) / 10)
    assert part.shape == (10, 20)
    assert part.supplied_masks["tissue"].shape == (10, 20)


def test_without_settings_nothing_is_done() -> None:
    movie = Movie.from_array(noise(4))
    assert prepare(movie, Reading()) is movie


@pytest.mark.parametrize("dtype", ["uint8", "uint16", "uint32", "int16", "float32"])
def test_filters_keep_the_number_type_and_its_limits(dtype: str) -> None:
    frames = noise(2).astype(dtype)
    if np.issubdtype(frames.dtype, np.integer):
        frames[0, 3:6, 3:6] = np.iinfo(dtype).max
        frames[0, 8, 8] = np.iinfo(dtype).min
    for reading in (Reading(sharpen=2), Reading(smooth_px=1.5), Reading(kernel=((0, 0, 0), (0, 1, 0), (0, 0, 0)))):
        made = stack(prepare(Movie.from_array(frames), reading))
        assert made.dtype == frames.dtype
        if reading.kernel is not None:
            np.testing.assert_array_equal(made, frames)
        if reading.smooth_px:
            assert made[0].astype(float).std() < frames[0].astype(float).std()
        if reading.sharpen:
            assert made[1].astype(float).std() > frames[1].astype(float).std()


def test_kernel_is_not_mirrored() -> None:
    frame = np.zeros((1, 9, 9), "uint8")
    frame[0, 4, 4] = 10
    moved = stack(prepare(Movie.from_array(frame), Reading(kernel=((0, 0, 0), (1, 0, 0), (0, 0, 0)))))
    assert moved[0, 4, 5] == 10


def test_flashes_are_dropped_and_the_other_times_stay() -> None:
    frames = np.stack([np.full(SHAPE, 1000, "uint16")] * 40)
    frames += np.random.default_rng(3).integers(0, 4, (40, 1, 1)).astype("uint16")
    frames[[7, 23]] += 400
    movie = prepare(Movie.from_array(frames, fps=10), Reading(drop_flashes=True))
    kept = np.setdiff1d(np.arange(40), [7, 23])
    np.testing.assert_array_equal(stack(movie), frames[kept])
    np.testing.assert_allclose(movie.time_s, kept / 10)
    assert [(f.key, f.level, f.value) for f in movie.findings] == [("flashes_dropped", "info", 2.0)]
    untimed = prepare(Movie.from_array(frames), Reading(drop_flashes=True))
    assert untimed.findings[0].level == "review"


def test_a_steady_movie_has_no_flashes(tissue_movie: Movie) -> None:
    assert prepare(tissue_movie, Reading(drop_flashes=True)).count == tissue_movie.count


def test_crop_and_window_outside_the_movie_are_refused() -> None:
    movie = Movie.from_array(noise(4), name="small")
    with pytest.raises(MovieUnreadable, match=r"small: expected a crop inside 20 x 30 px; found \(0, 21, 0, 5\)"):
        prepare(movie, Reading(crop_px=(0, 21, 0, 5)))
    with pytest.raises(MovieUnreadable, match=r"small: expected first_frame below 4.*found 4"):
        prepare(movie, Reading(first_frame=4))


# --- the user's files -----------------------------------------------------------------------------------------------


def test_files_are_never_changed(tissue_folder: Path) -> None:
    def state() -> dict[str, tuple[str, int]]:
        return {str(f): (hashlib.sha256(f.read_bytes()).hexdigest(), f.stat().st_mtime_ns)
                for f in tissue_folder.rglob("*") if f.is_file()}

    before = state()
    movie = read_movie(tissue_folder)
    stack(prepare(movie, Reading(crop_px=(5, 100, 5, 100), sharpen=1, drop_flashes=True)))
    content_hash(movie)
    assert state() == before


def test_content_hash_follows_names_and_contents_not_the_place(tmp_path: Path) -> None:
    frames = noise(3)
    one, same = (read_movie(write(tmp_path / name, frames)) for name in "ab")
    other = read_movie(write(tmp_path / "c", noise(3, seed=1)))
    assert content_hash(one) == content_hash(same) != content_hash(other)
    assert content_hash(Movie.from_array(frames)) == ""
    (tmp_path / "a" / "f001.tif").unlink()
    with pytest.raises(MovieUnreadable, match=r"f001.tif: the file can no longer be read"):
        content_hash(one)


# --- real movies ----------------------------------------------------------------------------------------------------


def test_real_movies_open_with_their_masks(data_folder: Path, tmp_path: Path) -> None:
    bright = read_movie(data_folder / "type1_bright")
    assert (bright.count, bright.shape, bright.name) == (100, (512, 512), "type1_bright")
    assert sorted(bright.supplied_masks) == ["pillar_1", "pillar_2", "tissue"]
    assert bright.files[0].name == "ex1_0001.TIF" or bright.files[0].name.endswith("0000.TIF")
    assert (bright.time_s, bright.um_per_px, bright.findings) == (None, None, ())
    assert read_movie(data_folder / "type1_dark").count == 51
    shutil.copy(data_folder / "single_frames" / "type2.tif", tmp_path / "one.tif")
    assert read_movie(tmp_path / "one.tif").shape == (728, 728)
