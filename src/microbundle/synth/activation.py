"""When and where the tissue contracts: activation in time, fibre direction and passive regions in space.

The activation gamma is the share by which an unloaded fibre shortens. The paper (S1 Appendix) takes a cosine that is
clipped below 0.008, with a maximum of 0.08, and adds red noise afterwards: the tissue then stirs while it rests, and
frame 0 is already displaced. Motion is therefore always measured from the unloaded state, gamma = 0.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np

from ..data import Floats
from ..errors import ConfigError, MovieUnreadable


def clipped_cosine(count: int = 200, beats: float = 8.0, *, peak: float = 0.08, clip: float = 0.008,
                   noise: float = 0.001, memory: float = 0.95, seed: int | None = None) -> Floats:
    """Give an activation series (count,) of equal beats with resting phases between, after the paper.

    gamma = -peak cos(2 pi beats t), set to 0 below `clip`, with t from 0 to 1; then red noise of standard deviation
    `noise`, in which each value keeps the share `memory` of the one before. Without a seed there is no noise.
    """
    if count < 1 or not 0 <= clip < peak < 1:
        raise ConfigError(f"activation: expected count >= 1 and 0 <= clip < peak < 1, found {count}, {clip}, {peak}")
    gamma = -peak * np.cos(2 * np.pi * beats * np.linspace(0, 1, count))
    gamma[gamma < clip] = 0.0
    return gamma if seed is None else gamma + red_noise(count, noise, memory, seed)


def red_noise(count: int, sigma: float, memory: float, seed: int) -> Floats:
    """Draw noise (count,) with standard deviation `sigma` in which x[t + 1] = r x[t] + sqrt(1 - r^2) new."""
    white = np.random.default_rng(seed).normal(0.0, sigma, count)
    red = white.copy()
    for t in range(1, count):
        red[t] = memory * red[t - 1] + np.sqrt(1 - memory**2) * white[t]
    return red


def read_activation(path: Path | str) -> Floats:
    """Read an activation series (T,) from a text file with one number per frame."""
    path = Path(path)
    try:
        series = np.loadtxt(path, ndmin=1)
    except (OSError, ValueError) as error:
        raise MovieUnreadable(f"{path.name}: expected a text file with one activation per line ({error})") from error
    if series.ndim != 1 or not np.isfinite(series).all() or (series >= 1).any():
        raise MovieUnreadable(f"{path.name}: expected one finite activation below 1 per line, "
                              f"found an array of shape {series.shape}")
    return np.asarray(series)


@dataclass(frozen=True)
class Fibres:
    """Direction of the fibres: an angle from the column axis, positive clockwise on the screen (towards +row).

    For a tissue that lies turned in the picture, add its angle to both numbers.
    """

    first_deg: float = 9.33
    """At the smallest column, or on the upper surface."""
    last_deg: float = 15.33
    """At the largest column, or on the lower surface."""
    along: Literal["length", "depth"] = "length"
    """The angle varies linearly with the column or with the depth."""

    def direction(self, point_um: Floats, low_um: Floats, high_um: Floats) -> Floats:
        """Give unit vectors (..., d) at points (..., d) of a tissue that spans `low_um` to `high_um` (d,)."""
        axis = 1 if self.along == "length" else 2
        d = point_um.shape[-1]
        s = np.zeros(point_um.shape[:-1])
        if axis < d:
            s = (point_um[..., axis] - low_um[axis]) / (high_um[axis] - low_um[axis])
        angle = np.deg2rad(self.first_deg + (self.last_deg - self.first_deg) * np.clip(s, 0, 1))
        f = np.zeros(point_um.shape)
        f[..., 0], f[..., 1] = np.sin(angle), np.cos(angle)
        return f


@dataclass(frozen=True)
class PassiveCore:
    """A round passive region from which the activation recovers with distance (no inclusion: activation everywhere)."""

    center_um: tuple[float, float] | None = None
    """(row, col), or None for the middle of the tissue."""
    radius_um: float = 100.0
    rule: Literal["continuous", "literal", "script"] = "continuous"
    """How the paper's rule is read, with rho the distance from the centre, r the radius and b = 0.9:
    `continuous`: d = rho^2 and the test d < r^2, the only reading without a jump at the border;
    `literal`: d = rho in mm and the test d < r, as printed; the passive share drops to 0.53 at the border;
    `script`: the published program, which compares rho^2 with r (in mm) and squares d again: the passive disc of
    r = 100 um becomes one of 316 um."""

    def passive(self, point_um: Floats, middle_um: Floats) -> Floats:
        """Give the passive share (...) at points (..., d): 1 inside, falling towards 0 far away."""
        center = np.asarray(middle_um if self.center_um is None else self.center_um)[:2]
        rho = np.sqrt(((point_um[..., :2] - center) ** 2).sum(axis=-1)) * 1e-3       # mm, as in the paper
        r, b = self.radius_um * 1e-3, 0.9
        if self.rule == "continuous":
            d, within, core = rho**2, rho < r, r**2
        elif self.rule == "literal":
            d, within, core = rho, rho < r, r**2
        else:
            d, within, core = rho**4, rho**2 < r, r**2
        return np.where(within, 1.0, core / (b * core + (1 - b) * d))
