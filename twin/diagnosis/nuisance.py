"""What the budget allows: every input of the prediction and the measurement that may be a little off in a sound run.

Each is a column, the relative change of the reading by one standard uncertainty, with the shape that physics gives it.
How large it is, the inputs say. Zenith angles and tilts are bounded by their rows of the run's budget: an angle that
is off by all of its readout's uncertainty changes grazing readings by several times that row.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Protocol

import numpy as np

from instrument.angles import FloatArray
from twin.diagnosis.observation import Observation


class Derivative(Protocol):
    """An effect whose derivative is known."""

    @property
    def parameters(self) -> Sequence[Bounded]:
        """With the standard uncertainty that the inputs state."""
        ...

    def derivative(self) -> FloatArray:
        """Of the logarithm of the reading, shape (parameter, point)."""
        ...

    def log_ratio(self, values: FloatArray) -> FloatArray:
        """Logarithm of the reading with the effect over that without, shape (value, point)."""
        ...


class Bounded(Protocol):
    """A parameter."""

    @property
    def name(self) -> str:
        """As in the data contract."""
        ...

    @property
    def nominal(self) -> float:
        """Value that means no effect."""
        ...

    @property
    def cap(self) -> tuple[float, float]:
        """Lowest and highest possible value."""
        ...

    @property
    def budget(self) -> float:
        """Standard uncertainty that the inputs state; 0 where they state none."""
        ...

    @property
    def typical(self) -> float:
        """Order of magnitude of a visible effect."""
        ...

    @property
    def shape(self) -> bool:
        """Whether it says how the effect looks, not how large it is."""
        ...


#: Rows of the budget (components of a run file) and the effects they stand for.
ROWS = {
    "placement": ("sample_tilt",),
    "sensor_zenith": ("sensor_zenith_offset",),
    "illumination_zenith": ("illumination_zenith_offset",),
    "linearity": ("detector_nonlinearity",),
    "straylight": ("stray_light",),
    "polarization": ("polarization",),
}
#: Effects whose uncertainty the inputs of the prediction state.
STATED = (
    "sample_offset",
    "sample_height",
    "sample_azimuth",
    "sensor_azimuth_offset",
    "plate_thickness",
    "cavity_depth",
    "hole_diameter",
    "beam_divergence",
    "beam_radius",
    "field_of_view",
)
#: Rows that scale every reading alike.
SCALE = ("reference", "wavelength")
#: Relative uncertainty of the scale where a run says nothing of it.
_UNSTATED_SCALE = 0.005


def budget_columns(found: Mapping[str, Derivative], run: Observation) -> dict[str, FloatArray]:
    """Columns by label, shape (point,) each."""
    columns: dict[str, FloatArray] = {}
    for row, names in ROWS.items():
        size = _row_size(run, row)
        for name in names:
            if name in found:
                columns |= _limited(name, found[name], size)
    for name in STATED:
        if name in found:
            columns |= _limited(name, found[name], np.inf)
    scale = [run.components[row] / run.brf for row in SCALE if row in run.components]
    total = np.sqrt(np.sum(np.square(scale), axis=0)) if scale else np.full(len(run), _UNSTATED_SCALE)
    columns["scale"] = np.asarray(total)
    return columns


def _row_size(run: Observation, row: str) -> float:
    """Root mean square of a row of the budget, relative; infinite where the run does not state it."""
    if row not in run.components:
        return np.inf
    return float(np.sqrt(np.mean((run.components[row] / run.brf) ** 2)))


def _limited(name: str, effect: Derivative, size: float) -> dict[str, FloatArray]:
    """Columns of an effect's parameters: as uncertain as stated, but no larger than the row of the budget.

    With differences a and b of the logarithm at sqrt(3) standard uncertainties up and down, (a - b)/(2 sqrt 3) is the
    linear and (a + b) sqrt(2)/6 the quadratic effect of a standard normal variable; the two are uncorrelated.
    """
    columns: dict[str, FloatArray] = {}
    nominal = np.array([parameter.nominal for parameter in effect.parameters])
    for number, (parameter, slope) in enumerate(zip(effect.parameters, effect.derivative(), strict=True)):
        if parameter.shape:
            continue
        stated = parameter.budget if parameter.budget > 0 else np.inf
        spread = float(np.sqrt(np.mean(slope**2)))
        sigma = min(stated, size / spread if spread > 0 else np.inf)
        if not (np.isfinite(sigma) and sigma > 0):
            continue
        label = f"{name} {parameter.name}"
        columns[label] = slope * sigma
        step = np.sqrt(3.0) * sigma
        if parameter.cap[0] < parameter.nominal - step and parameter.nominal + step < parameter.cap[1]:
            values = np.tile(nominal, (2, 1))
            values[:, number] += [step, -step]
            up, down = effect.log_ratio(values)
            columns[label] = (up - down) / (2 * np.sqrt(3.0))
            columns[f"{label}, quadratic"] = (up + down) * np.sqrt(2.0) / 6
    return columns
