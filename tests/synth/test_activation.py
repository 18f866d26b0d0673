"""Activation in time, fibres and inclusion in space."""

import numpy as np
import pytest

from microbundle.errors import ConfigError, MovieUnreadable
from microbundle.synth.activation import Fibres, PassiveCore, clipped_cosine, read_activation, red_noise


def test_cosine_is_clipped_and_beats_as_often_as_asked():
    g = clipped_cosine(200, 8)
    assert g.max() == pytest.approx(0.08, rel=0.01)
    assert g.min() == 0
    assert not ((g > 0) & (g < 0.008)).any()
    assert np.sum((g[1:] > 0) & (g[:-1] == 0)) == 8


def test_noise_is_red_has_its_size_and_comes_from_the_seed():
    x = red_noise(40000, 0.001, 0.95, seed=5)
    assert x.std() == pytest.approx(0.001, rel=0.1)
    assert np.corrcoef(x[1:], x[:-1])[0, 1] == pytest.approx(0.95, abs=0.01)
    np.testing.assert_array_equal(clipped_cosine(seed=4), clipped_cosine(seed=4))
    assert (clipped_cosine(seed=4) != clipped_cosine(seed=5)).all()
    assert clipped_cosine(seed=4)[0] != 0      # added after the clip, as published: frame 0 already stirs


def test_impossible_activation_is_refused():
    with pytest.raises(ConfigError, match="clip < peak"):
        clipped_cosine(peak=0.005)


def test_activation_is_read_from_text(tmp_path):
    path = tmp_path / "activation.txt"
    np.savetxt(path, [0.0, 0.01, 0.05])
    np.testing.assert_allclose(read_activation(path), [0.0, 0.01, 0.05])
    path.write_text("zero\n")
    with pytest.raises(MovieUnreadable, match=r"activation\.txt"):
        read_activation(path)
    path.write_text("0.1\n1.5\n")
    with pytest.raises(MovieUnreadable, match="below 1"):
        read_activation(path)


@pytest.mark.parametrize(("along", "axis"), [("length", 1), ("depth", 2)])
def test_fibres_turn_linearly(along, axis):
    low, high = np.zeros(3), np.array([400.0, 2000.0, 400.0])
    at = np.tile(high / 2, (3, 1))
    at[:, axis] = np.linspace(0, high[axis], 3)
    f = Fibres(along=along).direction(at, low, high)
    np.testing.assert_allclose(np.degrees(np.arctan2(f[:, 0], f[:, 1])), [9.33, 12.33, 15.33])
    np.testing.assert_allclose(np.linalg.norm(f, axis=1), 1)


@pytest.mark.parametrize(("rule", "border_um", "after"), [
    ("continuous", 100.0, 1.0), ("literal", 100.0, 0.01 / (0.009 + 0.1 * 0.1)), ("script", 316.2278, 1.0)])
def test_three_readings_of_the_inclusion(rule, border_um, after):
    inclusion = PassiveCore((0.0, 0.0), 100.0, rule)
    at = np.array([[0.0, border_um * s] for s in (0.5, 0.9999, 1.0001, 3.0, 30.0)])
    share = inclusion.passive(at, np.zeros(2))
    np.testing.assert_allclose(share[:2], 1)
    assert share[2] == pytest.approx(after, rel=1e-3)
    assert (np.diff(share[2:]) < 0).all()
    assert share[-1] < 0.05
