"""A file of the universal BRDF data format 1.0 as a run (:mod:`instrument.exchange.bird`)."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr

from instrument.angles import FloatArray, direction
from instrument.errors import InputError
from instrument.exchange.bird import (
    AZIMUTHS,
    BRDF_UNITS,
    DEGREE_UNITS,
    LETTERS,
    RADIAN_UNIT,
    REQUIRED,
    SCHEMA,
    SECTION,
    SECTION_VERSION,
    STOKES,
    VERSION,
    WAVELENGTH_UNITS,
    ZENITHS,
)
from instrument.files import text_of
from instrument.run_axes import polarization_column
from instrument.run_check import checked
from instrument.run_schema import RUN

#: How far the angles of our own section may lie from the standard ones: rounding, as a distance of unit vectors.
_ROUNDING = 1e-9
#: Further arrays that vary from point to point and that a run has no coordinate for.
_NOT_READ = "adhoc_variables"


@dataclass(frozen=True)
class Imported:
    """A run that was read from a form of others, and what a person should know of it."""

    run: xr.Dataset
    notes: tuple[str, ...] = ()


def read_bird(path: Path, *, wavelength: float | None = None, u_relative: float | None = None) -> Imported:
    """Read a file of the universal BRDF data format.

    Parameters
    ----------
    wavelength
        nm, for a file that states none.
    u_relative
        Relative standard uncertainty, for a file that states none.

    Raises
    ------
    InputError
        Naming the file and the key: no JSON, another format or version, an array that is missing, of another length or
        unit, a value out of range.
    """
    document = _document(path)
    return imported(document, str(path), wavelength=wavelength, u_relative=u_relative)


def imported(
    document: Mapping[str, Any], source: str, *, wavelength: float | None = None, u_relative: float | None = None
) -> Imported:
    """A run of what a file of the format holds; see :func:`read_bird`."""
    head, data = _parts(document, source)
    arrays = _Arrays(data, source)
    notes: list[str] = []
    columns: dict[str, Any] = {
        "wavelength": _wavelength(arrays, wavelength),
        "illumination_zenith": arrays.angle("theta_i"),
        "illumination_azimuth": arrays.angle("phi_i"),
        "sensor_zenith": arrays.angle("theta_r"),
        "sensor_azimuth": arrays.angle("phi_r"),
        "brf": np.pi * arrays.numbers("BRDF", BRDF_UNITS, least=0.0),
    }
    columns["u_brf"] = _uncertainty(arrays, columns["brf"], u_relative, notes)
    run = xr.Dataset({name: ("point", values) for name, values in columns.items()})
    words = _polarization(arrays)
    if words is not None:
        run = run.assign_coords(
            polarization_column([{"geometry": {"polarization": w}} for w in words], "point", "polarization")
        )
    if _NOT_READ in data:
        notes.append(f"{_NOT_READ}: not read: {', '.join(data[_NOT_READ])}")
    for name in (*columns,):
        run[name].attrs["units"] = RUN[name].unit
    run.attrs = _attributes(head)
    run = _restored(run, head.get("adhoc_section"), source, notes)
    return Imported(checked(run, source, RUN), tuple(notes))


def _document(path: Path) -> Any:
    text = text_of(path, encoding="utf-8-sig")
    try:
        return json.loads(text, parse_constant=_no_number)
    except ValueError as error:
        raise InputError(f"{path}: not JSON, or cut short: {error}") from None


def _no_number(text: str) -> float:
    raise ValueError(f"{text} is no number of JSON")


def _parts(document: Any, source: str) -> tuple[dict[str, Any], dict[str, Any]]:
    for name in ("metadata", "data"):
        if not isinstance(document, Mapping) or not isinstance(document.get(name), Mapping):
            raise InputError(
                f"{source}: {name}: missing; expected a file of the universal BRDF format, version {VERSION}"
            )
    head = document["metadata"]
    schema = str(head.get("schema", ""))
    if not schema.endswith(SCHEMA.rsplit("/", 1)[1]):
        raise InputError(
            f"{source}: metadata.schema: found {schema!r}; this program reads version {VERSION} ({SCHEMA})"
        )
    if head.get("type") != "BRDF":
        raise InputError(f"{source}: metadata.type: found {head.get('type')!r}; expected 'BRDF'")
    return dict(head), dict(document["data"])


class _Arrays:
    """The arrays of a file, checked as they are asked for."""

    def __init__(self, data: Mapping[str, Any], source: str) -> None:
        self._data, self.source = data, source
        missing = [name for name in REQUIRED if name not in data]
        if missing:
            raise InputError(f"{source}: data: {', '.join(missing)} missing; found {', '.join(data) or 'nothing'}")
        self._length = len(self.values("BRDF"))

    def __contains__(self, name: str) -> bool:
        return name in self._data

    def entry(self, name: str) -> Mapping[str, Any]:
        found = self._data[name]
        if not isinstance(found, Mapping) or not isinstance(found.get("values"), list):
            raise InputError(f"{self.source}: data.{name}: expected an object with a list of values")
        return found

    def values(self, name: str) -> list[Any]:
        values: list[Any] = self.entry(name)["values"]
        expected = getattr(self, "_length", len(values))
        if len(values) != expected:
            raise InputError(f"{self.source}: data.{name}: found {len(values)} values; expected {expected} as in BRDF")
        return values

    def unit(self, name: str, allowed: tuple[str, ...]) -> str:
        found = self.entry(name).get("unit")
        if found not in allowed:
            raise InputError(f"{self.source}: data.{name}.unit: found {found!r}; expected {' or '.join(allowed)}")
        return str(found)

    def numbers(self, name: str, units: tuple[str, ...], *, least: float | None = None) -> FloatArray:
        self.unit(name, units)
        values = self.values(name)
        for point, value in enumerate(values):
            if isinstance(value, bool) or not isinstance(value, int | float):
                raise InputError(f"{self.source}: data.{name}: found {value!r} at point {point}; expected a number")
            if least is not None and value < least:
                raise InputError(
                    f"{self.source}: data.{name}: found {value:g} at point {point}; expected {least:g} or more"
                )
        return np.array(values, dtype=float)

    def angle(self, name: str) -> FloatArray:
        """Degrees."""
        values = self.numbers(name, (*DEGREE_UNITS, RADIAN_UNIT), least=0.0)
        if self.entry(name)["unit"] == RADIAN_UNIT:
            values = np.rad2deg(values)
        most = 90.0 if name in ZENITHS else 360.0
        bad = values > most if name in ZENITHS else values >= most
        if np.any(bad):
            point = int(np.argmax(bad))
            word = "at most" if name not in AZIMUTHS else "less than"
            raise InputError(
                f"{self.source}: data.{name}: found {values[point]:g} at point {point}; expected {word} {most:g} deg"
            )
        return values


def _wavelength(arrays: _Arrays, stated: float | None) -> FloatArray:
    for name in ("wavelength_i", "wavelength_r"):
        if name in arrays:
            values = arrays.numbers(name, tuple(WAVELENGTH_UNITS), least=0.0)
            return values * WAVELENGTH_UNITS[arrays.entry(name)["unit"]]
    if stated is None:
        raise InputError(f"{arrays.source}: data: no wavelength_i and no wavelength_r; say it (--wavelength)")
    return np.full(len(arrays.values("BRDF")), stated)


def _uncertainty(arrays: _Arrays, brf: FloatArray, stated: float | None, notes: list[str]) -> FloatArray:
    """Standard uncertainty of the reflectance factor, from whichever place the file has it in."""
    percent = "%"
    if "uBRDF" in arrays:
        values = arrays.numbers("uBRDF", (*BRDF_UNITS, percent), least=0.0)
        relative = arrays.entry("uBRDF")["unit"] == percent
    elif "uncertainty" in (entry := arrays.entry("BRDF")):
        constant = entry["uncertainty"]
        if not isinstance(constant, Mapping) or constant.get("unit") not in (*BRDF_UNITS, percent):
            raise InputError(f"{arrays.source}: data.BRDF.uncertainty: expected a value with a unit 1/sr, sr^-1 or %")
        values, relative = np.full(len(brf), float(constant["value"])), constant["unit"] == percent
    elif stated is not None:
        return stated * brf
    else:
        raise InputError(
            f"{arrays.source}: data: no uBRDF and no uncertainty of BRDF; say the relative one (--u-relative)"
        )
    notes.append("uncertainties are taken for standard uncertainties (k = 1): the format has no place that says")
    return brf * values / 100 if relative else np.pi * values


def _polarization(arrays: _Arrays) -> list[str] | None:
    if "polarization_r" in arrays:
        raise InputError(
            f"{arrays.source}: data.polarization_r: a run has no place for an analyser of the reflected light"
        )
    if "polarization_i" not in arrays:
        return None
    entry, words = arrays.entry("polarization_i"), []
    known: Mapping[Any, str] = LETTERS if entry.get("notation") == "sp" else STOKES
    for point, value in enumerate(arrays.values("polarization_i")):
        key = tuple(float(v) for v in value) if isinstance(value, list) else value
        if key not in known:
            raise InputError(
                f"{arrays.source}: data.polarization_i: found {value!r} at point {point}; expected s, p or unpolarised"
            )
        words.append(known[key])
    return words


def _attributes(head: Mapping[str, Any]) -> dict[str, Any]:
    """What a run has a place for."""
    sample, provenance = head.get("sample"), head.get("provenance")
    attributes: dict[str, Any] = {
        "title": str(head.get("description", "")),
        "imported_from": f"universal BRDF data format {VERSION}, {head.get('id', 'no id')}",
    }
    if isinstance(sample, Mapping) and "name" in sample:
        attributes["sample"] = str(sample["name"])
    if isinstance(provenance, Mapping) and "organization" in provenance:
        attributes["laboratory"] = str(provenance["organization"])
    return attributes


def _restored(run: xr.Dataset, sections: Any, source: str, notes: list[str]) -> xr.Dataset:
    """The run with what only our own section holds, where the file was written by this program."""
    section = sections.get(SECTION) if isinstance(sections, Mapping) else None
    if section is None:
        return run
    where = f"{source}: metadata.adhoc_section.{SECTION}"
    if not isinstance(section, Mapping) or section.get("version") != SECTION_VERSION:
        notes.append(f"{where}: of another version than {SECTION_VERSION}: not read, the standard arrays are")
        return run
    try:
        kept = xr.Dataset({name: _variable(entry) for name, entry in section["variables"].items()})
        attributes = {name: _attribute(name, value) for name, value in section["attributes"].items()}
        of_brf = {name: _attribute(name, value) for name, value in section["brf"].items()}
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise InputError(f"{where}: damaged ({type(error).__name__}: {error}); take it out to read the rest") from None
    if kept.sizes.get("point") != run.sizes["point"]:
        raise InputError(f"{where}: {kept.sizes.get('point')} points; the data have {run.sizes['point']}")
    _require_same_directions(kept, run, where)
    for name in kept.variables:
        run[name] = kept[name]
    run["brf"].attrs |= of_brf
    run.attrs |= attributes
    return run.set_coords([n for n in ("sample_rotation", "repetition") if n in run])


def _variable(entry: Mapping[str, Any]) -> tuple[list[str], np.ndarray, dict[str, Any]]:
    if entry["type"] == "M":
        values = np.array([text.removesuffix("Z") for text in entry["values"]], dtype="datetime64[ns]")
    else:
        values = np.array(entry["values"], dtype={"i": np.int64, "u": np.uint64, "b": bool}.get(entry["type"], float))
    return list(entry["dims"]), values, {name: _attribute(name, value) for name, value in entry["attributes"].items()}


def _attribute(name: str, value: Any) -> Any:
    if name == "degrees_of_freedom":
        return float(value)
    if isinstance(value, list) and not value:
        return np.zeros(0)
    if isinstance(value, list) and all(isinstance(item, int | float) for item in value):
        return np.array(value)
    return value


def _require_same_directions(kept: xr.Dataset, run: xr.Dataset, where: str) -> None:
    """What was edited in one place only would be read as something that nobody wrote."""
    turned = kept["sample_rotation"].values if "sample_rotation" in kept else 0.0
    apart = np.abs(kept["wavelength"].values - run["wavelength"].values) / 1e3
    for arm in ("illumination", "sensor"):
        ours = direction(kept[f"{arm}_zenith"].values, kept[f"{arm}_azimuth"].values - turned)
        theirs = direction(run[f"{arm}_zenith"].values, run[f"{arm}_azimuth"].values)
        apart = np.maximum(apart, np.linalg.norm(ours - theirs, axis=-1))
    if np.any(apart > _ROUNDING):
        point = int(np.argmax(apart))
        raise InputError(
            f"{where}: says another geometry than data at point {point}; take it out where data were edited"
        )
