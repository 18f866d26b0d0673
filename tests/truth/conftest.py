"""Movies whose motion is known exactly, cheap enough to make many."""

import numpy as np
import pytest

from microbundle.data import Movie
from microbundle.synth.motion import RigidMotion, UniformStretch
from microbundle.synth.noise import NoiseModel
from microbundle.synth.render import render_movie
from microbundle.synth.texture import Gratings

SHAPE = (112, 160)
CENTER = (55.5, 79.5)
FRAMES, BEAT, ACTIVE = 40, 13, 9


def activation(frames: int = FRAMES) -> np.ndarray:
    """Three beats with rests between them; 0 at rest, 1 at the peaks."""
    phase = (np.arange(frames) - 3) % BEAT
    return np.where((np.arange(frames) >= 3) & (phase < ACTIVE), 0.5 - 0.5 * np.cos(2 * np.pi * phase / ACTIVE), 0.0)


def tissue() -> np.ndarray:
    mask = np.zeros(SHAPE, bool)
    mask[20:92, 8:152] = True
    return mask


@pytest.fixture(scope="session")
def render():
    """Make (movie, truth) of a textured picture moved by `motion`, with the tissue mask supplied."""
    def make(motion, seed: int = 0, noise: NoiseModel | None = None):
        texture = Gratings.random(count=30, highest=0.2, lowest=0.03, contrast=0.15, seed=seed)
        made = render_movie(texture, motion, tissue(), ground="moves", noise=noise or NoiseModel())
        return Movie.from_array(made.array(), fps=30, um_per_px=4, tissue_mask=tissue()), made.truth
    return make


def shifted(row: float, col: float, frames: int = FRAMES) -> RigidMotion:
    return RigidMotion(activation(frames)[:, None] * np.array([row, col]))


def turned(degrees: float) -> RigidMotion:
    return RigidMotion(np.zeros((FRAMES, 2)), activation() * np.radians(degrees), CENTER)


def stretched(E_rr: float, E_cc: float, shear: float) -> UniformStretch:
    change = np.array([[E_rr, shear], [0.0, E_cc]])
    return UniformStretch(np.eye(2) + activation()[:, None, None] * change, CENTER)
