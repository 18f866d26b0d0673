"""Every setting of an analysis, as one frozen tree.

The same tree is the TOML file, the command line's flags (`--tracking.window-px 21`), and the record of settings in
the result. Each attribute's docstring is its help text everywhere. Defaults are meant to be left alone.
"""

from __future__ import annotations

import tomllib
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Annotated, Any, Literal, Self

from annotated_types import Ge, Gt, Le, Lt, MultipleOf
from pydantic import BaseModel, ConfigDict, ValidationError, field_validator, model_validator

from .errors import ConfigError

Method = Literal["default", "accurate", "fast", "paper"]


class Params(BaseModel):
    """Base of all settings: frozen, and unknown keys are refused."""

    model_config = ConfigDict(frozen=True, extra="forbid", use_attribute_docstrings=True, allow_inf_nan=False)


class Reading(Params):
    """What is taken from the file, and done to the frames in memory before anything else. Files are never changed."""

    series: Annotated[int, Ge(0)] | None = None
    """Which recording (series, scene, position, image) of a file with several, counted from 0."""
    channel: Annotated[int, Ge(0)] | None = None
    """Which channel of a file with several, counted from 0."""
    z: Annotated[int, Ge(0)] | None = None
    """Which focal plane of a file with several, counted from 0."""
    crop_px: tuple[int, int, int, int] | None = None
    """Keep only this rectangle: first row, end row, first column, end column (the ends are not included)."""
    first_frame: Annotated[int, Ge(0)] = 0
    """Skip all frames before this one."""
    stop_frame: Annotated[int, Gt(0)] | None = None
    """Skip this frame and all after it."""
    sharpen: Annotated[float, Ge(0), Le(10)] = 0.0
    """Strength of an unsharp mask of 2 px; 0 leaves the frames as they are."""
    smooth_px: Annotated[float, Ge(0), Le(20)] = 0.0
    """Standard deviation of a Gaussian blur, in pixels; 0 leaves the frames as they are."""
    kernel: tuple[tuple[float, ...], ...] | None = None
    """Filter every frame with this kernel, given as rows of numbers of odd count (as a flag: once for each row, like
    [0,1,0])."""
    drop_flashes: bool = False
    """Leave out frames whose brightness jumps away from the frames around them (stimulation flashes)."""

    @model_validator(mode="after")
    def _check(self) -> Self:
        if self.stop_frame is not None and self.stop_frame <= self.first_frame:
            raise ValueError(f"stop_frame {self.stop_frame} must be larger than first_frame {self.first_frame}")
        if self.crop_px is not None:
            r0, r1, c0, c1 = self.crop_px
            if not (0 <= r0 < r1 and 0 <= c0 < c1):
                raise ValueError(f"crop_px {self.crop_px} must be first row < end row, first column < end column")
        if self.kernel is not None:
            sides = {len(row) for row in self.kernel}
            if len(sides) != 1 or len(self.kernel) % 2 == 0 or sides.pop() % 2 == 0:
                raise ValueError("kernel must have an odd number of rows of one odd length")
        return self


class MaskParams(Params):
    """How the tissue is found."""

    method: Literal["auto", "otsu", "sobel", "minimum", "maximum"] = "auto"
    """`auto` takes the mask that came with the movie, or else chooses by itself; the others are the paper's methods:
    threshold on a frame (otsu), on its gradient (sobel), on the darkest or brightest value of each pixel."""
    frame: Annotated[int, Ge(0)] = 0
    """Frame that `otsu` and `sobel` look at."""
    min_stability: Annotated[float, Ge(0), Le(1)] = 0.8
    """Below this overlap between slightly different masks, an automatic mask gets a finding."""


class PillarParams(Params):
    """How the pillars are found, and how stiff they are."""

    masks: Literal["auto", "supplied", "none"] = "auto"
    """`auto` takes the pillar masks that came with the movie, or else looks for the pillars by itself; `supplied` takes
    only masks that came with the movie; `none` leaves the pillars out."""
    stiffness_un_per_um: Annotated[float, Gt(0)] | None = None
    """Stiffness of a pillar where the tissue pulls, in uN/um; without it, from the geometry below where that is
    given."""
    stiffness_error_pct: Annotated[float, Ge(0)] | None = None
    """Standard error of the stiffness in percent, for the budget of errors."""
    profile: Literal["rectangle", "circle"] = "rectangle"
    """Cross-section of a pillar: its width and thickness are asked for, or its diameter."""
    modulus_mpa: Annotated[float, Gt(0)] | None = None
    """Young's modulus of the pillars, in MPa."""
    width_um: Annotated[float, Gt(0)] | None = None
    """Side of a rectangular pillar across the direction in which it bends."""
    thickness_um: Annotated[float, Gt(0)] | None = None
    """Side of a rectangular pillar in the direction in which it bends."""
    diameter_um: Annotated[float, Gt(0)] | None = None
    """Diameter of a round pillar."""
    length_um: Annotated[float, Gt(0)] | None = None
    """Height of a pillar above its base."""
    force_height_um: Annotated[float, Gt(0)] | None = None
    """Height at which the tissue pulls; by default the pillar's own."""
    unloaded_px: tuple[tuple[float, float], ...] | None = None
    """Where the centre of each pillar's mask lies without tissue (row, col), one for each pillar: gives the resting
    force."""
    depth_um: Annotated[float, Gt(0)] | None = None
    """Thickness of the tissue along the line of sight: gives the stress."""
    depth_error_pct: Annotated[float, Ge(0)] | None = None
    """Standard error of the depth in percent, for the budget of errors."""
    um_per_px_error_pct: Annotated[float, Ge(0)] | None = None
    """Standard error of the pixel size in percent, for the budget of errors."""

    @model_validator(mode="after")
    def _check(self) -> Self:
        if self.length_um is not None and (self.force_height_um or 0) > self.length_um:
            raise ValueError(f"force_height_um {self.force_height_um} must not exceed length_um {self.length_um}")
        return self


class MarkerParams(Params):
    """Which points of the tissue are followed."""

    coverage_px: Annotated[float, Ge(4)] = 40.0
    """Look for points until there is one for this many tissue pixels."""
    max_count: Annotated[int, Ge(10)] = 10_000
    """Never follow more points than this."""


class TrackingParams(Params):
    """How points are followed from frame to frame."""

    window_px: Annotated[int, Ge(5), Le(201)] | None = None
    """Side of the square patch compared between frames; by default chosen from the motion that is found."""
    max_forward_backward_px: Annotated[float, Gt(0)] = 0.5
    """A point is lost where tracking to a frame and back misses its start by more than this."""
    reference_frame: Annotated[int, Ge(0)] | None = None
    """Relaxed frame that all others are compared with; by default found by itself."""


class RegistrationParams(Params):
    """How the displacement field is measured, for the method `accurate`."""

    knot_px: Annotated[int, Ge(6), Le(48)] = 12
    """Distance between the knots of the displacement field: smaller shows finer detail and more noise."""
    whiten: Literal["auto", "never"] = "auto"
    """Filter structured noise where that lowers the error, or never."""
    threads: Annotated[int, Ge(1)] | None = None
    """Frames that are worked on at the same time; by default one for each processor."""


class BeatParams(Params):
    """How the movie is cut into beats."""

    min_amplitude_px: Annotated[float, Ge(0)] = 0.0
    """Ignore beats smaller than this, whatever the noise."""
    min_period_s: Annotated[float, Ge(0)] = 0.0
    """Ignore peaks that follow another within this time (needs known frame times)."""
    noise_factor: Annotated[float, Gt(0)] = 6.0
    """A beat stands out of the signal's noise by this many of its standard deviations."""


class GridParams(Params):
    """The regular grid on which displacement is interpolated."""

    spacing_px: Annotated[float, Ge(1)] = 10.0
    """Distance between grid points."""
    method: Literal["local", "thin_plate"] = "local"
    """`local` fits a plane to the nearest markers; `thin_plate` is the paper's exact spline through all of them."""
    extrapolate: bool = False
    """Also give values outside the tissue."""


class StrainParams(Params):
    """How the tissue is divided for strain. Lengths are along the tissue (col) and across it (row)."""

    clip_columns: Annotated[float, Ge(0), Lt(1)] = 0.5
    """Share of the tissue's length left out around the pillars, half at each end."""
    clip_rows: Annotated[float, Ge(0), Lt(1)] = 0.0
    """Share of the tissue's width left out, half at each side."""
    shrink_columns: Annotated[float, Ge(0), Lt(1)] = 0.1
    """Share of the rest's length kept free as a margin."""
    shrink_rows: Annotated[float, Ge(0), Lt(1)] = 0.1
    """Share of the rest's width kept free as a margin."""
    tile_px: Annotated[float, Ge(5)] = 40.0
    """Side of a square sub-domain."""
    tiles: tuple[Annotated[int, Ge(1)], Annotated[int, Ge(1)]] | None = None
    """Number of sub-domains across and along the tissue, instead of their side."""
    extents_px: tuple[float, float, float, float] | None = None
    """Rectangle to divide instead of the automatic one: first row, end row, first column, end column, in pixels of
    the image turned about the tissue's centre until the tissue is level."""
    min_markers: Annotated[int, Ge(3)] = 4
    """A sub-domain with fewer markers has no strain."""

    @model_validator(mode="after")
    def _check(self) -> Self:
        if self.extents_px is not None:
            r0, r1, c0, c1 = self.extents_px
            if not (r0 < r1 and c0 < c1):
                raise ValueError(f"extents_px {self.extents_px} must be first row < end row, first column < end column")
        return self


class MetricParams(Params):
    """How beats are measured."""

    levels_pct: tuple[Annotated[int, Ge(10), Le(90), MultipleOf(10)], ...] = (10, 50, 90)
    """Contraction durations to write, in steps of 10: cd50 is the width of a beat after 50 % of the relaxation (as a
    flag: once for each)."""
    velocity_s: Annotated[float, Ge(0)] = 0.0
    """Time over which a velocity is taken, in seconds; never less than the time between two frames."""
    pacing_hz: Annotated[float, Gt(0)] | None = None
    """Rate of the stimulation, where there is one: missed and extra beats are counted against it."""
    fibre_deg: Annotated[float, Ge(-180), Le(180)] | None = None
    """Direction of the fibres from the tissue's axis, clockwise: strain along them is written too."""


class Config(Params):
    """All settings of an analysis."""

    method: Method = "accurate"
    """`accurate`, the default, registers every frame against the relaxed tissue; `fast` follows single markers;
    `paper` reproduces the published MicroBundleCompute, faults included, for comparison."""
    fps: Annotated[float, Gt(0)] | None = None
    """Frames per second, where the file does not say (a given value wins over the file's)."""
    um_per_px: Annotated[float, Gt(0)] | None = None
    """Size of a pixel in micrometres, where the file does not say (a given value wins over the file's)."""
    axis_deg: Annotated[float, Ge(-180), Le(180)] | None = None
    """Angle of the tissue's long axis from the image's columns, clockwise; by default measured on the mask."""
    reading: Reading = Reading()
    """What is done to the frames before anything else."""
    mask: MaskParams = MaskParams()
    """How the tissue is found."""
    pillars: PillarParams = PillarParams()
    """How the pillars are found."""
    markers: MarkerParams = MarkerParams()
    """Which points are followed."""
    tracking: TrackingParams = TrackingParams()
    """How points are followed."""
    registration: RegistrationParams = RegistrationParams()
    """How the displacement field is measured."""
    beats: BeatParams = BeatParams()
    """How the movie is cut into beats."""
    grid: GridParams = GridParams()
    """The grid on which displacement is interpolated."""
    strain: StrainParams = StrainParams()
    """How the tissue is divided for strain."""
    metrics: MetricParams = MetricParams()
    """How beats are measured."""

    @field_validator("method")
    @classmethod
    def _name(cls, method: Method) -> Method:
        return "accurate" if method == "default" else method

    @classmethod
    def from_dict(cls, settings: dict[str, Any], *, source: str = "config") -> Config:
        """Check settings given as a nested dict; raises ConfigError that names the setting and `source`."""
        try:
            return cls.model_validate(settings)
        except ValidationError as error:
            raise ConfigError(explain(error, source)) from None

    @classmethod
    def from_toml(cls, path: Path | str) -> Config:
        """Read settings from a TOML file; raises ConfigError where the file or a setting in it is wrong."""
        return cls.from_dict(read_toml(path), source=str(path))


def read_toml(path: Path | str) -> dict[str, Any]:
    """Read a TOML file of settings, unchecked; raises ConfigError where it is missing or is not TOML."""
    try:
        return tomllib.loads(Path(path).read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError) as error:
        raise ConfigError(f"{path}: expected a readable TOML file of settings: {error}") from None


def merge(below: dict[str, Any], above: dict[str, Any]) -> dict[str, Any]:
    """Lay one nested dict of settings over another; the upper one wins."""
    out = dict(below)
    for key, value in above.items():
        both = isinstance(value, dict) and isinstance(out.get(key), dict)
        out[key] = merge(out[key], value) if both else value
    return out


def flat(settings: Mapping[str, Any], above: str = "") -> Iterator[tuple[str, Any]]:
    """Give each of nested settings by its full name, such as strain.tile_px, and its value."""
    for name, value in settings.items():
        if isinstance(value, Mapping):
            yield from flat(value, f"{above}{name}.")
        else:
            yield f"{above}{name}", value


def explain(error: ValidationError, source: str) -> str:
    """Put a failed check of the settings into one sentence for each wrong setting."""
    lines = []
    for one in error.errors():
        key = ".".join(str(part) for part in one["loc"]) or "settings"
        if one["type"] == "extra_forbidden":
            lines.append(f"{source}: unknown setting {key!r}; `microbundle analyze --help` lists them all")
        elif one["type"] == "missing":
            lines.append(f"{source}: {key} is missing")
        else:
            what = one["msg"].removeprefix("Value error, ").replace("Input should be", "expected")
            found = "" if one["type"] == "value_error" else f"; found {one['input']!r}"
            lines.append(f"{source}: {key}: {what}{found}")
    return "\n".join(lines)
