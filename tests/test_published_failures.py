"""Every input on which the published tool fails gives the right number here, or one clear error.

The inputs are those of the list in the docs on the method `paper`; all runs use the default method.
"""

import hashlib
import time
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
import tifffile

import microbundle
from microbundle import CannotMeasure, Config, MaskUnusable, Movie, NoTissue, OutputError
from microbundle.data import Masks
from microbundle.metrics import tables
from microbundle.synth.motion import Rhythm
from microbundle.synth.noise import NoiseModel
from microbundle.synth.render import SyntheticMovie, beating_tissue

SHAPE = (128, 160)
PERIOD = 20
SMALL = Config.from_dict({"strain": {"tile_px": 16}})
GOOD_CAMERA = {"full_well_electrons": 30_000, "read_noise": 0.001}


def rendered(count: int = 70, first_beat: float = 0.3, bits: int = 16, angle_deg: float = 0.0, seed: int = 1,
             **more) -> SyntheticMovie:
    rhythm = Rhythm(count, PERIOD, first_beat=first_beat, seed=seed)
    return beating_tissue(SHAPE, rhythm=rhythm, peak_px=2.0, seed=seed, angle_deg=angle_deg, inclusion=False,
                          noise=NoiseModel(bits=bits, seed=seed, **GOOD_CAMERA), **more)


def as_movie(array: np.ndarray, **more) -> Movie:
    return Movie.from_array(array, fps=30, um_per_px=4, **more)


def amplitude_px(analysis) -> float:
    return float(tables(analysis)["summary"].set_index("metric")["mean"]["amplitude_px"])


def true_amplitude_px(made: SyntheticMovie) -> float:
    points = made.truth.points_px(4)
    peaks = np.rint(made.truth.rhythm.peak_frames).astype(int)
    return float(np.mean([made.truth.mad_px(points, range(p - 1, p + 4)).max() for p in peaks[1:-1]]))


def keys(analysis) -> dict[str, str]:
    return {f.key: f.level for f in analysis.findings}


@pytest.fixture(scope="module")
def beating() -> SyntheticMovie:
    """Three whole beats and rests."""
    return rendered()


@pytest.fixture(scope="module")
def frames(beating) -> np.ndarray:
    array = beating.array()
    array.setflags(write=False)
    return array


@pytest.fixture(scope="module")
def plain(frames):
    return microbundle.analyze(as_movie(frames), SMALL)


def folder_of(frames, folder: Path, name="{:03d}.tif") -> Path:
    folder.mkdir(parents=True)
    for t, frame in enumerate(frames):
        tifffile.imwrite(folder / name.format(t), frame)
    return folder


def content(folder: Path) -> dict[str, str]:
    return {str(f.relative_to(folder)): hashlib.sha256(f.read_bytes()).hexdigest()
            for f in sorted(folder.rglob("*")) if f.is_file()}


# --- 1, 2, 3: beats -------------------------------------------------------------------------------------------------


def test_plain_movie_gives_the_true_amplitude_and_rhythm(plain, beating):
    assert plain.beats.complete.sum() == 3
    assert amplitude_px(plain) == pytest.approx(true_amplitude_px(beating), rel=0.1)
    np.testing.assert_allclose(np.diff(plain.beats.peak[plain.beats.complete]), PERIOD, atol=1)


def test_hot_pixel_in_every_second_frame_changes_no_beat(plain):
    array = rendered(bits=12).array()
    assert array.max() < 4096
    array[::2, 3, 3] = 4095
    found = microbundle.analyze(as_movie(array), SMALL)
    np.testing.assert_allclose(found.beats.peak, plain.beats.peak, atol=1)
    assert found.beats.complete.sum() == 3
    assert amplitude_px(found) == pytest.approx(amplitude_px(plain), rel=0.03)


def test_contracted_start_gives_the_true_amplitude_and_marks_the_partial_beat():
    made = rendered(first_beat=-0.2)
    found = microbundle.analyze(as_movie(made.array()), SMALL)
    assert not found.beats.complete[0]
    assert found.beats.start[0] == 0
    assert keys(found)["contracted_start"] == "info"
    assert amplitude_px(found) == pytest.approx(true_amplitude_px(made), rel=0.1)


@pytest.mark.parametrize("whole", [1, 2])
def test_fewer_than_three_peaks_are_enough(frames, plain, whole):
    found = microbundle.analyze(as_movie(frames[:4 + PERIOD * whole]), SMALL)
    assert found.beats.complete.sum() == whole
    assert found.verdict == "review"
    assert keys(found)["few_beats"] == "review"
    assert amplitude_px(found) == pytest.approx(amplitude_px(plain), rel=0.05)


@pytest.mark.parametrize("noise", [0, 60, 600])
def test_static_movie_is_a_result_without_beats(frames, noise):
    rng = np.random.default_rng(0)
    still = np.clip(frames[0] + rng.normal(0, max(noise, 1e-9), (40, *SHAPE)).round(), 0, 65535).astype(np.uint16)
    found = microbundle.analyze(as_movie(still), SMALL)
    assert len(found.beats) == 0
    assert found.verdict == "fail"
    assert keys(found)["no_measurable_motion"] == "fail"
    assert len(tables(found)["frames"]) == 40


def test_movie_of_noise_shows_no_tissue():
    noise = np.random.default_rng(0).integers(0, 4096, (30, *SHAPE), dtype=np.uint16)
    with pytest.raises(NoTissue, match="upply a tissue mask"):
        microbundle.analyze(as_movie(noise))


def test_movie_of_noise_under_a_supplied_mask_cannot_be_followed(plain):
    noise = np.random.default_rng(0).integers(0, 4096, (40, *SHAPE), dtype=np.uint16)
    with pytest.raises(CannotMeasure, match="could be followed"):
        microbundle.analyze(as_movie(noise, tissue_mask=plain.masks.tissue), SMALL)


@pytest.mark.parametrize("value", [0, 65535])
def test_black_or_white_frame_is_left_out_of_all_numbers(frames, plain, value):
    broken = frames.copy()
    broken[[21, 33]] = value
    found = microbundle.analyze(as_movie(broken), SMALL)
    assert not found.tracks.ok[[21, 33]].any()
    np.testing.assert_allclose(found.beats.peak, plain.beats.peak, atol=1)
    assert amplitude_px(found) == pytest.approx(amplitude_px(plain), rel=0.03)
    made = tables(found)
    assert np.isnan(made["frames"]["mean_absolute_displacement_px"][[21, 33]]).all()
    assert made["beats"].loc[made["beats"]["complete"], "e_cc_peak"].notna().all()


def test_empty_mask_is_refused(frames, tmp_path):
    with pytest.raises(MaskUnusable, match="marks no pixel"):
        microbundle.analyze(as_movie(frames, tissue_mask=np.zeros(SHAPE, bool)))
    file = tmp_path / "empty.txt"
    np.savetxt(file, np.zeros(SHAPE), fmt="%i")
    with pytest.raises(MaskUnusable, match="empty"):
        microbundle.read_movie(folder_of(frames[:3], tmp_path / "movie"), tissue_mask=file)


# --- 4: files -------------------------------------------------------------------------------------------------------


def check_same(movie: Movie, frames: np.ndarray, tolerance: float = 0.0) -> None:
    assert movie.count == len(frames)
    for t in (0, len(frames) // 2, len(frames) - 1):
        np.testing.assert_allclose(np.asarray(movie.frames[t], float), frames[t], atol=tolerance)


@pytest.mark.parametrize("name", ["{:03d}.tif", "{:03d}.TIF", "{}.tiff", "frame {}.Tif"])
def test_any_case_of_the_suffix_and_names_without_leading_zeros(frames, tmp_path, name):
    check_same(microbundle.read_movie(folder_of(frames[:12], tmp_path / "movie", name)), frames[:12])


def test_multi_page_colour_and_float_give_the_same_beats(frames, plain, tmp_path):
    grey = (frames >> 8).astype(np.uint8)
    tifffile.imwrite(tmp_path / "pages.tif", frames)
    tifffile.imwrite(tmp_path / "rgb.tif", np.repeat(grey[..., None], 3, axis=-1), photometric="rgb")
    tifffile.imwrite(tmp_path / "float.tif", (frames / 65535).astype(np.float32))
    for name in ("pages", "rgb", "float"):
        found = microbundle.analyze(microbundle.read_movie(tmp_path / f"{name}.tif"), SMALL)
        np.testing.assert_allclose(found.beats.peak, plain.beats.peak, atol=1)
        assert amplitude_px(found) == pytest.approx(amplitude_px(plain), rel=0.03)
        assert ("colour_converted" in keys(found)) == (name == "rgb")


# --- 5, 6: where the tissue lies ------------------------------------------------------------------------------------


@pytest.mark.parametrize("angle", [-3.0, 4.0])
def test_tilt_with_dark_corners_keeps_the_width(frames, plain, angle):
    turn = cv2.getRotationMatrix2D((79.5, 63.5), angle, 1)
    tilted = np.stack([cv2.warpAffine(frame, turn, SHAPE[::-1]) for frame in frames[:30]])
    assert (tilted[:, 0, 0] == 0).all()
    found = microbundle.analyze(as_movie(tilted), SMALL)
    assert found.masks.axis.width_center_px == pytest.approx(plain.masks.axis.width_center_px, rel=0.05)
    assert found.masks.axis.angle_deg == pytest.approx(plain.masks.axis.angle_deg - angle, abs=1)


def test_stray_blob_in_the_mask_does_not_turn_the_axis(frames, plain):
    tissue = plain.masks.tissue.copy()
    tissue[2:22, 20:26] = True
    found = microbundle.analyze(as_movie(frames[:30], tissue_mask=tissue), SMALL)
    assert found.masks.axis.angle_deg == pytest.approx(plain.masks.axis.angle_deg, abs=1)
    assert found.masks.axis.width_center_px == pytest.approx(plain.masks.axis.width_center_px, rel=0.02)


def test_level_tissue_stays_level_and_the_right_side_up(plain):
    axis = plain.masks.axis
    assert abs(axis.angle_deg) < 2
    np.testing.assert_allclose(plain.tissue_axes(np.array([[10.0, 20.0]])), [[10, 20]], atol=3)
    assert plain.grid.point_px[0, 0] < plain.grid.point_px[-1, 0]
    assert plain.grid.point_px[0, 1] < plain.grid.point_px[-1, 1]


@pytest.mark.parametrize("angle", [43.0, -60.0])
def test_turned_tissue_comes_out_right_side_up(plain, angle):
    made = rendered(30, angle_deg=angle)
    found = microbundle.analyze(as_movie(made.array()), SMALL)
    assert found.masks.axis.angle_deg == pytest.approx(angle, abs=3)
    center = found.masks.axis.center_px
    right, below = found.tissue_axes(center + np.array([[0.0, 10.0], [10.0, 0.0]])) - center
    assert right[1] > 0  # what lies right stays right, what lies below stays below
    assert below[0] > 0
    E = tables(found)["beats"]["e_cc_peak"].iloc[0]
    assert pytest.approx(tables(plain)["beats"]["e_cc_peak"].mean(), rel=0.35) == E


# --- 7, 8: sub-domains and lost markers -----------------------------------------------------------------------------


def test_sub_domain_without_texture_is_nan_with_a_reason(frames, plain):
    painted = frames[:30].copy()
    r0, c0 = plain.strain.corner_px[0, 0].round().astype(int) - 4
    painted[:, r0:r0 + 24, c0:c0 + 24] = np.median(painted[0][plain.masks.tissue])
    found = microbundle.analyze(as_movie(painted, tissue_mask=plain.masks.tissue), SMALL)
    assert found.strain.label == plain.strain.label
    assert "texture" in found.strain.reason[0]
    assert np.isnan(found.strain.F[:, 0]).all()
    assert found.strain.reason[-1] == ""
    assert np.isfinite(found.strain.F[:, -1]).all()


def test_single_sub_domain_is_measured_stored_and_exported(frames, tmp_path):
    config = Config.from_dict({"strain": {"tiles": [1, 1]}})
    found = microbundle.analyze(as_movie(frames[:30]), config)
    assert found.strain.grid == (1, 1)
    assert np.isfinite(found.strain.F).all()
    again = microbundle.load(microbundle.save(found, tmp_path / "out"))
    np.testing.assert_array_equal(again.strain.F, found.strain.F)
    results = microbundle.export_paper(found, tmp_path / "paper") / "results"
    assert np.loadtxt(results / "strain__beat0_Fcc.txt", ndmin=2).shape[0] == 1


def test_no_room_for_a_sub_domain_leaves_displacement(frames, plain, tmp_path):
    found = microbundle.analyze(as_movie(frames), Config.from_dict({"strain": {"tile_px": 500}}))
    assert found.strain is None
    assert keys(found)["no_strain"] == "review"
    assert amplitude_px(found) == pytest.approx(amplitude_px(plain))
    assert microbundle.load(microbundle.save(found, tmp_path / "out")).strain is None


def test_one_marker_that_is_lost_far_away_does_not_choose_the_window(frames, plain):
    glint = frames.copy()
    r, c = plain.markers.position_px[len(plain.markers) // 2].astype(int)
    for t, (dr, dc) in enumerate(np.random.default_rng(0).integers(-3, 4, (len(glint), 2))):
        glint[t, r + dr:r + dr + 2, c + dc:c + dc + 2] = 65535
    found = microbundle.analyze(as_movie(glint, tissue_mask=plain.masks.tissue), SMALL)
    assert found.tracks.window_px == plain.tracks.window_px
    assert amplitude_px(found) == pytest.approx(amplitude_px(plain), rel=0.05)


# --- 9: files left over, masks in 0/255, the user's frames ----------------------------------------------------------


def test_results_of_an_earlier_run_are_refused_or_replaced_whole(plain, frames, tmp_path):
    out = microbundle.save(plain, tmp_path / "out")
    exported = microbundle.export_paper(plain, tmp_path / "paper")
    short = microbundle.analyze(as_movie(frames[:30]), SMALL)
    for write, folder in ((microbundle.save, out), (microbundle.export_paper, exported)):
        before = content(folder)
        with pytest.raises(OutputError, match="overwrite"):
            write(short, folder)
        assert content(folder) == before
    microbundle.save(short, out, overwrite=True)
    assert len(microbundle.load(out).beats) == len(short.beats) < len(plain.beats)
    fresh = microbundle.save(short, tmp_path / "fresh")
    assert set(content(out)) == set(content(fresh))
    microbundle.export_paper(short, exported, overwrite=True)
    assert sorted(f.name for f in (exported / "results").glob("beat*_row.txt")) == ["beat0_row.txt"]


def test_mask_of_0_and_255_is_the_same_mask(plain, frames, tmp_path):
    home = tmp_path / "home"
    folder_of(frames[:30], home / "movie", "{:04d}.TIF")
    (home / "masks").mkdir()
    np.savetxt(home / "masks" / "tissue_mask.txt", plain.masks.tissue * 255, fmt="%i")
    found = microbundle.analyze(microbundle.read_movie(home), SMALL)
    np.testing.assert_array_equal(found.masks.tissue, plain.masks.tissue)
    one = microbundle.analyze(as_movie(frames[:30], tissue_mask=plain.masks.tissue), SMALL)
    assert len(found.markers) == len(one.markers)
    assert found.markers.coverage_px == one.markers.coverage_px


def test_filters_and_trimming_leave_the_users_frames_as_they_are(frames, tmp_path):
    folder = folder_of(frames[:40], tmp_path / "mine" / "movie")
    before = content(tmp_path / "mine")
    kernel = [[0.0, 0.1, 0.0], [0.1, 0.6, 0.1], [0.0, 0.1, 0.0]]
    reading = {"first_frame": 4, "stop_frame": 36, "sharpen": 1.0, "kernel": kernel, "crop_px": [4, 124, 0, 156],
               "drop_flashes": True}
    config = Config.from_dict({"reading": reading, "strain": {"tile_px": 16}, "fps": 30, "um_per_px": 4})
    movie = microbundle.read_movie(folder)
    found = [microbundle.analyze(movie, config) for _ in range(2)]
    microbundle.save(found[0], tmp_path / "out")
    microbundle.export_paper(found[0], tmp_path / "paper")
    assert content(tmp_path / "mine") == before
    assert found[0].frame_count == 32
    # running twice filters once
    np.testing.assert_allclose(found[0].tracks.position_px, found[1].tracks.position_px, atol=1e-3)


def test_frames_and_mask_in_memory_are_left_as_they_are(frames, plain):
    array, tissue = frames[:30].copy(), plain.masks.tissue.copy()
    microbundle.analyze(as_movie(array, tissue_mask=tissue), SMALL)
    np.testing.assert_array_equal(array, frames[:30])
    np.testing.assert_array_equal(tissue, plain.masks.tissue)


# --- 10, 11, 12: cost, the export's order, current packages ---------------------------------------------------------


def cpu_s(array: np.ndarray, tissue: np.ndarray) -> float:
    start = time.process_time()
    microbundle.analyze(as_movie(array, tissue_mask=tissue))
    return time.process_time() - start


def test_cost_grows_with_the_tissues_pixels_and_no_faster():
    rng = np.random.default_rng(0)
    rest = cv2.GaussianBlur(rng.normal(size=(1080, 1920)).astype(np.float32), (0, 0), 1.8)
    rest = 20000 + 5000 * rest / rest.std()
    row, col = np.mgrid[:1080, :1920].astype(np.float32)
    array = np.stack([cv2.remap(rest, 960 + (col - 960) * (1 + 0.004 * a), row, cv2.INTER_CUBIC,
                                borderMode=cv2.BORDER_REFLECT) for a in (0, 0.5, 1, 0.5, 0, 0)])
    array = np.clip(array, 0, 65535).astype(np.uint16)
    tissue = np.zeros((1080, 1920), bool)
    tissue[90:990, 60:1860] = True
    cpu_s(array[:, ::4, ::4], tissue[::4, ::4])  # late imports are not counted
    quarter = cpu_s(array[:, 270:810, 480:1440], tissue[270:810, 480:1440])
    full = cpu_s(array, tissue)
    share = tissue[270:810, 480:1440].sum() / tissue.sum()
    assert full < 2.5 * quarter / share + 2
    assert full < 40


def test_export_does_not_swap_rows_and_columns(plain, tmp_path):
    results = microbundle.export_paper(plain, tmp_path / "paper") / "results"
    row, col = (np.loadtxt(results / f"beat0_{name}.txt") for name in ("row", "col"))
    usable = plain.tracks.kept & np.isfinite(plain.beats.relaxed_px).all(axis=1)
    beat = slice(plain.beats.start[0], plain.beats.stop[0])
    np.testing.assert_allclose(row.T, plain.tracks.position_px[beat][:, usable, 0])
    np.testing.assert_allclose(col.T, plain.tracks.position_px[beat][:, usable, 1])
    # the tissue beats along the columns
    assert np.ptp(col, axis=1).mean() > 2 * np.ptp(row, axis=1).mean()
    parts = {name: np.loadtxt(results / f"strain__beat0_F{name}.txt") for name in ("rr", "rc", "cr", "cc")}
    for (i, j), name in (((0, 0), "rr"), ((0, 1), "rc"), ((1, 0), "cr"), ((1, 1), "cc")):
        np.testing.assert_allclose(parts[name].T, plain.strain.F[beat, :, i, j])
    assert np.nanmin(parts["cc"]) < 0.97 < np.nanmin(parts["rr"])
    info = np.loadtxt(results / "info.txt", ndmin=2)
    assert len(info) == plain.beats.complete.sum()


def test_current_numpy_works(plain):
    assert int(np.__version__.split(".")[0]) >= 2
    assert plain.versions["numpy"] == np.__version__


def test_mask_given_in_place_of_the_automatic_one_is_used(frames, plain):
    given: Masks = replace(plain.masks, method="supplied", stability=None)
    found = microbundle.analyze(as_movie(frames[:30]), SMALL, masks=given)
    assert found.masks is given
