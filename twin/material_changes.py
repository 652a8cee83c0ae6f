"""Changes of a material: a lobe added. What a diagnosis tries out on a nominal table.

A lobe gets a grid that is fine enough for it, together with every node of the table: away from the lobe nothing
changes. How far the table is from the lobe in closed form is measured (:class:`LobeOnGrid`) and carried along in the
material's notes. Amplitude is a factor: the fitting of amplitudes can reuse one :class:`LobeOnGrid`.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.special import erf

from instrument.angles import FloatArray
from instrument.errors import InputError
from twin.material import Material
from twin.reflection_models.compiled import BrdfFunction, Grid, GriddingError, gridding_error, zenith_grid


@dataclass(frozen=True)
class LobeOnGrid:
    """A lobe of unit amplitude, as a reflectance factor, ready to be added to one material.

    Attributes
    ----------
    material
        The material on the finer grid, without the lobe.
    values, shape (o, phi, i)
        The lobe's reflectance factor at the nodes.
    error
        What the grid makes of the lobe; ``largest`` is a reflectance factor.
    name
        Of the lobe.
    """

    material: Material
    values: FloatArray
    error: GriddingError
    name: str

    def added(self, amplitude: float) -> Material:
        """The material with the lobe.

        Raises
        ------
        InputError
            If it would reflect more light than it receives, or a negative amount.
        """
        note = (
            f"{self.name}, amplitude {amplitude:g}: the grid changes the lobe by {100 * self.error.relative_rms:.2g} %"
            f" (root mean square) and by {abs(amplitude) * self.error.largest:.2g} of reflectance factor at most"
        )
        brdf = self.material.brdf + amplitude / np.pi * self.values
        name = f"{self.material.name} with {self.name}"
        return replace(self.material, brdf=brdf, name=name, notes=(*self.material.notes, note))


def with_retroreflection(material: Material, amplitude: float, width_deg: float) -> Material:
    """Add a peak about exact retro-reflection.

    Parameters
    ----------
    amplitude
        Reflectance factor (pi times the BRDF) added at exact retro-reflection.
    width_deg
        Angle between emergence and retro-reflection at which the peak has fallen to 1/e.

    Raises
    ------
    InputError
        For a width that is not positive, or a sum that no surface can have.
    """
    return retroreflection_lobe(material, width_deg).added(amplitude)


def with_specular_lobe(material: Material, amplitude: float, roughness: float, normal: float = 0.0) -> Material:
    """Add a microfacet lobe (Torrance-Sparrow with the slopes of Trowbridge and Reitz, GGX, or of Beckmann).

    Parameters
    ----------
    amplitude
        Reflectance of every facet, independent of the angle: the Fresnel factor's place.
    roughness
        The distribution's alpha: for normal slopes the root mean square slope; GGX has the same about its centre, and
        tails.
    normal
        Share of facets whose slopes are distributed normally (Beckmann), 0 to 1; the others' have tails (GGX).

    Raises
    ------
    InputError
        For a roughness outside 0.03 to 1, a share outside 0 to 1, or a sum that no surface can have.
    """
    return specular_lobe(material, roughness, normal).added(amplitude)


def retroreflection_lobe(material: Material, width_deg: float) -> LobeOnGrid:
    """The peak of :func:`with_retroreflection` at unit amplitude."""
    if not 0.2 <= width_deg <= 90:
        raise InputError(f"retro-reflection: width: found {width_deg:g} degrees; expected 0.2 to 90")
    width_rad = np.deg2rad(width_deg)

    def peak(cos_o: FloatArray, phi_rad: FloatArray, cos_i: FloatArray) -> FloatArray:
        return np.exp(-retro_angle_rad(cos_o, phi_rad, cos_i) / width_rad)

    step = float(np.clip(width_deg / 5, 0.5, 3.0))
    zenith = np.linspace(0, 90, int(np.ceil(90 / step)) + 1)
    # Within a zenith step of the plane the peak falls fastest; further out it is broad or gone.
    phi = np.unique(np.concatenate([np.arange(0, 8) * step, np.geomspace(8 * step, 180, 24)]))
    return _on_grid(material, peak, zenith_grid(zenith, phi), 0.0, f"retro-reflection peak {width_deg:g} degrees wide")


def specular_lobe(material: Material, roughness: float, normal: float = 0.0) -> LobeOnGrid:
    """The lobe of :func:`with_specular_lobe` at unit amplitude."""
    if not 0.03 <= roughness <= 1:
        raise InputError(f"specular lobe: roughness: found {roughness:g}; expected 0.03 to 1")
    if not 0 <= normal <= 1:
        raise InputError(f"specular lobe: share of normal slopes: found {normal:g}; expected 0 to 1")

    def lobe(cos_o: FloatArray, phi_rad: FloatArray, cos_i: FloatArray) -> FloatArray:
        with_tails = np.pi * microfacet(cos_o, phi_rad, cos_i, roughness) if normal < 1 else np.array(0.0)
        without = np.pi * normal_facets(cos_o, phi_rad, cos_i, roughness) if normal > 0 else np.array(0.0)
        return np.asarray((1 - normal) * with_tails + normal * without)

    # A facet turned by one angle turns the reflection by two: the lobe is about 2 alpha wide.
    step = float(np.clip(np.rad2deg(roughness) / 4, 0.75, 3.0))
    zenith = np.linspace(0, 90, int(np.ceil(90 / step)) + 1)
    phi = 180 - np.unique(np.concatenate([np.arange(0, 8) * step, np.geomspace(8 * step, 180, 24)]))[::-1]
    phi[0] = 0.0
    name = f"specular lobe of roughness {roughness:g}" + (f", {100 * normal:g} % normal slopes" if normal else "")
    return _on_grid(material, lobe, zenith_grid(zenith, phi), np.pi, name)


def retro_angle_rad(cos_o: FloatArray, phi_rad: FloatArray, cos_i: FloatArray) -> FloatArray:
    """Angle between emergence and exact retro-reflection; accurate where it is small."""
    sin_o, sin_i = (np.sqrt(np.maximum(0.0, 1 - c * c)) for c in (cos_o, cos_i))
    apart = (cos_o - cos_i) ** 2 + (sin_o - sin_i) ** 2 + 4 * sin_o * sin_i * np.sin(phi_rad / 2) ** 2
    return np.asarray(2 * np.arcsin(np.minimum(1.0, np.sqrt(apart) / 2)))


def microfacet(cos_o: FloatArray, phi_rad: FloatArray, cos_i: FloatArray, roughness: float) -> FloatArray:
    """BRDF in 1/sr of a rough mirror: D G / (4 cos_i cos_o), GGX with Smith's separable masking (Walter et al. 2007).

    ``phi_rad`` is 0 for backscatter.
    """
    cos_o, cos_i = np.maximum(cos_o, 1e-4), np.maximum(cos_i, 1e-4)
    cos_half_squared = _facet_cosine_squared(cos_o, phi_rad, cos_i)
    alpha_squared = roughness * roughness
    distribution = alpha_squared / (np.pi * (1 - cos_half_squared * (1 - alpha_squared)) ** 2)

    def seen(cosine: FloatArray) -> FloatArray:
        return np.asarray(2 * cosine / (cosine + np.sqrt(alpha_squared + (1 - alpha_squared) * cosine**2)))

    return np.asarray(distribution * seen(cos_o) * seen(cos_i) / (4 * cos_o * cos_i))


def normal_facets(cos_o: FloatArray, phi_rad: FloatArray, cos_i: FloatArray, roughness: float) -> FloatArray:
    """BRDF in 1/sr of a rough mirror of normally distributed slopes (Beckmann), with Smith's separable masking.

    Walter et al. 2007, equation 25 and the exact masking of section 5.2; ``phi_rad`` is 0 for backscatter.
    """
    cos_o, cos_i = np.maximum(cos_o, 1e-4), np.maximum(cos_i, 1e-4)
    cosine_squared = _facet_cosine_squared(cos_o, phi_rad, cos_i)
    alpha_squared = roughness * roughness
    steepness = (1 / np.maximum(cosine_squared, 1e-12) - 1) / alpha_squared
    distribution = np.exp(-steepness) / (np.pi * alpha_squared * np.maximum(cosine_squared, 1e-12) ** 2)

    def seen(cosine: FloatArray) -> FloatArray:
        a = cosine / (roughness * np.sqrt(np.maximum(1 - cosine**2, 1e-12)))
        return np.asarray(2 / (1 + erf(a) + np.exp(-a * a) / (a * np.sqrt(np.pi))))

    return np.asarray(distribution * seen(cos_o) * seen(cos_i) / (4 * cos_o * cos_i))


def _facet_cosine_squared(cos_o: FloatArray, phi_rad: FloatArray, cos_i: FloatArray) -> FloatArray:
    """Squared cosine of the angle between the surface's normal and that of facets that mirror one way into another."""
    sin_o, sin_i = (np.sqrt(np.maximum(0.0, 1 - c * c)) for c in (cos_o, cos_i))
    squared = 2 * (1 + cos_o * cos_i + sin_o * sin_i * np.cos(phi_rad))
    return np.asarray(np.minimum((cos_o + cos_i) ** 2 / np.maximum(squared, 1e-12), 1.0))


def _on_grid(material: Material, function: BrdfFunction, grid: Grid, ridge_rad: float, name: str) -> LobeOnGrid:
    """The lobe on its own grid together with the material's nodes."""
    union = Grid(
        *(
            _merged(own, lobes)
            for own, lobes in (
                (material.cos_o, grid.cos_o),
                (material.phi_rad, grid.phi_rad),
                (material.cos_i, grid.cos_i),
            )
        )
    )
    finer = replace(
        material,
        cos_o=union.cos_o,
        phi_rad=union.phi_rad,
        cos_i=union.cos_i,
        brdf=material.on_grid(union.cos_o, union.phi_rad, union.cos_i),
        entries=material.entries or material.brdf.size,
    )
    values = function(union.cos_o[:, None, None], union.phi_rad[None, :, None], union.cos_i[None, None, :])
    return LobeOnGrid(finer, values, gridding_error(union, values, function, ridge_rad=ridge_rad), name)


def _merged(own: FloatArray, lobes: FloatArray) -> FloatArray:
    """Nodes of both; the lobe's only where they are not next to one of the table's."""
    apart = np.min(np.abs(lobes[:, None] - own), axis=1) > 1e-6
    return np.sort(np.concatenate([own, lobes[apart]]))
