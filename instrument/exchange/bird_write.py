"""A run or a prediction as a file of the universal BRDF data format 1.0 (:mod:`instrument.exchange.bird`).

The standard arrays hold what every reader of the format understands. What it has no place for (signed angles, times,
components of the uncertainty with their correlation) goes into ``metadata.adhoc_section.goniotwin``: reading the file
back loses nothing but the voltages.
"""

from __future__ import annotations

import hashlib
import json
import math
import uuid
from collections.abc import Mapping
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr

from instrument.angles import FloatArray, fold
from instrument.errors import InputError
from instrument.exchange.bird import LETTERS, SCHEMA, SECTION, SECTION_VERSION, UNSTATED
from instrument.facility import Facility
from instrument.forms import parse_form, parse_toml, read_toml
from instrument.run_axes import POLARIZATIONS
from instrument.run_schema import GEOMETRY

#: First keys of a metadata file; the form's own are no part of what is written.
_METADATA_KEYS = (
    "id",
    "provenance",
    "license",
    "description",
    "instrumentation",
    "software",
    "sample",
    "environment",
    "data_links",
    "comments",
)
#: Required by the schema, and known to people only.
_PEOPLE_KNOW = {
    "provenance": {
        "organization": UNSTATED,
        "location": dict.fromkeys(("country", "city", "street", "building_nr", "postal_code"), UNSTATED),
        # A name that can belong to nobody (RFC 2606): the schema asks for an address.
        "email": "not-stated@invalid",
        "contact_person": UNSTATED,
    },
    "sample": {
        "name": UNSTATED,
        "type": UNSTATED,
        "dimensions": {},
        "shape": UNSTATED,
        "zero_azimuth_location": "azimuth 0 of the laboratory, in the plane that the illumination arm moves in",
    },
}
#: What the schema takes where there is no instrument, and here too where too little of it is stated.
NOT_APPLICABLE = "NA"
#: Required of the light source.
_SOURCE = ("type", "power")
_COORDINATES = (*GEOMETRY, "sample_rotation", "repetition", "time")


def read_metadata(path: Path) -> dict[str, Any]:
    """What people add to a file: ``form = "BiRD metadata"``, ``version = 1`` and tables named as in the format.

    Raises
    ------
    InputError
        For another form or version, or a table that the format does not have.
    """
    content = read_toml(path)
    if (content.pop("form", None), content.pop("version", None)) != ("BiRD metadata", 1):
        raise InputError(f'{path}: expected form = "BiRD metadata" and version = 1')
    for name in content:
        if name not in _METADATA_KEYS:
            raise InputError(f"{path}: {name}: unknown; expected {', '.join(_METADATA_KEYS)}")
    return content


def bird_document(
    run: xr.Dataset, source: str, *, simulated: bool = False, metadata: Mapping[str, Any] | None = None
) -> dict[str, Any]:
    """A run or a prediction as the object that a file of the format holds.

    Parameters
    ----------
    run
        Checked against the data contract.
    source
        Name of the file, for messages.
    simulated
        Whether it is a prediction.
    metadata
        What people add (:func:`read_metadata`); wins over what the run tells.

    Raises
    ------
    InputError
        For a value that the format has no room for: a zenith of 90 degrees, a negative reflectance.
    """
    arrays = _arrays(run, source)
    told = _told(run, source, simulated)
    stated = _merged(_merged(_PEOPLE_KNOW, told), metadata or {})
    if _source_unknown(stated["instrumentation"]):
        stated["instrumentation"] = NOT_APPLICABLE
    head: dict[str, Any] = {
        "schema": SCHEMA,
        "id": _identity(run, arrays),
        "type": "BRDF",
        "timestamp": _timestamp(run),
        **stated,
        "method": "simulation" if simulated else "measurement",
        "adhoc_section": {SECTION: _section(run)},
    }
    return {"metadata": head, "data": arrays}


def unstated(document: Mapping[str, Any]) -> list[str]:
    """Keys of the metadata that the format requires and nobody has stated."""

    def look(value: Any, path: str) -> list[str]:
        if isinstance(value, Mapping):
            return [name for key, item in value.items() for name in look(item, f"{path}.{key}" if path else key)]
        return [path] if value in (UNSTATED, _PEOPLE_KNOW["provenance"]["email"]) else []

    head = document["metadata"]
    names = look({name: head.get(name) for name in ("provenance", "sample", "instrumentation")}, "")
    if head["instrumentation"] == NOT_APPLICABLE and head["method"] == "measurement":
        names += [f"instrumentation.illumination_system.source.{key}" for key in _SOURCE]
    return names


def _source_unknown(instrumentation: Any) -> bool:
    """Whether the schema would refuse the instrument: of its light source nobody stated what a run does not know."""
    if not isinstance(instrumentation, Mapping):
        return False
    known = instrumentation.get("illumination_system", {}).get("source", {})
    return any(key not in known for key in _SOURCE)


def _arrays(run: xr.Dataset, source: str) -> dict[str, Any]:
    turned = run["sample_rotation"].values if "sample_rotation" in run else 0.0
    arrays: dict[str, Any] = {"wavelength_i": {"unit": "nm", "values": _list(run["wavelength"].values)}}
    if "polarization" in run:
        letters = {word: letter for letter, word in LETTERS.items()}
        words = [POLARIZATIONS[int(code)] for code in run["polarization"].values]
        arrays["polarization_i"] = {"notation": "sp", "values": [letters[word] for word in words]}
    for letter, arm in (("i", "illumination"), ("r", "sensor")):
        zenith, azimuth = fold(run[f"{arm}_zenith"].values, run[f"{arm}_azimuth"].values - turned)
        _refuse(zenith >= 90.0, zenith, f"{source}: {arm}_zenith", "less than 90 degrees")
        # What is a rounding error below 0 becomes 360 itself, which the format excludes.
        azimuth = np.where(azimuth >= 360.0, 0.0, azimuth)
        arrays |= {
            f"theta_{letter}": {"unit": "deg", "values": _list(zenith)},
            f"phi_{letter}": {"unit": "deg", "values": _list(azimuth)},
        }
    brf = run["brf"].values
    _refuse(brf < 0, brf, f"{source}: brf", "0 or more, the format has no negative BRDF")
    comment = "Standard uncertainty (k = 1)."
    return arrays | {
        "BRDF": {"unit": "1/sr", "values": _list(brf / np.pi), "comments": "Reflectance factor over pi."},
        "uBRDF": {"unit": "1/sr", "values": _list(run["u_brf"].values / np.pi), "comments": comment},
    }


def _refuse(bad: np.ndarray, values: FloatArray, name: str, expected: str) -> None:
    if np.any(bad):
        point = int(np.argmax(bad))
        raise InputError(f"{name}: found {values[point]:g} at point {point}; expected {expected}")


def _list(values: FloatArray) -> list[float]:
    return [float(value) + 0.0 for value in np.asarray(values, dtype=float)]


def _identity(run: xr.Dataset, arrays: Mapping[str, Any]) -> str:
    """The same for the same measurement, whenever it is written: a URN made of the journal's digest, or of the data."""
    digest = str(run.attrs.get("journal_digest", ""))
    content = digest or hashlib.sha256(json.dumps(arrays, sort_keys=True).encode()).hexdigest()
    return uuid.uuid5(uuid.NAMESPACE_OID, f"goniotwin:{content}").urn


def _timestamp(run: xr.Dataset) -> str:
    if "time" in run.variables:
        return f"{np.datetime_as_string(run['time'].values.min(), unit='s')}+00:00"
    return datetime.now(UTC).isoformat(timespec="seconds")


def _told(run: xr.Dataset, source: str, simulated: bool) -> dict[str, Any]:
    """What the run itself says."""
    attributes = {name: str(value) for name, value in run.attrs.items()}
    kind = "Predicted" if simulated else "Measured"
    sample, title = attributes.get("sample", "a sample"), attributes.get("title", "scan")
    told: dict[str, Any] = {
        "description": f"{kind} reflectance of {sample}: {title}, {run.sizes['point']} points.",
        "software": {"name": "goniotwin", "version": version("goniotwin")},
        "instrumentation": NOT_APPLICABLE,
        "environment": _environment(run),
    }
    if "sample" in attributes:
        told["sample"] = {"name": attributes["sample"]}
    if simulated:
        told["software"]["simulation_model"] = {
            "name": "ray-traced twin",
            "description": "Path tracing of the sample's solid with a tabulated BRDF, seen by the instrument's optics.",
        }
    elif "facility" in attributes:
        told["instrumentation"] = _instrumentation(run, attributes, source)
    else:
        told["comments"] = "The instrument is not stated in the file that this one was made of."
    return told


def _environment(run: xr.Dataset) -> Any:
    """Mean temperature and humidity while the points were read; the schema wants a temperature or nothing."""
    if "environment_temperature" not in run or run["environment_temperature"].attrs.get("units") != "degC":
        return NOT_APPLICABLE
    found: dict[str, Any] = {
        "temperature": {"value": float(run["environment_temperature"].values.mean()), "unit": "°C"}
    }
    if "environment_humidity" in run and run["environment_humidity"].attrs.get("units") == "%":
        found["relative_humidity"] = {"value": float(run["environment_humidity"].values.mean()), "unit": "%"}
    return found


def _instrumentation(run: xr.Dataset, attributes: Mapping[str, str], source: str) -> dict[str, Any]:
    where = f"{source}: facility"
    facility = parse_form(parse_toml(attributes["facility"], where), Facility, where)
    sensor = facility.sensor
    half_rad = math.atan2(sensor.mirror_diameter / 2, sensor.mirror_distance)
    solid_angle = {"value": 2 * math.pi * (1 - math.cos(half_rad)), "unit": "sr"}
    wavelengths = run["wavelength"].values
    span = {"min_value": float(wavelengths.min()), "max_value": float(wavelengths.max()), "unit": "nm"}
    told: dict[str, Any] = {
        "name": facility.name,
        "operation_type": "relative",
        "illumination_system": {
            "name": UNSTATED,
            "source": {"name": UNSTATED, "wl_range": span},
            "beam": _beam(facility),
        },
        "detection_system": {
            "name": UNSTATED,
            # Of the sensor itself the run knows nothing; it has seen these wavelengths.
            "sensors": [{"name": UNSTATED, "spectral_response_range": span}],
            "solid_angle": solid_angle,
        },
        "reference_info": {"name": attributes.get("reference_standard", UNSTATED), "solid_angle": solid_angle},
    }
    if "operator" in attributes:
        told["operator_name"] = attributes["operator"]
    return told


def _beam(facility: Facility) -> dict[str, Any]:
    diameter, across = facility.beam.diameter, facility.beam.diameter_across
    if diameter == "unbounded":
        return {"shape": "unbounded", "dimensions": {"area": {"value": 0.0, "unit": "mm^2"}}}
    area = {"value": math.pi / 4 * diameter * (across or diameter), "unit": "mm^2"}
    if across is None:
        return {"shape": "circular", "dimensions": {"diameter": {"value": diameter, "unit": "mm"}, "area": area}}
    return {"shape": "elliptical", "dimensions": {"area": area}}


def _merged(low: Mapping[str, Any], high: Mapping[str, Any]) -> dict[str, Any]:
    """Tables joined key by key; where both state a value the higher one holds."""
    result = dict(low)
    for key, value in high.items():
        known = result.get(key)
        both = isinstance(known, Mapping) and isinstance(value, Mapping)
        result[key] = _merged(known, value) if both else value  # type: ignore[arg-type]
    return result


def _section(run: xr.Dataset) -> dict[str, Any]:
    """What the format has no place for, by name in the data contract."""
    names = [name for name in _COORDINATES if name in run.variables]
    names += [
        str(n) for n in run.data_vars if str(n).startswith(("u_brf_", "err_corr_", "brf_")) or n == "quality_flag"
    ]
    variables = {name: _variable(run[name]) for name in names if set(run[name].dims) <= {"point", "point_2"}}
    attributes = {str(name): _plain(value) for name, value in run.attrs.items()}
    brf = {str(name): _plain(value) for name, value in run["brf"].attrs.items()}
    return {"version": SECTION_VERSION, "attributes": attributes, "brf": brf, "variables": variables}


def _variable(array: xr.DataArray) -> dict[str, Any]:
    if array.dtype.kind == "M":
        values: Any = [f"{text}Z" for text in np.datetime_as_string(array.values, unit="ns")]
    else:
        values = _plain(array.values)
    attributes = {str(name): _plain(value) for name, value in array.attrs.items()}
    return {"dims": list(array.dims), "type": array.dtype.kind, "values": values, "attributes": attributes}


def _plain(value: Any) -> Any:
    """As JSON; what is infinite (degrees of freedom) as text, since JSON has no number for it."""
    if isinstance(value, np.ndarray | np.generic):
        value = value.tolist()
    if isinstance(value, list | tuple):
        return [_plain(item) for item in value]
    if isinstance(value, float) and not math.isfinite(value):
        return repr(value)
    return value
