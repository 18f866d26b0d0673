"""Plausibility by a measure: from 0 where a thing cannot be what is looked for, to 1 where nothing speaks against it.

A product of ramps judges by many measures at once, and each limit stays a pair of numbers that can be read.
"""

from __future__ import annotations

import numpy as np


def ramp(value: float, points: tuple[float, ...]) -> float:
    """Rise from 0 at the first of two numbers to 1 at the second, which may be the smaller one.

    Of four numbers, rise from the first to the second and fall again from the third to the fourth.
    """
    rise = float(np.clip((value - points[0]) / (points[1] - points[0]), 0, 1))
    return rise if len(points) == 2 else rise * float(np.clip((points[3] - value) / (points[3] - points[2]), 0, 1))
