"""A simulated movie on the disk is the movie that its truth describes."""

import numpy as np
import pytest
import tifffile

from microbundle.config import Config
from microbundle.errors import ConfigError, OutputError
from microbundle.read import read_movie
from microbundle.synth import commands
from microbundle.synth.cases import case_set
from microbundle.synth.simulate import activation_of, write_simulation


@pytest.fixture(scope="module")
def written(tmp_path_factory):
    case = case_set("smoke")[0]
    return case, write_simulation(case, tmp_path_factory.mktemp("simulated") / "movie_1")


def test_the_folder_is_the_papers_layout_with_its_truth(written):
    case, folder = written
    movie = read_movie(folder)
    assert (movie.count, movie.shape, movie.name) == (84, (128, 224), "movie_1")
    assert set(movie.supplied_masks) == {"tissue", "pillar_1", "pillar_2"}
    made = case.make()
    np.testing.assert_array_equal(movie.frames[13], made.movie.frames[13])
    np.testing.assert_array_equal(movie.supplied_masks["tissue"], made.truth.mask)
    settings = Config.from_toml(folder / "calibration.toml")
    assert (settings.fps, settings.um_per_px) == (30.0, 4.0)


def test_the_truth_on_the_disk_is_the_motions(written):
    case, folder = written
    truth = case.make().truth
    with np.load(folder / "truth.npz") as data:
        points, u, F = data["point_px"], data["displacement_px"], data["F"]
        np.testing.assert_allclose(data["position_px"], points + u)
        np.testing.assert_allclose(data["E"], 0.5 * (np.swapaxes(F, -1, -2) @ F - np.eye(2)))
        np.testing.assert_allclose(data["activation"], activation_of(case))
        np.testing.assert_array_equal(data["mask"], truth.mask)
    np.testing.assert_allclose(u[12], truth.displacement_px(points, 12))
    np.testing.assert_allclose(F[12], truth.F(points, 12))
    table = np.genfromtxt(folder / "truth.csv", delimiter=",", names=True)
    np.testing.assert_allclose(table["mean_absolute_displacement_px"], np.hypot(*np.moveaxis(u, 2, 0)).mean(axis=1),
                               rtol=1e-6)
    assert set(table["beat"]) == {0, 1, 2, 3}


def test_nothing_is_replaced(written):
    case, folder = written
    with pytest.raises(OutputError):
        write_simulation(case, folder)


def test_the_command(tmp_path, capsys):
    small = {"size": (96, 160), "frames": 6, "noise": "perlin", "magnitude": 0.05}
    assert commands.simulate(out=tmp_path / "a", **small) == 0
    assert commands.simulate(out=tmp_path / "b", **small, masks=False, quiet=True) == 0
    assert str(tmp_path / "a") in capsys.readouterr().out
    assert not (tmp_path / "b" / "masks").exists()
    first = [tifffile.imread(tmp_path / name / "movie" / "frame_0003.tif") for name in "ab"]
    np.testing.assert_array_equal(*first)
    with pytest.raises(ConfigError, match="--size"):
        commands.simulate(out=tmp_path / "c", size=(300, 200))
    with pytest.raises(ConfigError, match="--case"):
        commands.simulate(out=tmp_path / "c", case="no-such-case")
    with pytest.raises(ConfigError, match="analytic"):
        commands.simulate(out=tmp_path / "c", physics="fe", texture=tmp_path / "a")
