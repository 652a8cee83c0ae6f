"""From the journal to the run file."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from datetime import datetime
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr

from instrument.angles import FloatArray
from instrument.calibration import Photocurrent, brf_from_readings, calibration_numbers, photocurrent
from instrument.drift import correct_drift
from instrument.errors import InputError
from instrument.facility import Facility
from instrument.forms import parse_form, parse_toml
from instrument.journal import JournalContent, read_journal
from instrument.monitor import normalised
from instrument.quality.bursts import MOST, SIGNIFICANCE, outliers
from instrument.reference_standard import at_wavelength, described_reference
from instrument.run_axes import STAGES, channels, extra_coordinates, polarization_column
from instrument.run_budget import add_budget
from instrument.run_record import record_attributes
from instrument.run_schema import RUN
from instrument.run_write import described

Record = Mapping[str, Any]
#: Axes whose read-backs a run file holds.
AXES = ("illumination_zenith", "sensor_zenith", "sensor_azimuth")


def build_run(
    header: Record,
    points: Mapping[int, Record] | Iterable[Record],
    references: Sequence[Record],
    facility: Facility,
    *,
    journal_digest: str | None = None,
) -> xr.Dataset:
    """The run file of what a journal holds.

    Parameters
    ----------
    header, points, references
        Records of the journal (``docs/journal.md``); points in any order, by index or not.
    facility
        What the readings are calibrated with.
    journal_digest
        Digest of the journal, kept in the file.

    Returns
    -------
    xarray.Dataset
        Rows in time order; every variable of the data contract, read-backs, source power and surroundings.

    Raises
    ------
    InputError
        If there is no point, or none of the reference, or a point stands before every reference reading.
    """
    rows = sorted(points.values() if isinstance(points, Mapping) else points, key=lambda record: record["time"])
    if not rows:
        raise InputError("no point was measured; a run file needs at least one")
    if not references:
        raise InputError("no reference reading; without one no reflectance factor can be computed")
    columns = _points(rows) | _references(references)
    dataset = xr.Dataset(columns)
    sets = np.array(calibration_numbers(record["index"] for record in references))
    dataset["reference_set"] = ("reference", sets, {"long_name": "which calibration a reference reading belongs to"})
    used = _used_sets(rows, references, sets)
    dataset["point_reference_set"] = ("point", used, {"long_name": "calibration that the point is scaled with"})
    repeated = np.array([bool(record.get("repeated")) for record in references], dtype=np.int8)
    if repeated.any() or facility.reference.repeat_minutes > 0:
        meaning = {"long_name": "1 where the reading belongs to a reference repeated on schedule"}
        dataset["reference_repeated"] = ("reference", repeated, meaning)
    if all("monitor" in record for record in (*rows, *references)):
        meaning = {"units": "V", "long_name": "monitor photodiode during the samples; brf is normalised with it"}
        for name, dimension, records in (("monitor", "point", rows), ("reference_monitor", "reference", references)):
            dataset[name] = (dimension, _column(records, "monitor"), meaning)
    _calibrate(dataset, facility)
    _count_outliers(dataset)
    add_budget(dataset, facility)
    dataset.attrs = _attributes(header, facility, journal_digest)
    further = [name for name in ("sample_rotation", "polarization", "repetition") if name in dataset]
    dataset = dataset.set_coords([name for name, variable in RUN.items() if variable.coordinate] + further)
    return described(dataset, RUN)


def rebuild_run(run_dir: Path) -> xr.Dataset:
    """The run file of a run folder, from its journal alone.

    Raises
    ------
    InputError
        If the folder has no journal, a damaged one, or one that does not suffice for a run file.
    """
    content = read_journal(run_dir)
    return run_of_journal(content)


def run_of_journal(content: JournalContent) -> xr.Dataset:
    """The run file of a journal, calibrated with the facility that its header holds; errors as :func:`build_run`."""
    source = f"{content.path}: header: facility"
    facility = parse_form(parse_toml(content.header["facility"], source), Facility, source)
    try:
        run = build_run(content.header, content.points, content.references, facility, journal_digest=content.digest)
    except InputError as error:
        raise InputError(f"{content.path}: {error}") from None
    run.attrs |= record_attributes(content)
    return run


def _column(rows: Sequence[Record], key: str) -> FloatArray:
    return np.array([row[key] for row in rows], dtype=float)


def _times(rows: Sequence[Record]) -> np.ndarray:
    stamps = [row["time"].isoformat() if isinstance(row["time"], datetime) else row["time"] for row in rows]
    return np.array([stamp.removesuffix("Z").removesuffix("+00:00") for stamp in stamps], dtype="datetime64[ns]")


def _signals(rows: Sequence[Record], what: str) -> FloatArray:
    counts = {len(row["signal"]) for row in rows}
    if len(counts) != 1:
        raise InputError(f"{what} have between {min(counts)} and {max(counts)} samples; expected one number for all")
    return np.array([row["signal"] for row in rows], dtype=float)


def _points(rows: Sequence[Record]) -> dict[str, Any]:
    columns: dict[str, Any] = {
        name: ("point", _column([row["geometry"] for row in rows], name))
        for name in ("wavelength", "illumination_zenith", "illumination_azimuth", "sensor_zenith", "sensor_azimuth")
    }
    columns |= extra_coordinates(rows)
    columns["time"] = ("point", _times(rows))
    columns["signal"] = (("point", "sample"), _signals(rows, "points"))
    columns["dark"] = ("point", _column(rows, "dark"))
    columns["gain"] = ("point", _column(rows, "gain"))
    columns |= _dark_samples(rows, ("point", "dark_sample"), "dark_signal")
    columns["quality_flag"] = ("point", np.array([row.get("quality_flag", 0) for row in rows], dtype=np.int8))
    columns["plan_index"] = ("point", np.array([row["index"] for row in rows]), {"long_name": "index in the plan"})
    for axis in (*AXES, *STAGES):
        if all(axis in row.get("readback", {}) for row in rows):
            columns[f"readback_{axis}"] = (
                "point",
                _column([row["readback"] for row in rows], axis),
                {"units": "degree", "long_name": f"{axis.replace('_', ' ')} read back from the arm"},
            )
    for key, unit, meaning in (
        ("source_power", "1", "power of the source, fraction of full power"),
        ("wavelength_readback", "nm", "wavelength read back from the selector"),
    ):
        if all(row.get(key) is not None for row in rows):
            columns[key] = ("point", _column(rows, key), {"units": unit, "long_name": meaning})
    for name in rows[0].get("environment", {}):
        if all(name in row.get("environment", {}) for row in rows):
            columns[f"environment_{name}"] = (
                "point",
                np.array([row["environment"][name][0] for row in rows], dtype=float),
                {"units": rows[0]["environment"][name][1], "long_name": f"surroundings: {name.replace('_', ' ')}"},
            )
    return columns


def _dark_samples(rows: Sequence[Record], dims: tuple[str, str], name: str) -> dict[str, Any]:
    """Samples without light, where every record has as many of them."""
    counts = {len(row.get("dark_signal") or ()) for row in rows}
    if len(counts) != 1 or 0 in counts:
        return {}
    volts = np.array([row["dark_signal"] for row in rows], dtype=float)
    return {name: (dims, volts, {"units": "V", "long_name": "samples with the shutter closed"})}


def _references(rows: Sequence[Record]) -> dict[str, Any]:
    dark = _dark_samples(rows, ("reference", "reference_dark_sample"), "reference_dark_signal")
    return (
        dark
        | polarization_column(rows, "reference", "reference_polarization")
        | {
            "reference_signal": (("reference", "sample"), _signals(rows, "reference readings")),
            "reference_sensor_azimuth": ("reference", _column([row["geometry"] for row in rows], "sensor_azimuth")),
            "reference_wavelength": (
                "reference",
                _column([row["geometry"] for row in rows], "wavelength"),
                {"units": "nm", "long_name": "wavelength of the reference readings"},
            ),
            "reference_gain": ("reference", _column(rows, "gain")),
            "reference_dark": ("reference", _column(rows, "dark")),
            "reference_time": ("reference", _times(rows)),
        }
    )


def _used_sets(rows: Sequence[Record], references: Sequence[Record], sets: np.ndarray) -> np.ndarray:
    """Calibration of every point: the last one that was begun before it."""
    begun = np.array([_times(references)[sets == number].min() for number in range(sets[-1] + 1)])
    used = np.searchsorted(begun, _times(rows), side="right") - 1
    if np.any(used < 0):
        row = rows[int(np.argmax(used < 0))]
        raise InputError(f"point {row['index']}, taken at {row['time']}, stands before the first reference reading")
    return np.asarray(used)


def _calibrate(dataset: xr.Dataset, facility: Facility) -> None:
    reading = _photocurrent(dataset, "")
    reference = _photocurrent(dataset, "reference_")
    brf, standard_error = np.empty(dataset.sizes["point"]), np.empty(dataset.sizes["point"])
    light, reference_light, names = channels(dataset)
    groups = np.stack([dataset["point_reference_set"].values, light])
    for number, channel in np.unique(groups, axis=1).T:
        rows = (groups[0] == number) & (groups[1] == channel)
        of_set = (dataset["reference_set"].values == number) & (reference_light == channel)
        if not np.any(of_set):
            raise InputError(f"no reference reading at {names[channel]} before the points in that light")
        known = at_wavelength(facility, float(dataset["wavelength"].values[rows][0]))
        result = brf_from_readings(
            known,
            dataset["illumination_zenith"].values[rows],
            dataset["sensor_zenith"].values[rows],
            dataset["sensor_azimuth"].values[rows],
            Photocurrent(reading.current[rows], reading.standard_error[rows]),
            dataset["reference_sensor_azimuth"].values[of_set],
            Photocurrent(reference.current[of_set], reference.standard_error[of_set]),
            illumination_azimuth=dataset["illumination_azimuth"].values[rows],
        )
        brf[rows], standard_error[rows] = result.brf, result.standard_error
    dataset["brf"] = ("point", brf)
    if "reference_repeated" in dataset:
        correct_drift(dataset, facility, reference.current, light, reference_light)
    if np.all(np.isfinite(standard_error)):
        dataset["brf_standard_error"] = (
            "point",
            standard_error,
            {"units": "1", "long_name": "standard error of brf from the scatter of its samples"},
        )


def _photocurrent(dataset: xr.Dataset, of: str) -> Photocurrent:
    dark = dataset[f"{of}dark_signal"].values if f"{of}dark_signal" in dataset else None
    signal, mean_dark, gain = (dataset[f"{of}{name}"].values for name in ("signal", "dark", "gain"))
    reading = photocurrent(signal, mean_dark, gain, dark)
    return normalised(reading, dataset[f"{of}monitor"].values if "monitor" in dataset else None)


def _count_outliers(dataset: xr.Dataset) -> None:
    """How many samples of every burst the outlier test accuses; they stay where they are, and in the means."""
    for name, signal, when in (("outliers", "signal", "with light"), ("dark_outliers", "dark_signal", "in the dark")):
        if signal in dataset:
            dataset[name] = (
                "point",
                outliers(dataset[signal].values).sum(axis=-1).astype(np.int8),
                {
                    "units": "1",
                    "long_name": f"samples {when} that are outliers of their burst; they are kept",
                    "test": f"generalised extreme studentised deviate, at most {MOST}, significance {SIGNIFICANCE:g}",
                },
            )


def _attributes(header: Record, facility: Facility, journal_digest: str | None) -> dict[str, Any]:
    attributes = {
        "title": header.get("title") or "goniospectrophotometer scan",
        "reference_reflectance_factor": facility.reference.reflectance_factor,
        "reference_illumination_zenith": facility.reference.illumination_zenith,
        "reference_sensor_zenith": facility.reference.sensor_zenith,
        "scan_direction": header["scan_direction"],
        "points_planned": header["points"],
        "plan": header["plan"],
        "facility": header["facility"],
        "software": f"goniotwin {header['software_version']}",
    }
    attributes |= described_reference(header, facility.reference.standard)
    if journal_digest is not None:
        attributes["journal_digest"] = journal_digest
    return attributes
