"""Follow rigid bodies, such as pillars' heads, by the grey values within their masks.

After a first pass over the movie, all frames are pulled back to the reference and averaged, and every frame is
registered once more against this template: slopes and residual are then free of the reference frame's noise, and the
residual's variance is halved. Where the template itself lies is as uncertain as the reference frame is noisy; that
error is the same in all frames and cancels wherever two of them are compared.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal

import cv2
import numpy as np
from scipy import ndimage

from .bspline import Float32
from .data import BodyMotion, Bools, Floats, Movie
from .errors import ConfigError, NoTexture
from .patches import FEWEST_PIXELS, Found, Mean, Noise, Part, Patches, box
from .search import BORDER_PX, STILL, Search, eight_bits, odd, reference_picture, through, usable_pixels, usual

TEMPLATE_MARGIN_PX = 6
"""Around a body, for the slopes at its border."""
ROTATION = 3
"""Row of the warp's parameters that is the angle of a small rotation, clockwise on the screen."""
ANCHORS = 40
"""Points of a body that Lucas-Kanade follows."""

Model = Literal["rigid", "translation"]


def follow_body(movie: Movie, mask: Bools, *, reference_frame: int = 0, model: Model = "rigid") -> BodyMotion:
    """Follow one body, such as a pillar's head, given as a mask (R, C) in the reference frame, through all frames.

    Only pixels within the mask count, and of these not the ones at the picture's border. The standard errors are those
    of the way from the reference frame; they hold the noise of both frames. Frames are decoded one by one, twice.

    Frames that do not show the body are NaN, with `ok` False. Raises ConfigError for a reference frame or a model
    that are not allowed, MaskUnusable, and NoTexture where the mask holds nothing to follow.
    """
    return follow_bodies(movie, [Body(movie, mask, reference_frame, model)])[0]


class Body:
    """One body of a movie that can be followed; see `follow_body`."""

    def __init__(self, movie: Movie, mask: Bools, reference_frame: int = 0, model: Model = "rigid", *,
                 picture: Float32 | None = None) -> None:
        """Look at the body in the reference frame, whose `picture` need not be read again. Raises as `follow_body`."""
        if model not in ("rigid", "translation"):
            raise ConfigError(f"model: expected rigid or translation; found {model!r}")
        self.reference, self.model, self.count = reference_frame, model, movie.count
        self.picture = reference_picture(movie, reference_frame) if picture is None else picture
        self.usable = usable_pixels(movie, mask)
        self.center = np.argwhere(mask).mean(axis=0)[None]
        self.patches = self._patches(self.picture)
        if not self.patches.good[0]:
            raise NoTexture(f"{movie.name}: expected a body with texture in all directions on {FEWEST_PIXELS} px or "
                            f"more; found none in frame {reference_frame}, in the {int(self.usable.sum())} px of the "
                            f"mask that lie {BORDER_PX} px inside the picture. Is the mask on the body, and the body "
                            "in focus?")
        self.anchors = _anchors(self.picture, self.usable, self.center)
        self.start = np.tile(STILL, (movie.count, 1, 1, 1))
        self.mean = Mean(ndimage.binary_dilation(self.usable, iterations=TEMPLATE_MARGIN_PX), self.center)

    def _patches(self, picture: Float32) -> Patches:
        return Patches(picture, self.usable, *box(self.usable), self.center, self.model)

    def first_search(self) -> Search:
        """The search of the first pass."""
        return Search(self.picture, self.patches, self.anchors)

    def average(self, t: int, part: Part, found: Found) -> None:
        """Take a frame into the template."""
        if found.ok[0]:
            self.start[t] = found.warp
            self.mean.add(part, found)

    def second_search(self) -> Search:
        """The search of the second pass, for the mean of all frames."""
        picture = self.mean.picture(self.picture)
        self.template = self._patches(picture)
        self.noise = Noise(self.template, self.count)
        self.warp, self.ok = np.empty((self.count, 2, 3)), np.zeros((self.count, 1), bool)
        self.variance, self.unlike = np.zeros((self.count, 1)), np.ones((self.count, 1))
        return Search(picture, self.template, self.anchors, self.start)

    def measure(self, t: int, found: Found) -> None:
        """Take down where the body is in a frame."""
        self.warp[t], self.ok[t] = found.warp[0], found.ok
        self.variance[t], self.unlike[t] = found.variance, 1 - found.match
        self.noise.add(t, found)

    def motion(self) -> BodyMotion:
        """Make the motion of all frames."""
        lost = ~(self.ok & ~odd(self.unlike, self.ok))[:, 0]
        se = self.noise.standard_error(self.variance + self.variance[self.reference], (0, 1, ROTATION))[:, 0]
        steeper = self.patches.noisy_slopes(usual(self.variance, self.ok))[0]
        se *= [*steeper, steeper.mean()]
        residual = np.sqrt(self.variance[:, 0] / self.template.contrast[0])
        shift, turn = self.warp[:, :, 2], np.degrees(np.arctan2(self.warp[:, 0, 1], self.warp[:, 0, 0]))
        turn_se = np.degrees(se[:, 2])
        for values in (shift, se, turn, turn_se, residual):
            values[lost] = np.nan
        if self.model == "translation":
            turn[:], turn_se[:] = np.nan, np.nan
        return BodyMotion(shift, turn, se[:, :2], turn_se, residual, ~lost, self.center[0], self.reference, self.model)


def follow_bodies(movie: Movie, bodies: Sequence[Body]) -> list[BodyMotion]:
    """Follow bodies of one reference frame together: frames are decoded twice, for all of them."""
    if not bodies:
        return []
    reference = bodies[0].reference
    for t, i, part, found in through(movie, reference, [one.first_search() for one in bodies]):
        bodies[i].average(t, part, found)
    for t, i, _, found in through(movie, reference, [one.second_search() for one in bodies]):
        bodies[i].measure(t, found)
    return [one.motion() for one in bodies]


def _anchors(picture: Float32, usable: Bools, center: Floats) -> Floats:
    """Strong points (1, M, 2) of a body, its centre (1, 2) where there are none."""
    corners = cv2.goodFeaturesToTrack(eight_bits(picture), ANCHORS, 0.01, 5, mask=usable.astype(np.uint8))
    return center[None] if corners is None else corners[None, :, 0, ::-1].astype(float)
