"""What was measured of the sample and of its material (paper, Tables III and IV; Figs. 10 to 12, 18 to 20)."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from typing import TypeVar

import numpy as np
import xarray as xr

from instrument.angles import FloatArray
from twin.comparison import UNUSABLE_FLAGS
from twin.report.curves import PANELS, draw_principal, draw_symmetric, panels_height
from twin.report.document import Block, Columns, LeftOut, Plot, Table, Words
from twin.report.facets import Facet, by_light, by_plane, geometry, mirrored_rows
from twin.report.maps import Scale, draw_maps, map_height
from twin.report.words import listed, span

T = TypeVar("T")
#: Maps in one figure, and figures of a kind at most; a run of many wavelengths would fill a book.
_MAPS, _MOST = 9, 6
_NONE = "no point has a value, or all are flagged saturated, overloaded or shadowed"
_MIRROR = (
    "the point that the plane of incidence mirrors into it (at normal incidence, in a plane that is its own mirror"
    " image, the point on the other side of the normal)"
)


def usable(run: xr.Dataset) -> xr.Dataset:
    """Points with a reflectance factor that are not flagged saturated, overloaded or shadowed."""
    keep = np.isfinite(run["brf"].values) & np.isfinite(run["u_brf"].values)
    if "quality_flag" in run:
        keep &= (np.nan_to_num(run["quality_flag"].values).astype(np.int64) & UNUSABLE_FLAGS) == 0
    return run.isel(point=np.flatnonzero(keep))


def relative_u(run: xr.Dataset) -> FloatArray:
    """Combined standard uncertainty in per cent of the reflectance factor, of the points where that is not 0."""
    brf, u = (run[name].values.astype(float) for name in ("brf", "u_brf"))
    some = brf != 0
    return 100 * u[some] / np.abs(brf[some])


def space_table(run: xr.Dataset, name: str, counterpart: str, what: str) -> Table:
    """The angles and wavelengths that were measured, a row a quantity; sensor azimuths by illumination."""
    rows = [
        ["wavelength", listed(run["wavelength"].values) + " nm"],
        ["illumination azimuth", listed(run["illumination_azimuth"].values) + "°"],
        ["illumination zenith", listed(run["illumination_zenith"].values) + "°"],
    ]
    zeniths = run["illumination_zenith"].values
    planes = {float(z): listed(run["sensor_azimuth"].values[zeniths == z]) for z in dict.fromkeys(zeniths.tolist())}
    if len(set(planes.values())) == 1:
        rows.append(["sensor azimuth", f"{next(iter(planes.values()))}°"])
    else:
        rows += [[f"sensor azimuth at illumination zenith {z:g}°", f"{said}°"] for z, said in planes.items()]
    rows.append(["sensor zenith", listed(run["sensor_zenith"].values) + "°"])
    if "sample_rotation" in run.variables:
        rows.append(["rotation of the sample", listed(run["sample_rotation"].values) + "°"])
    rows.append(["points measured", str(run.sizes["point"])])
    rows.append(["reflectance factor", span(run["brf"].values, 4)])
    rows.append(["combined standard uncertainty", span(relative_u(run), 2, "%")])
    return Table(name, f"What was measured of {what}.", ["quantity", "values"], rows, (), counterpart)


def map_plots(run: xr.Dataset, name: str, counterpart: str, what: str) -> list[Block]:
    """Polar maps by illumination, as many figures as they need."""
    data = geometry(run) | {"brf": run["brf"].values, "u_brf": run["u_brf"].values}
    facets = by_light(run)
    low, high = float(np.min(run["brf"].values)), float(np.max(run["brf"].values))
    apart = max(0.0, 0.01 * abs(high) - (high - low)) / 2  # one colour for values that hardly differ
    scale = Scale("reflectance factor", "viridis", (low - apart, high + apart))
    caption = (
        f"Reflectance factor of {what} by illumination over the sensor's direction: from the centre its zenith, around"
        " it its azimuth. White dots are the points that were measured; nothing is drawn between them."
    )

    def plot(chosen: Sequence[Facet], stem: str, said: str) -> Plot:
        own, moved = part(data, chosen)
        draw = partial(draw_maps, data=own, facets=moved, name="brf", scale=scale)
        return Plot(stem, said, map_height(len(chosen)), draw, own, counterpart)

    return in_parts(facets, _MAPS, name, caption, plot)


def in_parts(
    panels: Sequence[T], size: int, name: str, caption: str, plot: Callable[[Sequence[T], str, str], Plot]
) -> list[Block]:
    """Figures of so many panels each; more than :data:`_MOST` of them are not drawn, and that is said."""
    parts = [panels[start : start + size] for start in range(0, len(panels), size)]
    many = len(parts) > 1
    blocks: list[Block] = [
        plot(part, f"{name}_{k}" if many else name, f"{caption} Part {k} of {len(parts)}." if many else caption)
        for k, part in enumerate(parts[:_MOST], start=1)
    ]
    if len(parts) > _MOST:
        left = len(panels) - _MOST * size
        blocks.append(LeftOut(f"{left} further panels of {name}", f"a report draws {_MOST * size} panels of a kind"))
    return blocks


def symmetric_plots(
    data: xr.Dataset, name: str, counterpart: str, what: str, *, isotropic: bool, further: str = ""
) -> list[Block]:
    """Every plane with what symmetry makes equal to it."""
    facets = by_plane(data)
    brf, u = (data[column].values.astype(float) for column in ("brf", "u_brf"))
    other, u_other = np.full(len(brf), np.nan), np.full(len(brf), np.nan)
    for facet in facets:
        rows = mirrored_rows(data, facet, isotropic=isotropic)
        there = rows >= 0
        other[facet.rows[there]], u_other[facet.rows[there]] = brf[rows[there]], u[rows[there]]
    columns = geometry(data) | {"brf": brf, "u_brf": u, "brf_symmetric": other, "u_brf_symmetric": u_other}
    caption = f"{what}, every plane. Thick bars: standard uncertainty (k = 1); thin ones with tips: twice that."
    if np.any(np.isfinite(other)):
        alike = "an isotropic sample is" if isotropic else "a square array of holes is"
        caption += f" Symmetric: {_MIRROR}, as {alike} alike there."
    else:
        caption += " No two planes of this run are mirror images of each other."
    caption += further

    def plot(chosen: Sequence[Facet], stem: str, said: str) -> Plot:
        own, moved = part(columns, chosen)
        draw = partial(draw_symmetric, data=own, facets=moved)
        return Plot(stem, said, panels_height(len(chosen)), draw, own, counterpart)

    return in_parts(facets, PANELS, name, caption, plot)


def principal_plot(run: xr.Dataset, name: str, counterpart: str, what: str) -> Block:
    """The plane of incidence for every illumination."""
    turned = np.mod(run["sensor_azimuth"].values - run["illumination_azimuth"].values, 180.0)
    inside = run.isel(point=np.flatnonzero(np.minimum(turned, 180.0 - turned) < 1e-6))
    if not inside.sizes["point"]:
        return LeftOut(f"{counterpart}: principal plane of {what}", "no point lies in the plane of incidence")
    # Azimuth 180 is azimuth 0 with the other sign of the zenith.
    behind = np.mod(inside["sensor_azimuth"].values - inside["illumination_azimuth"].values, 360.0) > 90.0
    zenith = np.where(behind, -1.0, 1.0) * inside["sensor_zenith"].values
    data: dict[str, FloatArray] = geometry(inside) | {"brf": inside["brf"].values, "u_brf": inside["u_brf"].values}
    data["sensor_zenith"] = zenith
    caption = (
        f"Reflectance factor of {what} in the plane of incidence; negative sensor zenith: azimuth + 180°. Bars:"
        " standard uncertainty (k = 1). Where the sensor would shade the light (retro-reflection) there is no point."
    )
    return Plot(name, caption, 3.1, partial(draw_principal, data=data, facets=by_light(inside)), data, counterpart)


def material_blocks(run: xr.Dataset, whose: str) -> list[Block]:
    """Table III and Figs. 10, 11 and 18 of a flat sample."""
    kept = usable(run)
    if not kept.sizes["point"]:
        return [LeftOut("Table III, Figs. 10, 11 and 18: measurement of the material", _NONE)]
    return [
        Words(whose),
        space_table(kept, "table_03_material_space", "Table III", "the material"),
        *map_plots(kept, "fig_10_material_maps", "Fig. 10", "the material"),
        principal_plot(kept, "fig_11_material_principal_plane", "Fig. 11", "the material"),
        *symmetric_plots(kept, "fig_18_material_all", "Fig. 18", "Reflectance factor of the material", isotropic=True),
    ]


def sample_blocks(run: xr.Dataset) -> list[Block]:
    """Table IV and Figs. 12 and 19 of a sample with a structure, or of one that nothing is known of."""
    kept = usable(run)
    if not kept.sizes["point"]:
        return [LeftOut("Table IV, Figs. 12 and 19: measurement of the sample", _NONE)]
    lost = run.sizes["point"] - kept.sizes["point"]
    said = [Words(f"{lost} points without a value, or flagged saturated, overloaded or shadowed, are not drawn.")]
    return [
        space_table(kept, "table_04_sample_space", "Table IV", "the sample"),
        *(said if lost else ()),
        *map_plots(kept, "fig_12_sample_maps", "Fig. 12", "the sample"),
        *symmetric_plots(
            kept, "fig_19_sample_all", "Fig. 19", "Measured reflectance factor of the sample", isotropic=False
        ),
    ]


def part(data: Columns, facets: Sequence[Facet]) -> tuple[dict[str, np.ndarray], list[Facet]]:
    """The rows of some facets alone, and the facets with the rows that they have then."""
    rows = np.concatenate([facet.rows for facet in facets])
    ends = np.cumsum([len(facet.rows) for facet in facets])
    moved = [
        Facet(facet.title, np.arange(end - len(facet.rows), end), facet.light)
        for facet, end in zip(facets, ends, strict=True)
    ]
    return {name: np.asarray(values)[rows] for name, values in data.items()}, moved
