"""What the window shows, as files: a table of every point and a picture of every plot."""

from __future__ import annotations

import csv
from collections.abc import Callable, Sequence
from datetime import UTC, datetime
from pathlib import Path

from PySide6.QtGui import QImage

from gui.model import ScanModel
from gui.panels.base import Panel
from gui.points import Point

_COLUMNS: dict[str, Callable[[Point], object]] = {
    "wavelength (nm)": lambda p: p.geometry.wavelength,
    "illumination_zenith (degree)": lambda p: p.geometry.illumination_zenith,
    "illumination_azimuth (degree)": lambda p: p.geometry.illumination_azimuth,
    "sensor_zenith (degree)": lambda p: p.geometry.sensor_zenith,
    "sensor_azimuth (degree)": lambda p: p.geometry.sensor_azimuth,
    "brf": lambda p: p.brf,
    "u_brf": lambda p: p.u_brf,
    "brf_simulated": lambda p: p.simulated,
    "u_brf_simulated": lambda p: p.u_simulated,
    "relative_difference": lambda p: p.score.relative_difference if p.score else None,
    "t": lambda p: p.score.t if p.score else None,
    "level_of_agreement": lambda p: p.score.level if p.score else None,
    "category": lambda p: p.score.category if p.score else None,
    "time (UTC)": lambda p: p.time.isoformat() if p.time else None,
    "quality_flag": lambda p: p.quality_flag if p.brf is not None else None,
    "not measured because": lambda p: p.skipped or None,
}


def write_points(points: list[Point], file: Path) -> None:
    """Write every point with what is known of it; empty cells for what is not."""
    with file.open("w", newline="", encoding="utf-8") as handle:
        writer = csv.writer(handle)
        writer.writerow(_COLUMNS)
        for point in points:
            writer.writerow(["" if value is None else value for value in (get(point) for get in _COLUMNS.values())])


def pictured(panels: Sequence[Panel]) -> dict[str, QImage]:
    """Pictures of the panels that have something to export, by file name; in the Qt thread."""
    return {f"{panel.title.lower().replace(' ', '-')}.png": panel.picture() for panel in panels}


def write_export(folder: Path, points: list[Point], pictures: dict[str, QImage]) -> Path:
    """Write table and pictures; any thread may do this."""
    write_points(points, folder / "points.csv")
    for name, picture in pictures.items():
        picture.save(str(folder / name))
    return folder


def export_folder(model: ScanModel) -> Path:
    """A new folder for an export: inside the run folder, which it belongs to."""
    stem = f"export-{datetime.now(UTC):%Y%m%dT%H%M%SZ}"
    home = Path(model.run_dir) if model.run_dir and Path(model.run_dir).is_dir() else Path.cwd()
    for number in range(1, 1000):
        folder = home / (stem if number == 1 else f"{stem}-{number}")
        if not folder.exists():
            folder.mkdir()
            return folder
    raise FileExistsError(f"{home / stem}: exists already")
