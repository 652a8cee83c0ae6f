"""Torrance and Sparrow's rough dielectric over a Lambertian base, and its fit to readings.

BRDF = base/pi + D G F / (4 cos i cos o), with Trowbridge and Reitz's distribution of facets D (roughness alpha),
Smith's separable masking G, and Fresnel's reflectance F of unpolarised light at a dielectric of the given index. The
model that Jaanson et al. took for a coated artifact; it has three numbers and a lobe about the mirror direction only.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, Any

import numpy as np
from pydantic import Field
from scipy.optimize import least_squares

from instrument.angles import FloatArray
from instrument.dataset import read_run
from instrument.errors import InputError
from instrument.forms import Form, parse_form
from twin.material import Material
from twin.material_changes import microfacet
from twin.reflection_models import Origin
from twin.reflection_models.compiled import BrdfFunction, gridding_error, zenith_grid
from twin.reflection_models.smooth import Directions

#: Towards 90 degrees the lobe grows without bound; a degree before, there is little left to see of it.
_LAST_COSINE = float(np.cos(np.deg2rad(89.0)))
_LOWEST, _HIGHEST = (0.0, 0.05, 1.01), (1.0, 1.0, 3.0)


class TorranceSparrowSettings(Form):
    """Keys of the model ``torrance-sparrow``: its three numbers, or a coupon run to fit them to."""

    base: Annotated[float, Field(ge=0, le=1)] | None = None
    roughness: Annotated[float, Field(ge=0.05, le=1)] | None = None
    refractive_index: Annotated[float, Field(gt=1, le=3)] | None = None
    file: str | None = None


@dataclass(frozen=True)
class TorranceSparrow:
    """The model at one wavelength.

    Attributes
    ----------
    base
        Reflectance of the Lambertian part.
    roughness
        Alpha of the distribution of facets.
    refractive_index
        Of the facets.
    """

    base: float
    roughness: float
    refractive_index: float

    def brdf(self, cos_o: FloatArray, phi_rad: FloatArray, cos_i: FloatArray) -> FloatArray:
        """BRDF in 1/sr; ``phi_rad`` is 0 for backscatter."""
        sin_o, sin_i = (np.sqrt(np.maximum(0.0, 1 - c * c)) for c in (cos_o, cos_i))
        between = np.clip(cos_o * cos_i + sin_o * sin_i * np.cos(phi_rad), -1.0, 1.0)
        facet = fresnel(np.sqrt((1 + between) / 2), self.refractive_index)
        return np.asarray(self.base / np.pi + facet * microfacet(cos_o, phi_rad, cos_i, self.roughness))


@dataclass(frozen=True)
class TorranceSparrowFit:
    """A fit to readings.

    Attributes
    ----------
    model
        The best numbers.
    residuals, shape (reading,)
        Model over reading, less one.
    """

    model: TorranceSparrow
    residuals: FloatArray

    @property
    def rms(self) -> float:
        """Root mean square of the residuals."""
        return float(np.sqrt(np.mean(self.residuals**2)))


def fresnel(cosine: FloatArray, index: float) -> FloatArray:
    """Reflectance of unpolarised light at a dielectric, seen from outside."""
    inside = np.sqrt(1 - (1 - cosine**2) / index**2)
    across = (cosine - index * inside) / (cosine + index * inside)
    along = (index * cosine - inside) / (index * cosine + inside)
    return np.asarray((across**2 + along**2) / 2)


def fit_torrance_sparrow(readings: Directions, brf: FloatArray) -> TorranceSparrowFit:
    """Fit the model to reflectance factors, least squares of relative differences."""
    cos_o, cos_i = np.cos(readings.emergent_rad), np.cos(readings.incident_rad)

    def residuals(numbers: FloatArray) -> FloatArray:
        return np.asarray(np.pi * TorranceSparrow(*numbers).brdf(cos_o, readings.phi_rad, cos_i) / brf - 1)

    level = float(np.clip(np.median(brf), 0.01, 0.99))
    # The residuals have several minima in the roughness: begin with smooth, rough and very rough.
    fits = [
        least_squares(residuals, (level, start, 1.4), bounds=(_LOWEST, _HIGHEST), x_scale=(0.1, 0.1, 0.1), max_nfev=100)
        for start in (0.15, 0.4, 0.8)
    ]
    best = min(fits, key=lambda fit: float(fit.cost))
    return TorranceSparrowFit(TorranceSparrow(*map(float, best.x)), residuals(best.x))


def torrance_sparrow_model(settings: Mapping[str, Any], origin: Origin) -> Material:
    """A surface of given numbers, or fitted to a coupon run (a model for every wavelength)."""
    form = parse_form(dict(settings), TorranceSparrowSettings, origin.where)
    numbers = (form.base, form.roughness, form.refractive_index)
    if (form.file is None) == (None in numbers) or (form.file is not None and any(n is not None for n in numbers)):
        raise InputError(f"{origin.where}: expected base, roughness and refractive_index, or file alone")
    if form.file is None:
        assert form.base is not None
        assert form.roughness is not None
        assert form.refractive_index is not None
        model = TorranceSparrow(form.base, form.roughness, form.refractive_index)
        return torrance_sparrow([model], None, _title(model))
    from twin.coupon import coupon_readings

    path = origin.file(form.file)
    by_wavelength = coupon_readings(read_run(path), str(path))
    fits = [fit_torrance_sparrow(r.directions(), r.brf) for r in by_wavelength.values()]
    notes = tuple(
        f"{_title(fit.model)} fitted at {w:g} nm: residuals of {100 * fit.rms:.2g} % (root mean square)"
        for w, fit in zip(by_wavelength, fits, strict=True)
    )
    return torrance_sparrow([fit.model for fit in fits], np.array(list(by_wavelength)), str(path), notes)


def torrance_sparrow(
    models: list[TorranceSparrow], wavelengths: FloatArray | None, name: str, notes: tuple[str, ...] = ()
) -> Material:
    """Tables of models, one a wavelength."""
    zenith = [*np.arange(0, 60, 2.0), *np.arange(60, 90, 1.0), 90.0]
    grid = zenith_grid(zenith, [*np.arange(0, 140, 5.0), *np.arange(140, 181, 2.0)])

    def bounded(model: TorranceSparrow) -> BrdfFunction:
        return lambda o, phi, i: model.brdf(np.maximum(o, _LAST_COSINE), phi, np.maximum(i, _LAST_COSINE))

    values = np.stack([grid.values(bounded(model)) for model in models])
    errors = [
        gridding_error(grid, table, bounded(model)).relative_rms for table, model in zip(values, models, strict=True)
    ]
    return Material(
        grid.cos_o,
        grid.phi_rad,
        grid.cos_i,
        values,
        wavelengths=wavelengths,
        name=name,
        gridding_error=max(errors),
        notes=notes,
    )


def _title(model: TorranceSparrow) -> str:
    return (
        f"Torrance-Sparrow, base {model.base:.3g}, roughness {model.roughness:.3g}, refractive index"
        f" {model.refractive_index:.3g}"
    )
