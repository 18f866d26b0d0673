"""Keep results: one NetCDF file per movie, and tables as CSV. Output appears whole or not at all.

The NetCDF file holds everything needed to continue: `load` gives the same `Analysis` back, and xarray opens it, with
units and descriptions as attributes.
"""

from __future__ import annotations

import errno
import json
import os
import re
import shutil
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from .analysis import Analysis
from .config import Config
from .data import (
    Beats,
    Bools,
    Finding,
    Floats,
    Grid,
    Markers,
    Masks,
    PillarMotion,
    Pillars,
    Strain,
    TissueAxis,
    Tracks,
)
from .decisions import Decisions
from .draws import Draws
from .errors import ResultUnreadable
from .field import Field
from .folder import write_whole
from .metrics import tables
from .uncertainty import displacement_error_at

if TYPE_CHECKING:
    import pandas as pd
    import xarray as xr

RESULT = "result.nc"
KIND = "results"
SPARE = 2**20
"""Bytes that a result may take beside its arrays."""
SCHEMA = 2
"""Version of the layout of the result file; raised when a reader of the old one would be misled."""
IN_FILE = ("summary", "beats", "subdomains")
"""Tables that the result file holds."""
RC = ("row", "col")
DRAWS = {
    "stretch": (("frame",), "stretch of frames that was pooled together"),
    "course": (("frame", "component"), "courses in time of the mean and of the modes"),
    "pattern": (("stretch", "draw", "component", "axis", "knot_row", "knot_col"), "errors of the mean and the modes"),
    "jitter": (("draw", "frame", "component"), "errors of the courses"),
    "mode": (("stretch", "component", "axis", "knot_row", "knot_col"), "the modes"),
}
"""What the field may be wrong by: error = sum over components of course pattern + jitter mode."""


def save(analysis: Analysis, folder: Path | str, *, overwrite: bool = False,
         extra: Callable[[Path], None] | None = None, made: Mapping[str, pd.DataFrame] | None = None) -> Path:
    """Write a result folder: `result.nc` with everything, its settings included, and the tables as CSV, but for empty
    ones.

    Returns the folder. `made` are the tables of `microbundle.tables`, where they are at hand, and any others to write
    beside them; `extra` may write more files into the folder before it appears. Raises OutputError where the folder
    cannot be written, or exists and is not empty; `overwrite` replaces an older result, but nothing else.
    """
    def write(into: Path) -> None:
        written = tables(analysis) if made is None else made
        save_netcdf(analysis, into / RESULT, written)
        for name, table in written.items():
            if len(table.columns) == 0:  # no strain, no pillars
                continue
            table.to_csv(into / f"{name}.csv", index=False, float_format="%.7g", lineterminator="\n")
        if extra is not None:
            extra(into)

    return write_whole(Path(folder), KIND, write, overwrite=overwrite)


def load(path: Path | str) -> Analysis:
    """Read a result back from its folder or its NetCDF file. Raises ResultUnreadable where it is not one."""
    import xarray as xr

    path = Path(path).expanduser()
    file = path / RESULT if path.is_dir() else path
    if not file.is_file():
        raise ResultUnreadable(f"{path}: expected a microbundle result (a folder with {RESULT}, or that file); "
                               "there is none")
    try:
        with xr.open_dataset(file, engine="h5netcdf") as data:
            if "microbundle_schema" not in data.attrs:
                raise ResultUnreadable(f"{file}: expected a result of microbundle; found another NetCDF file")
            if int(data.attrs["microbundle_schema"]) != SCHEMA:
                raise ResultUnreadable(f"{file}: expected result layout {SCHEMA}; found "
                                       f"{data.attrs['microbundle_schema']}. Analyze the movie again with this version")
            return _from_dataset(data.load())
    except ResultUnreadable:
        raise
    except Exception as error:  # HDF5 raises many kinds on damaged files
        raise ResultUnreadable(f"{file}: the result cannot be read: {error}") from None


@dataclass(frozen=True)
class Glance:
    """What a result says at a glance."""

    frame_count: int
    beat_count: int
    time_s: Floats | None
    """(T,), or None where the frame times are unknown."""
    tissue: Bools
    """(R, C)"""
    pillars: tuple[Bools, ...]
    findings: tuple[Finding, ...]


def glance(path: Path | str) -> Glance:
    """Read masks, times and findings of a result, in some milliseconds. Raises ResultUnreadable where it is not one."""
    import h5netcdf

    file = Path(path).expanduser() / RESULT
    try:
        with h5netcdf.File(file, "r") as data:
            pillars = data["pillar_mask"][...] > 0 if "pillar_mask" in data.variables else ()
            return Glance(data.dimensions["frame"].size, data.dimensions["beat"].size,
                          data["time"][...] if "time" in data.variables else None, data["tissue"][...] > 0,
                          tuple(pillars), tuple(Finding(**one) for listed in json.loads(data.attrs["findings"]).values()
                                                for one in listed))
    except Exception as error:  # HDF5 raises many kinds on damaged files
        raise ResultUnreadable(f"{file}: the result cannot be read: {error}") from None


def save_netcdf(analysis: Analysis, file: Path, made: Mapping[str, pd.DataFrame] | None = None) -> None:
    """Write a result as one NetCDF file, with the tables (`made`, where they are at hand) in groups of their own.

    Raises OSError.
    """
    made = made or tables(analysis)
    data = _with_errors(_to_dataset(analysis), analysis, made["strain"])
    packed = {name: {"zlib": True, "complevel": 1} for name, v in data.variables.items()
              if v.dtype.kind in "fiu" and v.size > 1000}
    if shutil.disk_usage(file.parent).free < data.nbytes + SPARE:  # HDF5 may crash on a disk that becomes full
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), str(file))
    try:
        data.to_netcdf(file, engine="h5netcdf", encoding=packed)
        _add_tables({name: made[name] for name in IN_FILE if len(made[name])}, file)
    except RuntimeError as error:  # so does HDF5 tell of a full disk
        number = re.search(r"errno = (\d+)", str(error))
        if number is None:
            raise
        raise OSError(int(number[1]), os.strerror(int(number[1])), str(file)) from None


def _add_tables(chosen: Mapping[str, pd.DataFrame], file: Path) -> None:
    """Add tables to a NetCDF file, each in a group with a variable for each column, as xarray would write and reads
    them; h5py does it in a fifth of the time, for h5netcdf looks up every dimension anew for every variable."""
    import h5py

    with h5py.File(file, "a") as out:
        for name, table in chosen.items():
            group = out.create_group(f"tables/{name}", track_order=True)
            entry = group.create_dataset("entry", data=np.arange(len(table)))
            entry.make_scale("entry")
            for column in table:
                values = table[column].to_numpy()
                kind = values.dtype.kind
                written = values.astype("i1") if kind == "b" else values if kind in "fiu" else \
                    values.astype(object).astype(h5py.string_dtype())
                variable = group.create_dataset(str(column), data=written)
                variable.dims[0].attach_scale(entry)
                if kind == "b":
                    variable.attrs["dtype"] = "bool"


def _to_dataset(a: Analysis) -> xr.Dataset:
    import xarray as xr

    out: dict[str, tuple[Any, ...]] = {}

    def put(name: str, dims: tuple[str, ...], values: Any, units: str, text: str) -> None:
        out[name] = (dims, values, {"units": units, "long_name": text})

    put("image", ("image_row", "image_col"), a.image, "grey value", "relaxed reference frame")
    put("tissue", ("image_row", "image_col"), a.masks.tissue.astype(np.uint8), "1", "1 where the pixel is tissue")
    put("marker_reference", ("marker", "axis"), a.markers.position_px, "px", "markers in the reference frame")
    put("position", ("frame", "marker", "axis"), a.tracks.position_px, "px", "position of each marker")
    put("followed", ("frame", "marker"), a.tracks.ok.astype(np.uint8), "1", "0 where the marker was lost")
    if a.tracks.forward_backward_px is not None:
        put("forward_backward", ("marker",), a.tracks.forward_backward_px, "px",
            "median distance by which tracking there and back misses")
    if a.tracks.field is not None:
        f = a.tracks.field
        put("field", ("frame", "axis", "knot_row", "knot_col"), f.coefficients, "px",
            "cubic B-spline coefficients of the displacement from the reference frame")
        put("field_texture", ("texture_row", "texture_col"), f.texture, "1", "mean squared slope of the grey value")
        put("field_origin", ("axis",), f.origin_px, "px", "image position of the first knot cell's corner")
        put("field_spacing", (), f.spacing_px, "px", "distance between knots")
        if f.draws is not None:
            for name, (dims, text) in DRAWS.items():
                put(f"draws_{name}", dims, getattr(f.draws, name), "1" if name in ("stretch", "course") else "px", text)
    if a.tracks.residual is not None:
        put("residual", ("frame",), a.tracks.residual, "1", "what the field leaves unexplained, in standard deviations "
            "of the tissue's grey values")
    if a.time_s is not None:
        put("time", ("frame",), a.time_s, "s", "time of each frame")
    if a.stage_px is not None:
        put("stage", ("frame", "axis"), a.stage_px, "px", "shift of the background from the reference frame")
    b = a.beats
    put("mean_absolute_displacement", ("frame",), b.signal_px, "px", "mean over markers of the distance from rest")
    put("relaxed", ("frame",), b.relaxed.astype(np.uint8), "1", "1 where the tissue rests")
    put("relaxed_position", ("marker", "axis"), b.relaxed_px, "px", "position of each marker at rest")
    put("beat_start", ("beat",), b.start, "frame", "first frame of the beat")
    put("beat_peak", ("beat",), b.peak, "frame", "frame of the largest displacement")
    put("beat_stop", ("beat",), b.stop, "frame", "first frame after the beat")
    put("beat_complete", ("beat",), b.complete.astype(np.uint8), "1",
        "0 where the movie cuts the beat off, or a person left it out")
    put("beat_left_out", ("beat",), b.left_out.astype(np.uint8), "1", "1 where a person left the beat out")
    put("beat_relaxed_position", ("beat", "marker", "axis"), b.beat_relaxed_px, "px", "markers at rest around the beat")
    put("grid_point", ("point", "axis"), a.grid.point_px, "px", "grid points at rest")
    put("grid_displacement", ("frame", "point", "axis"), a.grid.displacement_px, "px", "displacement from rest")
    if a.strain is not None:
        s = a.strain
        tensor = ("frame", "subdomain", "i", "j")
        put("F", tensor, s.F, "1", "deformation gradient in the tissue's axes, [[rr, rc], [cr, cc]]")
        put("E", tensor, s.E, "1", "Green-Lagrange strain in the tissue's axes, [[rr, rc], [cr, cc]]")
        put("J", ("frame", "subdomain"), s.J, "1", "area ratio det F")
        put("principal_strain", ("frame", "subdomain", "principal"), s.principal[0], "1", "smaller, larger")
        put("principal_angle", ("frame", "subdomain"), s.principal[1], "degree",
            "direction of the smaller principal strain from the col axis, positive towards +row")
        put("subdomain_center", ("frame", "subdomain", "axis"), s.center_px, "px", "centre, moving with the tissue")
        put("subdomain_corner", ("subdomain", "corner", "axis"), s.corner_px, "px", "corners at rest")
        put("subdomain_markers", ("subdomain",), s.count, "1", "markers in the sub-domain")
        put("subdomain_reason", ("subdomain",), np.array(s.reason, dtype=object), "", "why it has no strain, or empty")
    if a.pillars is not None:
        m = a.pillars
        put("pillar_mask", ("pillar", "image_row", "image_col"), np.stack(m.pillars.masks).astype(np.uint8), "1",
            "1 where the pixel is the pillar")
        put("pillar_center", ("pillar", "axis"), m.pillars.center_px, "px", "middle of the mask")
        put("pillar_shift", ("frame", "pillar", "axis"), m.shift_px, "px", "movement from the reference frame")
        put("pillar_shift_se", ("frame", "pillar", "axis"), m.shift_se_px, "px", "standard error of pillar_shift")
        put("pillar_gain_se", ("pillar",), m.gain_se, "1", "standard error of all motion, as a share of it")
        put("pillar_rotation", ("frame", "pillar"), m.rotation_deg, "degree", "rotation from the reference frame")
    coords: dict[str, Any] = {"axis": list(RC), "i": list(RC), "j": list(RC)}
    if a.strain is not None:
        coords["subdomain"] = list(a.strain.label)
    if a.pillars is not None:
        coords["pillar"] = list(a.pillars.pillars.names)
    return xr.Dataset(out, coords=coords, attrs=_attributes(a))


def _with_errors(data: xr.Dataset, a: Analysis, strain: pd.DataFrame) -> xr.Dataset:
    """Add standard errors, for those who read the file with other tools; `load` makes them anew from the draws."""
    if a.tracks.field is None or a.tracks.field.draws is None:
        return data
    data["grid_displacement_se"] = (("frame", "point", "axis"), displacement_error_at(a, a.grid.point_px).astype("f4"),
                                    {"units": "px", "long_name": "standard error of grid_displacement"})
    if a.strain is not None:
        for letter in ("F", "E"):
            parts = [strain[f"{letter}_{part}_se"] for part in ("rr", "rc", "cr" if letter == "F" else "rc", "cc")]
            error = np.stack([np.asarray(p) for p in parts], axis=-1).reshape(a.strain.F.shape)
            data[f"{letter}_se"] = (("frame", "subdomain", "i", "j"), error.astype("f4"),
                                    {"units": "1", "long_name": f"standard error of {letter}"})
    return data


def _attributes(a: Analysis) -> dict[str, Any]:
    """Everything that is not an array, as JSON text where NetCDF has no type for it."""
    known = {"um_per_px": a.um_per_px} if a.um_per_px is not None else {}
    return {
        "microbundle_schema": SCHEMA, "title": f"microbundle analysis of {a.name}", "name": a.name,
        "verdict": a.verdict, **known, "um_per_px_source": a.um_per_px_source, "time_source": a.time_source,
        "config": a.config.model_dump_json(), "versions": json.dumps(dict(a.versions)),
        "files": json.dumps(a.files), "input_hash": a.input_hash,
        "axis": json.dumps({f.name: np.asarray(getattr(a.masks.axis, f.name)).tolist() for f in fields(TissueAxis)}),
        "masks": json.dumps({"method": a.masks.method, "stability": a.masks.stability}),
        "markers": json.dumps({"reference_frame": a.markers.reference_frame, "quality": a.markers.quality,
                               "spacing_px": a.markers.spacing_px, "coverage_px": a.markers.coverage_px}),
        "tracks": json.dumps({"method": a.tracks.method, "reference_frame": a.tracks.reference_frame,
                              "window_px": a.tracks.window_px, "faintest_px": _finite(a.tracks.faintest_px)}),
        "beats": json.dumps({"noise_px": _finite(a.beats.noise_px), "method": a.beats.method,
                             "detection_limit_px": _finite(a.beats.detection_limit_px)}),
        "grid_shape": list(a.grid.shape), "decisions": json.dumps(a.decisions.as_list()),
        "strain": json.dumps(None if a.strain is None else {
            "grid": a.strain.grid, "side_px": a.strain.side_px, "angle_deg": a.strain.angle_deg}),
        "pillars": json.dumps(None if a.pillars is None else {
            "source": a.pillars.pillars.source, "score": a.pillars.pillars.score, "method": a.pillars.method}),
        "findings": json.dumps({name: [asdict(f) for f in found] for name, found in (
            ("movie", a.movie_findings), ("masks", a.masks.findings), ("markers", a.markers.findings),
            ("tracks", a.tracks.findings), ("beats", a.beats.findings),
            ("pillars", () if a.pillars is None else a.pillars.findings))}),
    }


def _from_dataset(data: xr.Dataset) -> Analysis:
    attr = data.attrs
    found = {name: tuple(Finding(**f) for f in listed) for name, listed in json.loads(attr["findings"]).items()}

    def get(name: str) -> Any:
        return data[name].values

    settings = Config.from_dict(json.loads(attr["config"]), source="its settings")
    axis: dict[str, Any] = {k: np.array(v) if isinstance(v, list) else v
                            for k, v in json.loads(attr["axis"]).items()}
    masks = Masks(get("tissue") > 0, TissueAxis(**axis), **json.loads(attr["masks"]), findings=found["masks"])
    markers = Markers(get("marker_reference"), **json.loads(attr["markers"]), findings=found["markers"])
    field = None if "field" not in data else Field(
        get("field"), get("field_origin"), float(get("field_spacing")), get("field_texture"),
        Draws(**{name: get(f"draws_{name}") for name in DRAWS}) if "draws_course" in data else None)
    about_tracks = json.loads(attr["tracks"])
    about_tracks["faintest_px"] = _number(about_tracks["faintest_px"])
    tracks = Tracks(get("position"), get("followed") > 0, **about_tracks, findings=found["tracks"],
                    forward_backward_px=get("forward_backward") if "forward_backward" in data else None,
                    field=field, residual=get("residual") if "residual" in data else None)
    noise = json.loads(attr["beats"])
    beats = Beats(
        get("mean_absolute_displacement"), _number(noise["noise_px"]), get("beat_start"), get("beat_peak"),
        get("beat_stop"), get("beat_complete") > 0, get("relaxed") > 0, get("relaxed_position"),
        get("beat_relaxed_position"), noise["method"], detection_limit_px=_number(noise["detection_limit_px"]),
        findings=found["beats"], left_out=get("beat_left_out") > 0)
    rows, cols = (int(n) for n in attr["grid_shape"])
    about = json.loads(attr["strain"])
    strain = None if about is None else Strain(
        tuple(str(name) for name in get("subdomain")), tuple(about["grid"]), tuple(about["side_px"]),
        get("subdomain_corner"), about["angle_deg"], get("subdomain_center"), get("F"), get("subdomain_markers"),
        tuple(str(text) for text in get("subdomain_reason")))
    return Analysis(
        name=str(attr["name"]), image=get("image"), time_s=get("time") if "time" in data else None,
        time_source=attr["time_source"], um_per_px=float(attr["um_per_px"]) if "um_per_px" in attr else None,
        um_per_px_source=attr["um_per_px_source"], config=settings, masks=masks,
        markers=markers, tracks=tracks, beats=beats,
        grid=Grid(get("grid_point"), (rows, cols), get("grid_displacement")), strain=strain,
        movie_findings=found["movie"], files=tuple(json.loads(attr["files"])), input_hash=str(attr["input_hash"]),
        versions=json.loads(attr["versions"]), stage_px=get("stage") if "stage" in data else None,
        pillars=_pillars(data, json.loads(attr["pillars"]), found["pillars"]),
        decisions=Decisions.from_list(json.loads(attr["decisions"]), source="its decisions"),
    )


def _pillars(data: xr.Dataset, about: dict[str, Any] | None, findings: tuple[Finding, ...]) -> PillarMotion | None:
    if about is None:
        return None
    heads = Pillars(tuple(data["pillar_mask"].values > 0), tuple(str(name) for name in data["pillar"].values),
                    data["pillar_center"].values, tuple(about["source"]), tuple(about["score"]))
    return PillarMotion(heads, data["pillar_shift"].values, data["pillar_shift_se"].values,
                        data["pillar_rotation"].values, data["pillar_gain_se"].values, about["method"], findings)


def _finite(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None


def _number(value: float | None) -> float:
    return float("nan") if value is None else value


