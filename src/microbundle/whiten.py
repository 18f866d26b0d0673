"""Make structured noise white, where that helps.

Least squares is the best estimate only for noise that is not correlated from pixel to pixel. Where the residual of a
first registration is structured (for example by debris that changes from frame to frame), a filter whose response is
the inverse square root of the residual's spectrum makes it white. On camera noise it would only amplify what optics and
sampling have damped, so it is used only where the residual is far from white and the displacement's own noise falls.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.fft import fft2, fftfreq, fftshift, ifft2, irfft2, rfft2

from .bspline import Float32
from .data import Bools, Floats

GRID = 64
"""Lags and frequencies on which the spectrum is known."""
REACH_PX = 12
"""The filter is a square of 25 x 25 px."""
LAG_TAPER_PX = 14.0
FILTER_TAPER_PX = 4.0
FLOOR = 0.01
"""Lowest spectrum, as a share of its median."""
ROLL_OFF = 0.35
"""Damping of the highest frequencies, where pictures hold more interpolation error than tissue."""
STRUCTURED = 0.1
"""Below this spectral flatness the residual is structured."""


def noise_spectrum(residuals: Sequence[Float32], mask: Bools) -> Floats:
    """Mean power spectrum (64, 64) of residual pictures (R, C) that are zero outside the mask (R, C)."""
    shape = (mask.shape[0] + GRID, mask.shape[1] + GRID)
    pairs = irfft2(np.abs(rfft2(mask.astype(float), shape)) ** 2, shape)
    products = np.zeros(shape)
    for picture in residuals:
        centred = picture - picture[mask].mean() * mask
        products += irfft2(np.abs(rfft2(centred, shape)) ** 2, shape)
    lag = (fftfreq(GRID) * GRID).astype(int)
    at = np.ix_(lag % shape[0], lag % shape[1])
    covariance = products[at] / np.maximum(pairs[at] * len(residuals), 1.0)
    distance = np.hypot(lag[:, None], lag[None])
    spectrum = fft2(covariance * np.exp(-0.5 * (distance / LAG_TAPER_PX) ** 2)).real
    median = float(np.median(spectrum[spectrum > 0])) if (spectrum > 0).any() else 1.0
    return np.asarray(np.maximum(spectrum, FLOOR * median))


def flatness(spectrum: Floats) -> float:
    """Geometric over arithmetic mean of a spectrum: 1 for white noise, near 0 for structured noise."""
    return float(np.exp(np.log(spectrum).mean()) / spectrum.mean())


def whitening_kernel(spectrum: Floats) -> Float32:
    """Filter (25, 25) that makes noise of this spectrum white."""
    frequency = np.hypot(fftfreq(GRID)[:, None], fftfreq(GRID)[None])
    floor = FLOOR * float(np.median(spectrum))
    response = np.exp(-2 * (np.pi * ROLL_OFF * frequency) ** 2) / np.sqrt(spectrum + floor)
    kernel = fftshift(ifft2(response).real)
    middle = slice(GRID // 2 - REACH_PX, GRID // 2 + REACH_PX + 1)
    place = np.arange(-REACH_PX, REACH_PX + 1)
    kernel = kernel[middle, middle] * np.exp(-(place[:, None] ** 2 + place[None] ** 2) / (2 * FILTER_TAPER_PX**2))
    return np.asarray(kernel / np.abs(kernel).sum(), np.float32)
