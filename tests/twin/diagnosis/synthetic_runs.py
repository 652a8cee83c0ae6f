"""Runs made from formulas: a plan's geometries, effects in closed form, and errors drawn from a stated structure."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cache

import numpy as np

from twin.diagnosis.covariance import Structure, structures
from twin.diagnosis.observation import Observation
from twin.diagnosis.problem import Problem

Columns = dict[str, np.ndarray]
#: Azimuths of the sensor by illumination zenith, as in the paper's Table IV.
TABLE_IV = {0.0: (0.0, 45.0, 90.0, 135.0), 15.0: (0.0, 50.0, 75.0, 105.0, 130.0), 30.0: (0.0, 60.0, 120.0)}
#: Relative standard uncertainties: noise, stability, reference.
NOISE, STABILITY, SCALE = 0.006, 0.008, 0.005


def grid(
    planes: Mapping[float, Sequence[float]] = TABLE_IV,
    step: float = 5.0,
    *,
    serpentine: bool = False,
    shadow: bool = True,
) -> Columns:
    """Commanded geometries from +80 to -80 degrees sensor zenith; those behind the light's arm are left out."""
    zeniths = np.arange(80.0, -80.0 - step / 2, -step)
    rows = []
    for light, azimuths in planes.items():
        for number, azimuth in enumerate(azimuths):
            for zenith in zeniths[::-1] if serpentine and number % 2 else zeniths:
                behind = abs(zenith - light) < 0.1 and (azimuth == 0.0 or light == 0.0)
                if not (shadow and behind):
                    rows.append((500.0, light, 0.0, zenith, azimuth))
    names = ("wavelength", "illumination_zenith", "illumination_azimuth", "sensor_zenith", "sensor_azimuth")
    return dict(zip(names, np.array(rows).T, strict=True))


def nominal(columns: Columns) -> np.ndarray:
    """A reflectance factor that falls smoothly to the sides, symmetric about the plane of incidence."""
    sine = np.sin(np.deg2rad(columns["sensor_zenith"]))
    return 0.5 - 0.1 * sine**2 - 0.02 * np.sin(np.deg2rad(columns["illumination_zenith"])) * sine


def observed(
    columns: Columns, change: np.ndarray | float = 0.0, *, components: bool = True, times: bool = True
) -> Observation:
    """A run that reads ``nominal`` times exp(change)."""
    expected = nominal(columns)
    brf = expected * np.exp(change)
    u = {"noise": NOISE * expected, "stability": STABILITY * expected, "reference": SCALE * expected}
    combined = np.sqrt(NOISE**2 + STABILITY**2 + SCALE**2) * expected
    count = len(brf)
    return Observation(
        "synthetic.nc",
        np.arange(count),
        columns,
        brf,
        combined,
        u if components else {},
        22.0 * np.arange(count) if times else None,
    )


def sweep(file: str, illumination_zenith: float, zenith: Sequence[float], brf: float = 1.0) -> Observation:
    """One sweep of the sensor's zenith at azimuth 90 that reads the same everywhere, with an error of placement."""
    same = np.ones(len(zenith))
    columns = {
        "wavelength": 500 * same,
        "illumination_zenith": illumination_zenith * same,
        "illumination_azimuth": 0 * same,
        "sensor_zenith": np.array(zenith),
        "sensor_azimuth": 90 * same,
    }
    u = {"noise": 0.004 * same, "stability": 0.006 * same, "placement": 0.002 * same}
    rows = np.arange(len(zenith))
    return Observation(file, rows, columns, brf * same, 0.01 * same, u, 22.0 * rows)


@dataclass(frozen=True)
class Parameter:
    """As the diagnosis' protocols ask for."""

    name: str
    typical: float
    cap: tuple[float, float]
    nominal: float = 0.0
    shape: bool = False
    budget: float = 0.0


@dataclass(frozen=True)
class Formula:
    """An effect as a function of its parameters, shape (value, p), to logarithmic ratios, shape (value, point)."""

    name: str
    parameters: tuple[Parameter, ...]
    function: Callable[[np.ndarray], np.ndarray] = field(repr=False)
    catalogued: bool = True
    shapes: int = 6
    form_error: float = 0.0

    def log_ratio(self, values: np.ndarray) -> np.ndarray:
        return self.function(np.atleast_2d(values))

    def derivative(self) -> np.ndarray:
        """By central differences at the nominal values."""
        start, rows = np.array([p.nominal for p in self.parameters]), []
        for number, parameter in enumerate(self.parameters):
            step = np.zeros(len(start))
            step[number] = 1e-4 * parameter.typical
            up, down = self.log_ratio(np.array([start + step, start - step]))
            rows.append((up - down) / (2e-4 * parameter.typical))
        return np.array(rows)


def linear(name: str, column: np.ndarray, typical: float, cap: tuple[float, float]) -> Formula:
    """One parameter, the logarithm of the reading in proportion to it."""
    return Formula(name, (Parameter("amount", typical, cap),), lambda values: values[:, :1] * column)


def effects(columns: Columns) -> dict[str, Formula]:
    """A small library: pose, arm, radiometry and time, non-linear where the physics is."""
    zenith, azimuth = np.deg2rad(columns["sensor_zenith"]), np.deg2rad(columns["sensor_azimuth"])
    brf, progress = nominal(columns), np.linspace(0.0, 1.0, len(zenith))

    def tilt(values: np.ndarray) -> np.ndarray:
        x, y = np.deg2rad(values[:, :1]), np.deg2rad(values[:, 1:2])
        slope = np.tan(zenith) * (y * np.cos(azimuth) - x * np.sin(azimuth))
        return np.log(np.cos(np.hypot(x, y)) * np.maximum(1 + slope, 1e-3))

    def zero(values: np.ndarray) -> np.ndarray:
        return np.log(np.cos(zenith + np.deg2rad(values[:, :1])) / np.cos(zenith))

    def stray(values: np.ndarray) -> np.ndarray:
        return np.log1p(values[:, :1] / (brf * np.cos(zenith)))

    def drift(values: np.ndarray) -> np.ndarray:
        return np.log1p(values[:, :1] * progress)

    def polarised(values: np.ndarray) -> np.ndarray:
        return np.log1p(values[:, :1] * np.cos(2 * azimuth) * np.sin(zenith) ** 2)

    return {
        "tilt": Formula("tilt", (Parameter("x_deg", 0.5, (-5, 5)), Parameter("y_deg", 0.5, (-5, 5))), tilt),
        "zero": Formula("zero", (Parameter("angle_deg", 0.4, (-4, 4)),), zero),
        "stray": Formula("stray", (Parameter("fraction", 0.003, (0, 0.1)),), stray),
        "drift": Formula("drift", (Parameter("fraction", 0.02, (-0.3, 0.3)),), drift),
        "polarised": Formula("polarised", (Parameter("fraction", 0.03, (-0.5, 0.5)),), polarised),
    }


def severity(change: np.ndarray, run: Observation) -> float:
    """Root mean square of the relative change over the relative uncertainty."""
    return float(np.sqrt(np.mean((np.expm1(change) / run.relative_u) ** 2)))


def at_severity(effect: Formula, wanted: float, run: Observation, way: Sequence[float] = (1.0,)) -> np.ndarray:
    """Parameters along a way (in typical amplitudes) at which an effect has a severity."""
    from scipy.optimize import brentq

    step = np.array([w * p.typical for w, p in zip(way, effect.parameters, strict=True)])
    nothing = np.array([p.nominal for p in effect.parameters])

    def excess(amount: float) -> float:
        return severity(effect.log_ratio(nothing + amount * step)[0], run) - wanted

    return nothing + brentq(excess, 1e-6, 7.0) * step


@cache
def _structures(key: tuple[tuple[float, ...], ...]) -> list[Structure]:
    columns = dict(
        zip(
            ("wavelength", "illumination_zenith", "illumination_azimuth", "sensor_zenith", "sensor_azimuth"),
            map(np.array, key),
            strict=True,
        )
    )
    return structures(observed(columns))


def structure(columns: Columns, name: str) -> Structure:
    """One of the structures of a grid's runs."""
    every = _structures(tuple(tuple(column) for column in columns.values()))
    return next(s for s in every if s.name == name)


def errors(columns: Columns, name: str, seed: int) -> np.ndarray:
    """Noise and stability of a structure, and an error of scale: logarithms, shape (point,)."""
    generator = np.random.default_rng(seed)
    covariance = structure(columns, name).covariance
    drawn = np.linalg.cholesky(covariance) @ generator.standard_normal(len(covariance))
    return drawn + SCALE * generator.standard_normal()


def problem(run: Observation, library: Sequence[Formula], *, u_nominal: float = 0.001) -> Problem:
    """The run beside its nominal prediction, with an uncertain scale as budget."""
    count = len(run)
    expected = nominal(run.columns)
    budget = np.full((count, 1), SCALE)
    return Problem.of(run, expected, np.full(count, u_nominal), budget, library)


def with_change(given: Problem, change: np.ndarray) -> Problem:
    """The same problem with other readings; uncertainties and priors as they were."""
    return replace(given, run=replace(given.run, brf=given.nominal * np.exp(change)))
