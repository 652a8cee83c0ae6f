"""A small run, its prediction and the files beside them that tests of the report share."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import xarray as xr
from matplotlib.figure import FigureBase

from twin.report.document import Block, Document, Plot

UNITS = {"wavelength": "nm"} | dict.fromkeys(
    ("illumination_zenith", "illumination_azimuth", "sensor_zenith", "sensor_azimuth"), "degree"
)
#: Illumination zenith and sensor azimuth of the planes of :func:`geometries`.
PLANES = ((0.0, 0.0), (0.0, 90.0), (15.0, 0.0), (15.0, 50.0), (15.0, 130.0))
#: Relative differences of every plane, and standard uncertainties whose combination is 0.01.
DIFFERENCES, U_MEASURED, U_SIMULATED = (0.03, -0.015, 0.05), 0.006, 0.008
ARTIFACT = """
holes = "holes.csv"
outline = [20.0, 20.0]
plate_thickness = 1.0
u_plate_thickness = 0.02
cavity_depth = 3.0
u_cavity_depth = 0.03
"""
HOLES = """hole,x_mm,y_mm,diameter_mm,u_x_mm,u_y_mm,u_diameter_mm
1,0.0,0.0,2.0,0.003,0.001,0.01
2,4.0,0.0,2.2,0.003,0.001,0.01
3,0.0,4.2,2.4,0.003,0.001,0.01
4,4.0,4.2,2.6,0.003,0.001,0.03
"""


def dataset(rows, **columns: np.ndarray) -> xr.Dataset:
    """Points with their geometry, and columns without unit."""
    table = np.array(rows, dtype=float)
    coordinates = {name: ("point", table[:, k], {"units": unit}) for k, (name, unit) in enumerate(UNITS.items())}
    return xr.Dataset({name: ("point", v, {"units": "1"}) for name, v in columns.items()}, coords=coordinates)


def geometries() -> list[tuple[float, ...]]:
    return [(500.0, zenith, 0.0, sensor, azimuth) for zenith, azimuth in PLANES for sensor in (40.0, -30.0, -40.0)]


def sketch(document: Document, height: float = 0.2) -> Document:
    """The same report with empty figures of one height in inch, which are drawn at once."""
    sections = [
        replace(section, blocks=[_empty(block, height) for block in section.blocks]) for section in document.sections
    ]
    return replace(document, sections=sections)


def _empty(block: Block, height: float) -> Block:
    return replace(block, draw=_nothing, height=height) if isinstance(block, Plot) else block


def _nothing(figure: FigureBase) -> None:
    return None


def pair() -> tuple[xr.Dataset, xr.Dataset]:
    """A run of reflectance factor 0.5 everywhere, and a prediction that differs by the same amounts in every plane."""
    rows = geometries()
    measured, many = np.full(len(rows), 0.5), np.ones(len(rows))
    simulated = measured * (1 + np.tile(DIFFERENCES, len(PLANES)))
    run = dataset(rows, brf=measured, u_brf=U_MEASURED * many)
    return run, dataset(rows, brf=simulated, u_brf=U_SIMULATED * many, u_brf_monte_carlo=0.001 * many)
