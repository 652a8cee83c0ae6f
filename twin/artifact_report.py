"""What a sample is, in numbers: its dimensions, the areas of its surfaces, its volume."""

from __future__ import annotations

from typing import Any

import numpy as np

from instrument.angles import FloatArray
from instrument.artifact import ArtifactDimensions
from twin.artifact import Surface, SurfaceMesh


def artifact_report(dimensions: ArtifactDimensions, mesh: SurfaceMesh) -> dict[str, Any]:
    """Numbers for :func:`report_table` and ``--json``; lengths in mm, areas in mm2, the volume in mm3.

    ``narrowest_web`` is the least width of plate between two holes with their chamfers, or None for fewer than two.
    """
    form, holes = dimensions.form, dimensions.holes
    areas = mesh.areas()
    low, high = mesh.vertices.min(axis=0), mesh.vertices.max(axis=0)
    report: dict[str, Any] = {
        "source": str(dimensions.source),
        "mesh": None if dimensions.mesh is None else str(dimensions.mesh),
        "size": (high - low).tolist(),
        "volume": mesh.volume(),
        "area": {surface.name.lower(): float(areas[mesh.labels == surface].sum()) for surface in Surface},
        "faces": len(mesh.faces),
        "open_edges": mesh.open_edges(),
        "holes": len(holes),
    }
    if len(holes) and dimensions.mesh is None:
        report |= {
            "diameter": _span(holes.diameter),
            "chamfer": _span(dimensions.chamfers),
            "narrowest_web": _narrowest_web(dimensions),
            "plate_thickness": form.plate_thickness,
            "cavity_depth": form.cavity_depth,
            "spacer_edge": form.spacer_edge,
            "block_tilt": [form.block_tilt_x, form.block_tilt_y],
        }
    return report


def report_table(report: dict[str, Any]) -> Any:
    """The report as a table for the terminal."""
    from rich.table import Table

    table = Table(title=report["source"], show_header=False, title_justify="left")
    for name, value in _rows(report):
        table.add_row(name, value)
    return table


def _rows(report: dict[str, Any]) -> list[tuple[str, str]]:
    rows = [("outline and height", " x ".join(f"{side:.3f}" for side in report["size"]) + " mm")]
    if report["mesh"] is not None:
        rows.append(("mesh", report["mesh"]))
    elif report["holes"]:
        low, high = report["diameter"]
        rows.append(("holes", f"{report['holes']}, diameters {low:.4f} to {high:.4f} mm"))
        if report["chamfer"][1] > 0:
            rows.append(("chamfers", "{:.4f} to {:.4f} mm, 45 degrees".format(*report["chamfer"])))
        if report["narrowest_web"] is not None:
            rows.append(("narrowest web", f"{report['narrowest_web']:.4f} mm"))
        rows.append(("plate", f"{report['plate_thickness']:g} mm thick"))
        kind = "closed" if report["spacer_edge"] > 0 else "open at the sides"
        rows.append(("cavity", f"{report['cavity_depth']:g} mm below the top, {kind}"))
        if any(report["block_tilt"]):
            rows.append(("tilt of the block", "{:g}, {:g} degrees about x, y".format(*report["block_tilt"])))
    else:
        rows.append(("holes", "none: a flat sample"))
    rows.append(("volume", f"{report['volume']:.3f} mm3"))
    names = {name: name.replace("_", " ") for name in report["area"]}
    rows += [(f"area, {names[name]}", f"{area:.3f} mm2") for name, area in report["area"].items() if area > 0]
    closed = "closed" if report["open_edges"] == 0 else f"{report['open_edges']} open edges"
    return [*rows, ("faces", f"{report['faces']}, {closed}")]


def _span(values: FloatArray) -> list[float]:
    return [float(values.min()), float(values.max())]


def _narrowest_web(dimensions: ArtifactDimensions) -> float | None:
    holes, radius = dimensions.holes, dimensions.holes.diameter / 2 + dimensions.chamfers
    if len(holes) < 2:
        return None
    gap = np.hypot(holes.x[:, None] - holes.x, holes.y[:, None] - holes.y) - radius[:, None] - radius
    np.fill_diagonal(gap, np.inf)
    return float(gap.min())
