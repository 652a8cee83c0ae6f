"""Cells of the plan table: how values are written and read, and the plan as TOML that comes of them."""

from __future__ import annotations

import tomllib
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import tomli_w

from instrument.errors import InputError

#: Key in the plan, and the head of its column.
COLUMNS = {
    "wavelength": "Wavelength (nm)",
    "illumination_zenith": "Illumination\nzenith (°)",
    "sensor_azimuth": "Sensor\nazimuth (°)",
    "sensor_zenith": "Sensor\nzenith (°)",
}
HOW = "Values with commas: 0, 15, 30. Or start : stop : step, as in -80 : 80 : 5."


def cell_text(value: Any) -> str:
    """A value of a plan as it stands in a cell."""
    if isinstance(value, dict):
        return " : ".join(f"{value.get(key, 0):g}" for key in ("start", "stop", "step"))
    if isinstance(value, list | tuple):
        return ", ".join(f"{each:g}" if isinstance(each, int | float) else str(each) for each in value)
    return f"{value:g}" if isinstance(value, int | float) else str(value)


def cell_value(text: str) -> list[float] | dict[str, float]:
    """What a cell means: a list of numbers, or start, stop and step.

    Raises
    ------
    ValueError
        Saying what was expected.
    """
    text = text.replace("−", "-").replace("°", "").strip()
    if not text:
        raise ValueError(f"empty; expected values. {HOW}")
    if ":" in text:
        parts = [_number(part) for part in text.split(":")]
        if len(parts) != 3:
            raise ValueError(f"found {len(parts)} numbers between colons; expected start : stop : step")
        return dict(zip(("start", "stop", "step"), parts, strict=True))
    return [_number(part) for part in text.replace(";", ",").split(",") if part.strip()]


def _number(text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        raise ValueError(f"found {text.strip()!r}; expected a number. {HOW}") from None
    if value != value or value in (float("inf"), float("-inf")):
        raise ValueError(f"found {text.strip()!r}; expected a finite number")
    return value


@dataclass
class PlanDraft:
    """A plan while it is edited.

    Attributes
    ----------
    content
        As in the file; keys that the table does not show stay as they are.
    path
        The file; None for a plan that was never saved.
    """

    content: dict[str, Any] = field(default_factory=lambda: new_content())  # noqa: PLW0108 - defined below
    path: Path | None = None

    @classmethod
    def read(cls, path: Path) -> PlanDraft:
        """Read a plan file.

        Raises
        ------
        InputError
            If it cannot be read, or is no TOML.
        """
        from instrument.files import text_of

        try:
            return cls(tomllib.loads(text_of(path)), path)
        except tomllib.TOMLDecodeError as error:
            raise InputError(f"{path}: {error}") from None

    @property
    def list_key(self) -> str:
        """The key under which the parts stand."""
        return "part" if "part" in self.content else "grid"

    @property
    def parts(self) -> list[dict[str, Any]]:
        """Grids (and tables of points) in order."""
        parts: list[dict[str, Any]] = self.content.setdefault(self.list_key, [])
        return parts

    def further(self, row: int) -> str:
        """What a part says beyond the columns."""
        rest = {key: value for key, value in self.parts[row].items() if key not in COLUMNS}
        return "; ".join(f"{key.replace('_', ' ')} {cell_text(value)}" for key, value in rest.items())

    def add(self) -> None:
        """Append a part like the last one."""
        grids = [part for part in self.parts if "table" not in part]
        self.parts.append(dict(grids[-1]) if grids else dict(new_content()["grid"][0]))

    def text(self) -> str:
        """The plan as TOML."""
        return tomli_w.dumps(self.content)

    def save(self, path: Path) -> None:
        """Write the plan.

        Raises
        ------
        InputError
            If the file cannot be written.
        """
        from instrument.output import write_result

        write_result(path, self.text().encode())
        self.path = path


def new_content() -> dict[str, Any]:
    """A small plan to begin with."""
    return {
        "version": 1,
        "title": "new plan",
        "samples": 9,
        "direction": "unidirectional",
        "grid": [
            {
                "wavelength": [500.0],
                "illumination_zenith": [0.0],
                "sensor_azimuth": [0.0],
                "sensor_zenith": {"start": -60.0, "stop": 60.0, "step": 10.0},
            }
        ],
    }
