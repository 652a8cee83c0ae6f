"""Is a material fit for use? Coverage, reciprocity, energy, and how much of it is filled or interpolated."""

from __future__ import annotations

from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from instrument.angles import FloatArray
from twin.material import Material, listed, read_material
from twin.reflection_models import file_kind

#: Reciprocity is looked at up to this zenith: beyond, tables are filled.
_LAST_DEG = 75.0
#: A check of these fails beyond: relative asymmetry, reflectance, relative error of gridding.
_ASYMMETRY, _ENERGY, _GRIDDING = 0.05, 1.0, 0.02


@dataclass(frozen=True)
class MaterialReport:
    """What a check found.

    Attributes
    ----------
    name, description
        Of the material.
    coverage
        Zenith angles and wavelengths of the nodes, in words.
    reciprocity_rms, reciprocity_largest
        Difference between both orders of two directions over their mean, up to 75 degrees of zenith.
    energy_largest, energy_zenith
        Largest directional-hemispherical reflectance, and the incident zenith it belongs to (degree).
    filled_share
        Share of the entries filled, by rule.
    fill_error
        Their relative standard uncertainty from held-out readings, by rule.
    interpolation_error
        Relative root mean square error between the nodes: of a coupon from readings left out (their noise included), of
        another table from leaving out every second node.
    gridding_error
        Relative root mean square difference of the table from the model it was compiled from.
    notes
        What else to know.
    problems
        What a person should look at; empty for a sound material.
    """

    name: str
    description: str
    coverage: str
    reciprocity_rms: float
    reciprocity_largest: float
    energy_largest: float
    energy_zenith: float
    filled_share: dict[str, float]
    fill_error: dict[str, float]
    interpolation_error: float
    gridding_error: float
    notes: tuple[str, ...] = ()
    problems: tuple[str, ...] = field(default=())

    def lines(self) -> list[str]:
        """The report in words."""
        filled = [
            f"{_percent(share)} for {rule}"
            + (f" (uncertain by {_percent(self.fill_error[rule])})" if rule in self.fill_error else "")
            for rule, share in self.filled_share.items()
        ]
        reciprocal = (
            f"reciprocity: f(i,o) and f(o,i) differ by {_percent(self.reciprocity_rms)} (root mean square),"
            f" {_percent(self.reciprocity_largest)} at most, up to {_LAST_DEG:g} degrees"
        )
        return [
            self.description,
            f"coverage: {self.coverage}",
            reciprocal,
            f"energy: at most {self.energy_largest:.4f} of the light is reflected, at {self.energy_zenith:.0f} degrees",
            "filled: " + (", ".join(filled) if filled else "nothing"),
            f"interpolation error: {_percent(self.interpolation_error)} (root mean square)",
            f"gridding error: {_percent(self.gridding_error)} (root mean square)",
            *(f"note: {note}" for note in self.notes),
            *(f"PROBLEM: {problem}" for problem in self.problems),
        ]

    def to_json(self) -> dict[str, Any]:
        """The report for programs."""
        return asdict(self)


def check_file(path: Path) -> MaterialReport:
    """Read a material and check it; a coupon run also by holding readings out.

    Raises
    ------
    InputError
        If the material cannot be read or is refused.
    """
    material = read_material(path)
    method = material.method
    if not method or file_kind(path) not in ("csv", "netcdf"):
        return check_material(material)
    from instrument.dataset import read_run
    from twin import coupon_heldout

    run = read_run(path)
    material = replace(
        material,
        fill_error=coupon_heldout.fill_errors(run, str(path), method),
        gridding_error=coupon_heldout.table_error(run, str(path), method),
    )
    report = check_material(material)
    error = coupon_heldout.interpolation_error(run, str(path), method)
    return replace(report, interpolation_error=error)


def check_material(material: Material) -> MaterialReport:
    """Check a material that was read."""
    asymmetry = np.concatenate([reciprocity(material, table) for table in range(len(material.brdf))])
    energy = np.stack([material.directional_reflectance(material.cos_i, table) for table in range(len(material.brdf))])
    worst = int(np.argmax(energy.max(axis=0)))
    entries = material.entries or material.brdf.size
    report = MaterialReport(
        name=material.name,
        description=material.describe(),
        coverage=_coverage(material),
        reciprocity_rms=float(np.sqrt(np.mean(asymmetry**2))),
        reciprocity_largest=float(np.max(np.abs(asymmetry))),
        energy_largest=float(energy.max()),
        energy_zenith=float(np.rad2deg(np.arccos(material.cos_i[worst]))),
        filled_share={rule: count / entries for rule, count in material.filled.items()},
        fill_error=dict(material.fill_error),
        interpolation_error=max(interpolation_error(material, table) for table in range(len(material.brdf))),
        gridding_error=material.gridding_error,
        notes=material.notes,
    )
    return replace(report, problems=tuple(_problems(report, material)))


def reciprocity(material: Material, table: int = 0) -> FloatArray:
    """Relative difference between both orders of directions drawn at random, shape (pair,)."""
    random = np.random.default_rng(0)
    first, second = np.sqrt(random.uniform(np.cos(np.deg2rad(_LAST_DEG)) ** 2, 1, (2, 4000)))
    phi = random.uniform(0, 2 * np.pi, 4000)
    one, other = material.evaluate(first, phi, second, table), material.evaluate(second, phi, first, table)
    mean = (one + other) / 2
    return np.asarray(np.divide(one - other, mean, out=np.zeros_like(mean), where=mean > 0))


def interpolation_error(material: Material, table: int = 0) -> float:
    """Relative root mean square error of linear interpolation: a quarter of that with every second node left out.

    Source: the error of linear interpolation goes with the square of the distance of the nodes.
    """
    values = material.brdf[table]
    squares, count = 0.0, 0
    for axis, nodes in enumerate((material.cos_o, material.phi_rad, material.cos_i)):
        moved = np.moveaxis(values, axis, 0)
        odd = np.arange(1, len(nodes) - 1, 2)
        if len(odd) == 0:
            continue
        fraction = (nodes[odd] - nodes[odd - 1]) / (nodes[odd + 1] - nodes[odd - 1])
        fraction = fraction.reshape(-1, 1, 1)
        guess = moved[odd - 1] * (1 - fraction) + moved[odd + 1] * fraction
        squares += float(np.sum((guess - moved[odd]) ** 2)) / 16
        count += moved[odd].size
    mean = float(np.mean(values))
    return float(np.sqrt(squares / count) / mean) if count and mean > 0 else 0.0


def _coverage(material: Material) -> str:
    emergent, incident = (np.rad2deg(np.arccos(axis)) for axis in (material.cos_o, material.cos_i))
    azimuths = len(material.phi_rad) - 1
    text = (
        f"emergence at {len(emergent)} zeniths from {emergent[-1]:.3g} to {emergent[0]:.3g} degrees, incidence at"
        f" {len(incident)} from {incident[-1]:.3g} to {incident[0]:.3g}, {azimuths} azimuth differences"
    )
    every = "every wavelength" if material.wavelengths is None else f"{listed(material.wavelengths)} nm"
    return f"{text}; {every}"


def _problems(report: MaterialReport, material: Material) -> list[str]:
    problems = []
    if report.reciprocity_rms > _ASYMMETRY:
        problems.append(
            f"not reciprocal: both orders of directions differ by {_percent(report.reciprocity_rms)}; expected less"
            f" than {_percent(_ASYMMETRY)}"
        )
    if report.energy_largest > _ENERGY:
        problems.append(f"more light leaves than arrives: {report.energy_largest:.4f}; expected at most 1")
    if report.gridding_error > _GRIDDING:
        problems.append(f"the table's grid is coarse for its model: {_percent(report.gridding_error)}")
    for axis, nodes in (("emergence", material.cos_o), ("incidence", material.cos_i)):
        if nodes[0] > np.cos(np.deg2rad(80.0)) + 1e-6:
            last = np.rad2deg(np.arccos(nodes[0]))
            problems.append(f"{axis} ends at {last:.3g} degrees; beyond, the last value stands")
    return problems


def _percent(value: float) -> str:
    return f"{100 * value:.2g} %"
