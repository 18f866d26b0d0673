"""Finding the tissue: drawn pictures with known tissue, real frames, and the published tool's masks."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import tifffile
from numpy.typing import NDArray

from microbundle.config import MaskParams
from microbundle.data import Masks, Movie
from microbundle.errors import ConfigError, MaskUnusable, NoTissue
from microbundle.mask import find_masks, overlap
from microbundle.threshold import otsu

DATA = os.environ.get("MICROBUNDLE_DATA")
GOLDEN = os.environ.get("MICROBUNDLE_GOLDEN")
needs_data = pytest.mark.skipif(DATA is None, reason="MICROBUNDLE_DATA does not name the folder of real movies")
needs_golden = pytest.mark.skipif(DATA is None or GOLDEN is None,
                                  reason="MICROBUNDLE_DATA and MICROBUNDLE_GOLDEN do not name their folders")

Image = NDArray[Any]
AUTO = MaskParams()


def auto(frames: Image, **more: Any) -> Masks:
    return find_masks(Movie.from_array(frames), AUTO, **more)


# --- drawn pictures -------------------------------------------------------------------------------------------------


def strip(angle_deg: float = 0.0, side: int = 256, length: float = 0.75, width: float = 0.2) -> NDArray[np.bool_]:
    """A strip with a waist, in shares of the picture's side, turned clockwise about its centre."""
    row, col = (np.mgrid[:side, :side] + 0.5) / side - 0.5
    angle = np.deg2rad(angle_deg)
    along = col * np.cos(angle) + row * np.sin(angle)
    across = row * np.cos(angle) - col * np.sin(angle)
    return np.asarray((np.abs(along) < length / 2) & (np.abs(across) < width / 2 * (1 + (2 * along / length) ** 2)))


def dark_movie(tissue: NDArray[np.bool_], count: int = 6, seed: int = 0) -> Image:
    """Dark grainy tissue on bright noisy ground, 16 bits."""
    rng = np.random.default_rng(seed)
    grain = cv2.GaussianBlur(rng.normal(size=tissue.shape), (0, 0), 1.5) * 3000
    picture = np.where(tissue, 18000 + grain, 45000)
    picture = cv2.GaussianBlur(picture, (0, 0), 1)
    return np.clip(picture + rng.normal(0, 800, (count, *tissue.shape)), 0, 65535).astype(np.uint16)


def grainy_movie(tissue: NDArray[np.bool_], seed: int = 0) -> Image:
    """Tissue as bright as its ground, told apart by its grain only."""
    rng = np.random.default_rng(seed)
    grain = cv2.GaussianBlur(rng.normal(size=tissue.shape), (0, 0), 1.0) * 12000
    return np.clip(30000 + grain * tissue + rng.normal(0, 300, (3, *tissue.shape)), 0, 65535).astype(np.uint16)


@pytest.mark.parametrize("angle", [0, 10, 43, 90, 137])
def test_dark_strip_is_found_at_any_angle(angle: float) -> None:
    tissue = strip(angle)
    masks = auto(dark_movie(tissue))
    assert overlap(masks.tissue, tissue) > 0.95
    assert abs((masks.axis.angle_deg - angle + 90) % 180 - 90) < 1
    assert masks.stability is not None
    assert masks.stability > 0.9
    assert masks.findings == ()


@pytest.mark.parametrize("angle", [0, 45])
def test_grainy_strip_is_found(angle: float) -> None:
    masks = auto(grainy_movie(strip(angle)))
    assert masks.method == "texture"
    assert overlap(masks.tissue, strip(angle)) > 0.8


@pytest.mark.parametrize("change", [
    lambda x: (x >> 8).astype(np.uint8), lambda x: x.astype(np.float32) / 65535, lambda x: x.astype(np.float64) - 40000,
    lambda x: x // 8 + 3000, lambda x: 65535 - x, lambda x: x[:1], lambda x: np.asfortranarray(x),
], ids=["uint8", "float", "negative", "offset", "inverted", "one frame", "memory order"])
def test_number_formats_do_not_matter(change: Any) -> None:
    tissue = strip(20)
    assert overlap(auto(change(dark_movie(tissue))).tissue, tissue) > 0.93


@pytest.mark.parametrize("side", [64, 128, 600])
def test_picture_size_does_not_matter(side: int) -> None:
    tissue = strip(30, side)
    assert overlap(auto(dark_movie(tissue, 3)).tissue, tissue) > 0.85


def test_long_picture() -> None:
    tissue = strip(0)[60:196]
    assert overlap(auto(dark_movie(tissue)).tissue, tissue) > 0.93


def test_uneven_light() -> None:
    tissue = strip(0)
    light = np.linspace(0.35, 1, 256)
    assert overlap(auto(dark_movie(tissue) * light).tissue, tissue) > 0.93
    assert overlap(auto(dark_movie(tissue) * light[:, None]).tissue, tissue) > 0.93


@pytest.mark.parametrize("value", [0, 900])
def test_dark_corners_of_a_tilted_picture_are_not_tissue(value: int) -> None:
    tissue = strip(0, length=0.95)
    turn = cv2.getRotationMatrix2D((127.5, 127.5), -6, 1)
    frames = np.stack([cv2.warpAffine(f, turn, (256, 256), borderValue=value) for f in dark_movie(tissue)])
    turned = cv2.warpAffine(tissue.astype(np.uint8), turn, (256, 256)) > 0
    masks = auto(frames)
    assert overlap(masks.tissue, turned) > 0.9
    assert masks.axis.width_center_px == pytest.approx(0.2 * 256, abs=4)


def test_walls_blobs_and_hot_pixel_are_not_tissue() -> None:
    tissue = strip(0)
    dirt = np.zeros_like(tissue)
    dirt[:14] = dirt[-14:] = True
    dirt[40:52, 30:42] = True
    frames = dark_movie(tissue | dirt)
    frames[::2, 60, 200] = 65535
    assert overlap(auto(frames).tissue, tissue) > 0.93


def test_small_holes_are_filled_and_caps_are_left_out() -> None:
    tissue = strip(0, width=0.28)
    row, col = np.mgrid[:256, :256]
    caps = (np.hypot(row - 128, col - 60) < 20) | (np.hypot(row - 128, col - 196) < 20)
    drop = np.hypot(row - 125, col - 128) < 4
    masks = auto(dark_movie(tissue & ~caps & ~drop))
    assert masks.tissue[drop].all()
    assert not masks.tissue[caps].any()
    assert overlap(masks.tissue, tissue & ~caps) > 0.9


REFUSED = {
    "black": np.zeros((3, 80, 90), np.uint16),
    "flat": np.full((3, 80, 90), 700, np.uint16),
    "flat float": np.full((1, 80, 90), 0.3),
    "noise": np.random.default_rng(0).normal(1000, 50, (5, 200, 240)),
    "noise of one frame": np.random.default_rng(1).integers(0, 256, (1, 300, 300), dtype=np.uint8),
    "slope": np.tile(np.arange(256.0), (2, 256, 1)),
    "wall": np.where(np.arange(256)[:, None] < 30, 100.0, 200.0) + np.zeros((2, 1, 256)),
    "tiny": np.arange(64.0).reshape(1, 8, 8),
    "one pixel": np.ones((1, 1, 1)),
    "not a number": np.full((2, 60, 60), np.nan),
}


@pytest.mark.parametrize("frames", REFUSED.values(), ids=REFUSED.keys())
def test_pictures_without_tissue_are_refused(frames: Image) -> None:
    with pytest.raises(NoTissue, match=r"expected .*found .*[Ss]upply a tissue mask"):
        auto(frames)


def test_no_frames_are_refused() -> None:
    with pytest.raises(NoTissue, match="no"):
        auto(np.zeros((0, 40, 40)))


def test_tissue_that_leaves_the_picture_gets_a_finding() -> None:
    masks = auto(dark_movie(strip(0, length=1.2, width=0.15)))
    assert [finding.key for finding in masks.findings] == ["mask_touches_border"]
    assert masks.findings[0].level == "info"


def test_changing_movie_is_unstable() -> None:
    frames = dark_movie(strip(0), count=9)
    frames[:3] = dark_movie(strip(0, width=0.12), count=3)
    stable = auto(frames[3:])
    masks = find_masks(Movie.from_array(frames), MaskParams(min_stability=0.9))
    (finding,) = masks.findings
    assert (finding.key, finding.level, finding.limit) == ("mask_unstable", "review", 0.9)
    assert finding.value == masks.stability
    assert stable.stability is not None
    assert masks.stability is not None
    assert masks.stability < 0.9 < stable.stability


def test_few_frames_are_read_and_one_at_a_time() -> None:
    class Long:
        read = 0
        one = dark_movie(strip(0), 1)[0]

        def __len__(self) -> int:
            return 100_000

        def __getitem__(self, index: int) -> Image:
            self.read += 1
            return self.one

    frames = Long()
    find_masks(Movie("long", frames, (256, 256)), AUTO)
    assert frames.read <= 40


def test_result_does_not_depend_on_the_run_and_frames_stay_as_they_are() -> None:
    frames = dark_movie(strip(15))
    before = frames.copy()
    one, other = auto(frames), auto(frames)
    np.testing.assert_array_equal(one.tissue, other.tissue)
    np.testing.assert_array_equal(frames, before)


def test_given_angle_is_kept() -> None:
    assert auto(dark_movie(strip(0)), axis_deg=12.0).axis.angle_deg == pytest.approx(12)


# --- supplied masks -------------------------------------------------------------------------------------------------


def test_supplied_mask_is_taken_as_it_is() -> None:
    mine = strip(0, width=0.1)
    masks = find_masks(Movie.from_array(dark_movie(strip(0)), tissue_mask=mine), AUTO)
    np.testing.assert_array_equal(masks.tissue, mine)
    assert masks.tissue is not mine
    assert (masks.method, masks.stability) == ("supplied", None)
    assert masks.findings[0].key == "mask_supplied"


def test_other_methods_ignore_the_supplied_mask() -> None:
    movie = Movie.from_array(dark_movie(strip(0)), tissue_mask=strip(0, width=0.1))
    assert find_masks(movie, MaskParams(method="otsu")).method == "otsu"


def test_empty_supplied_mask_is_refused() -> None:
    movie = Movie.from_array(np.ones((1, 40, 40)), tissue_mask=np.zeros((40, 40), bool))
    with pytest.raises(MaskUnusable, match="marks no pixel"):
        find_masks(movie, AUTO)


# --- the paper's methods --------------------------------------------------------------------------------------------


@pytest.mark.parametrize("method", ["otsu", "minimum", "maximum"])
def test_paper_methods_find_a_dark_strip(method: Any) -> None:
    masks = find_masks(Movie.from_array(dark_movie(strip(0))), MaskParams(method=method))
    assert overlap(masks.tissue, strip(0)) > 0.9
    assert masks.method == method
    assert masks.stability is not None
    assert masks.stability > 0.8


def test_paper_method_on_a_blank_frame_or_a_missing_one() -> None:
    with pytest.raises(NoTissue, match="otsu"):
        find_masks(Movie.from_array(np.ones((2, 40, 40), np.uint8)), MaskParams(method="otsu"))
    with pytest.raises(ConfigError, match="2 frames"):
        find_masks(Movie.from_array(dark_movie(strip(0), 2)), MaskParams(method="sobel", frame=2))


def test_otsu() -> None:
    assert otsu(np.array([3, 3, 4, 9, 10, 10], np.uint8)) == 4
    assert otsu(np.array([-5, -5, 2**40, 2**40])) < 2**40
    values = np.concatenate([np.random.default_rng(0).normal(m, 1, 5000) for m in (0, 10)])
    assert np.count_nonzero(values > otsu(values)) == pytest.approx(5000, abs=5)
    assert otsu(values, 0.1) - otsu(values) == pytest.approx(1, abs=0.05)
    with pytest.raises(ValueError, match="different"):
        otsu(np.ones(5))


def test_overlap() -> None:
    one = np.array([[True, True, False]])
    assert overlap(one, one) == 1
    assert overlap(one, ~one) == 0
    assert overlap(one & ~one, one & ~one) == 0


# --- real frames ----------------------------------------------------------------------------------------------------


class Files:
    """Frames of a folder, decoded on demand."""

    def __init__(self, folder: Path) -> None:
        self.paths = sorted(p for p in folder.iterdir() if p.suffix.lower() in (".tif", ".tiff"))

    def __len__(self) -> int:
        return len(self.paths)

    def __getitem__(self, index: int) -> Image:
        return np.asarray(tifffile.imread(self.paths[index]))


def real(name: str, stop: int | None = None) -> Movie:
    files = Files(Path(str(DATA)) / name / "movie")
    files.paths = files.paths[:stop]
    return Movie(name, files, files[0].shape)  # type: ignore[arg-type]


def single(name: str) -> Image:
    return np.asarray(tifffile.imread(Path(str(DATA)) / "single_frames" / f"{name}.tif"))


def turned(image: Image, angle_deg: float, border: int) -> Image:
    rows, cols = image.shape
    turn = cv2.getRotationMatrix2D(((cols - 1) / 2, (rows - 1) / 2), -angle_deg, 1)
    return np.asarray(cv2.warpAffine(image, turn, (cols, rows), borderMode=border))


@needs_data
def test_bright_movie() -> None:
    masks = find_masks(real("type1_bright"), AUTO)
    drawn = np.loadtxt(Path(str(DATA)) / "type1_bright" / "masks" / "tissue_mask.txt") > 0
    assert overlap(masks.tissue, drawn) > 0.85
    assert 105 <= masks.axis.width_center_px <= 120
    assert abs(masks.axis.angle_deg) < 1
    assert masks.stability is not None
    assert masks.stability > 0.9


@needs_data
def test_dark_movie() -> None:
    masks = find_masks(real("type1_dark"), AUTO)
    assert 145 <= masks.axis.width_center_px <= 165
    assert abs(masks.axis.angle_deg) < 2


@needs_data
@pytest.mark.parametrize(("name", "angle", "width"), [("type1", 0.0, (150, 170)), ("type2", -44.5, (95, 120))])
@pytest.mark.parametrize("turn", [10, 43, 90, 137])
@pytest.mark.parametrize("border", [cv2.BORDER_CONSTANT, cv2.BORDER_REPLICATE], ids=["black", "edge"])
def test_single_frames_at_any_angle(name: str, angle: float, width: tuple[float, float], turn: int,
                                    border: int) -> None:
    masks = auto(turned(single(name), turn, border)[None])
    assert abs((masks.axis.angle_deg - angle - turn + 90) % 180 - 90) < 3
    assert width[0] <= masks.axis.width_center_px <= width[1]


@needs_data
@pytest.mark.parametrize("scale", [0.5, 2])
@pytest.mark.parametrize(("name", "width"), [("type1", 160), ("type2", 110)])
def test_single_frames_at_other_sizes(name: str, width: float, scale: float) -> None:
    frame = cv2.resize(single(name), None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
    assert auto(frame[None]).axis.width_center_px == pytest.approx(width * scale, rel=0.08)


@needs_data
@pytest.mark.parametrize("name", ["type1_fail", "type2_fail"])
@pytest.mark.parametrize("lifted", [0, 100])
@pytest.mark.parametrize(("turn", "border"), [(0, cv2.BORDER_CONSTANT), (20, cv2.BORDER_CONSTANT),
                                              (43, cv2.BORDER_CONSTANT), (43, cv2.BORDER_REPLICATE)])
def test_frames_that_show_no_tissue_are_refused(name: str, lifted: int, turn: int, border: int) -> None:
    frame = np.minimum(single(name), 65535 - lifted) + np.uint16(lifted)
    with pytest.raises(NoTissue, match="upply a tissue mask"):
        auto(turned(frame, turn, border)[None])


def test_blank_frames_are_refused_for_what_they_are() -> None:
    with pytest.raises(NoTissue, match="one single brightness"):
        auto(np.full((3, 64, 64), 500, np.uint16))


@needs_golden
@pytest.mark.parametrize(("method", "key"), [("otsu", "seg1"), ("sobel", "seg2"), ("minimum", "seg3")])
def test_paper_methods_match_the_published_tool(method: Any, key: str) -> None:
    masks = find_masks(real("type1_bright", 76), MaskParams(method=method))
    golden = np.load(Path(str(GOLDEN)) / "mbc_masks.npz")[key] > 0
    assert overlap(masks.tissue, golden) >= 0.999
