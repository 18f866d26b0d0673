"""A result with two pillars whose motion is known."""

from dataclasses import replace

import numpy as np

from microbundle.config import Config
from microbundle.data import PillarMotion, Pillars

K, DEPTH, UM = 2.677, 100.0, 4.0
PEAK_PX = (1.5, 1.0)
CENTER = np.array([[64.0, 16.0], [64.0, 176.0]])


def with_pillars(analysis, *, drift_px=0.0, lag=0.0, unloaded=None, noise_px=0.0):
    """A result whose two pillars move inward with the tissue's shortening, to 1.5 and 1 px."""
    t = np.arange(analysis.frame_count)
    since = (t - 4 - lag) % 24
    course = np.where((since < 12) & (t >= 4), np.sin(np.pi * since / 12) ** 2, 0.0)
    shift = np.zeros((len(t), 2, 2))
    for p, (peak, way) in enumerate(zip(PEAK_PX, (1.0, -1.0), strict=True)):
        shift[:, p, 1] = way * peak * course
    shift[..., 0] += drift_px * t[:, None]
    shift += noise_px * np.random.default_rng(1).standard_normal(shift.shape)
    masks = np.zeros((2, *analysis.image.shape), bool)
    masks[0, 54:75, 6:27], masks[1, 54:75, 166:187] = True, True
    pillars = Pillars(tuple(masks), ("1", "2"), CENTER, ("supplied", "supplied"), (None, None))
    motion = PillarMotion(pillars, shift, np.full(shift.shape, noise_px), np.zeros((len(t), 2)), np.zeros(2), "body")
    params = {"stiffness_un_per_um": K, "stiffness_error_pct": 5.0, "depth_um": DEPTH, "unloaded_px": unloaded}
    return replace(analysis, pillars=motion, config=Config.from_dict({"pillars": params}))
