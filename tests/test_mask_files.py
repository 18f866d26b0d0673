"""Masks that a person or another program made: every kind of file, and what is wrong with a bad one."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import tifffile
from numpy.typing import NDArray

from microbundle.errors import MaskUnusable
from microbundle.mask_files import find_supplied_masks, polygon_mask, read_mask
from microbundle.read import read_movie

SHAPE = (20, 30)
MASK = np.zeros(SHAPE, bool)
MASK[5:15, 8:25] = True


def write(file: Path, values: NDArray[Any]) -> Path:
    """Write a mask in the format of the file's ending."""
    file.parent.mkdir(parents=True, exist_ok=True)
    match file.suffix.lower():
        case ".txt":
            np.savetxt(file, values, fmt="%g")
        case ".tif" | ".tiff":
            tifffile.imwrite(file, values)
        case ending:
            file.write_bytes(cv2.imencode(ending.lower(), values)[1].tobytes())
    return file


@pytest.mark.parametrize("ending", ["txt", "TXT", "png", "PNG", "bmp", "tif", "tiff"])
@pytest.mark.parametrize("high", [1, 255])
def test_two_valued_files_give_the_mask(tmp_path: Path, ending: str, high: int) -> None:
    file = write(tmp_path / f"Maske ü.{ending}", MASK.astype("uint8") * high)
    found = read_mask(str(file), SHAPE)
    np.testing.assert_array_equal(found, MASK)
    assert found.dtype == np.bool_


@pytest.mark.parametrize("ending", ["png", "tif"])
@pytest.mark.parametrize("high", [1, 65535])
def test_sixteen_bit_pictures_give_the_mask(tmp_path: Path, ending: str, high: int) -> None:
    file = write(tmp_path / f"m.{ending}", MASK.astype("uint16") * high)
    np.testing.assert_array_equal(read_mask(file, SHAPE), MASK)


def test_black_and_white_in_colour_and_bool_give_the_mask(tmp_path: Path) -> None:
    colour = np.stack([MASK.astype("uint8") * 255] * 3, axis=-1)
    np.testing.assert_array_equal(read_mask(write(tmp_path / "m.png", colour), SHAPE), MASK)
    np.testing.assert_array_equal(read_mask(write(tmp_path / "m.tif", colour), SHAPE), MASK)
    np.testing.assert_array_equal(read_mask(write(tmp_path / "b.tif", MASK), SHAPE), MASK)


def test_text_with_decimals_and_a_byte_order_mark(tmp_path: Path) -> None:
    file = tmp_path / "m.txt"
    np.savetxt(file, MASK.astype(float), encoding="utf-8-sig")
    file.write_bytes(b"\xef\xbb\xbf" + file.read_bytes().removeprefix(b"\xef\xbb\xbf"))
    np.testing.assert_array_equal(read_mask(file, SHAPE), MASK)


def test_a_mask_of_everything_is_a_mask(tmp_path: Path) -> None:
    assert read_mask(write(tmp_path / "m.txt", np.ones(SHAPE)), SHAPE).all()


# --- polygons -------------------------------------------------------------------------------------------------------

CORNERS = [[5, 8], [5, 24], [14, 24], [14, 8]]


@pytest.mark.parametrize(("name", "text"), [
    ("p.json", json.dumps(CORNERS)),
    ("p.csv", "row,col\n" + "\n".join(f"{r},{c}" for r, c in CORNERS)),
    ("p.CSV", "\ufeffCol,Row\n" + "\n".join(f"{c},{r}" for r, c in CORNERS)),
    ("named.csv", "name,row,col\n" + "\n".join(f"a,{r}.0,{c}.0" for r, c in CORNERS)),
])
def test_polygon_is_filled_with_its_edge(tmp_path: Path, name: str, text: str) -> None:
    (tmp_path / name).write_text(text, encoding="utf-8")
    np.testing.assert_array_equal(read_mask(tmp_path / name, SHAPE), MASK)


def test_polygon_may_leave_the_frame() -> None:
    found = polygon_mask(np.array([[-50.0, 8], [-50, 24], [14, 24], [14, 8]]), SHAPE)
    expected = np.zeros(SHAPE, bool)
    expected[:15, 8:25] = True
    np.testing.assert_array_equal(found, expected)


@pytest.mark.parametrize(("name", "text", "said"), [
    ("a.json", "[[1, 2], [3, 4]]", "at least three (row, col) points; found shape (2, 2)"),
    ("b.json", "[[1, 2], [3, 4", "expected a mask as text (0/1), picture, or polygon"),
    ("c.json", '{"row": 1}', "expected a mask as text (0/1), picture, or polygon"),
    ("d.json", "[[1, 2], [3, null], [5, 6]]", "polygon: expected numbers"),
    ("d2.json", "[[1, 2], [3, 1e300], [5, 6]]", "coordinates in pixels"),
    ("e.csv", "x,y\n1,2\n3,4\n5,6", "expected the columns row and col; found x, y"),
    ("f.csv", "row,col\n1,2\n3,\n5,6", "polygon: expected numbers"),
    ("g.csv", "row,col\n1,2", "at least three"),
    ("h.csv", "", "polygon"),
    ("i.json", "[[100, 100], [100, 120], [120, 120]]", "expected some pixels in the mask; it is empty"),
])
@pytest.mark.filterwarnings("error")
def test_bad_polygons_are_refused(tmp_path: Path, name: str, text: str, said: str) -> None:
    (tmp_path / name).write_text(text, encoding="utf-8")
    assert said in refused(tmp_path / name)


# --- what is refused ------------------------------------------------------------------------------------------------


def refused(file: Path) -> str:
    with pytest.raises(MaskUnusable) as caught:
        read_mask(file, SHAPE)
    message = str(caught.value)
    assert message.startswith(str(file))
    assert "\n" not in message
    return message


@pytest.mark.parametrize("values", [(0, 0.7), (0, 2), (0, 1, 255), (1, 255), (-1, 0), (0, 1, 2), (0, float("nan"))])
def test_other_values_are_refused_and_shown(tmp_path: Path, values: tuple[float, ...]) -> None:
    array = np.resize(np.array(values, float), SHAPE)
    assert "expected a mask of 0 and 1, or 0 and 255; found the values" in refused(write(tmp_path / "m.txt", array))


def test_a_photograph_is_refused(tmp_path: Path) -> None:
    picture = np.random.default_rng(0).integers(0, 255, SHAPE).astype("uint8")
    assert ", ..." in refused(write(tmp_path / "m.png", picture))


@pytest.mark.parametrize("ending", ["txt", "png", "tif"])
def test_another_shape_is_refused(tmp_path: Path, ending: str) -> None:
    file = write(tmp_path / f"m.{ending}", MASK.T.astype("uint8"))
    assert "expected a mask of 20 x 30 px like the frames; found 30 x 20" in refused(file)


@pytest.mark.parametrize("ending", ["txt", "png", "tif"])
def test_an_empty_mask_is_refused(tmp_path: Path, ending: str) -> None:
    assert "it is empty" in refused(write(tmp_path / f"m.{ending}", np.zeros(SHAPE, "uint8")))


@pytest.mark.parametrize("name", ["m.txt", "m.png", "m.tif", "m.csv", "m.json", "m"])
@pytest.mark.filterwarnings("error")
def test_missing_and_empty_files_and_folders_are_refused(tmp_path: Path, name: str) -> None:
    assert "the mask cannot be read: No such file" in refused(tmp_path / "nowhere" / name)
    (tmp_path / name).write_bytes(b"")
    refused(tmp_path / name)
    (tmp_path / "folder" / name).mkdir(parents=True)
    refused(tmp_path / "folder" / name)


@pytest.mark.parametrize("name", ["m.txt", "m.png", "m.tif", "m.csv", "m.json"])
def test_rubbish_is_refused(tmp_path: Path, name: str) -> None:
    (tmp_path / name).write_bytes(bytes(range(256)))
    refused(tmp_path / name)


def test_a_stack_of_masks_is_refused(tmp_path: Path) -> None:
    assert "expected a 2-D mask" in refused(write(tmp_path / "m.tif", np.stack([MASK.astype("uint8")] * 5)))


# --- the paper's folder ---------------------------------------------------------------------------------------------


@pytest.fixture
def movie(tmp_path: Path) -> Path:
    """A movie of one frame in the paper's layout, with masks whose numbers have a gap."""
    folder = tmp_path / "well"
    (folder / "movie").mkdir(parents=True)
    tifffile.imwrite(folder / "movie" / "a.TIF", np.ones(SHAPE, "uint16"))
    write(folder / "masks" / "tissue_mask.txt", MASK)
    for number, row in (("1", 2), ("3", 8), ("12", 17)):
        pillar = np.zeros(SHAPE)
        pillar[row, 3] = 1
        write(folder / "masks" / f"pillar_mask_{number}.txt", pillar)
    (folder / "masks" / "notes.txt").write_text("made by hand")
    return folder


@pytest.mark.parametrize("part", ["", "movie"])
def test_masks_beside_the_movie_are_found(movie: Path, part: str) -> None:
    masks = read_movie(movie / part).supplied_masks
    assert set(masks) == {"tissue", "pillar_1", "pillar_3", "pillar_12"}
    np.testing.assert_array_equal(masks["tissue"], MASK)
    assert [int(np.flatnonzero(masks[f"pillar_{n}"].any(axis=1))[0]) for n in (1, 3, 12)] == [2, 8, 17]


def test_a_given_mask_wins_over_the_folders_even_where_that_is_bad(movie: Path, tmp_path: Path) -> None:
    other = write(tmp_path / "other.png", (~MASK).astype("uint8"))
    (movie / "masks" / "tissue_mask.txt").write_text("rubbish")
    np.testing.assert_array_equal(read_movie(movie, tissue_mask=other).supplied_masks["tissue"], ~MASK)
    with pytest.raises(MaskUnusable, match=r"tissue_mask\.txt"):
        read_movie(movie)


def test_a_bad_pillar_mask_is_named(movie: Path) -> None:
    write(movie / "masks" / "pillar_mask_3.txt", np.zeros(SHAPE))
    with pytest.raises(MaskUnusable, match=r"pillar_mask_3\.txt: expected some pixels in the mask; it is empty"):
        read_movie(movie)


def test_a_movie_without_masks_has_none(tmp_path: Path) -> None:
    assert find_supplied_masks(tmp_path, SHAPE) == {}
    tifffile.imwrite(tmp_path / "m.tif", np.ones(SHAPE, "uint16"))
    write(tmp_path / "masks" / "tissue_mask.txt", MASK)  # beside a file, it may belong to another movie
    assert read_movie(tmp_path / "m.tif").supplied_masks == {}
