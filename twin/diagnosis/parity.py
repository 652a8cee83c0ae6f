"""Symmetries that a sound run has whatever the sample reflects: a test without any simulation.

Of a sample that looks the same in a mirror along the plane of incidence, directions on either side of that plane
reflect alike; at normal incidence so do opposite directions, and for a sample of fourfold symmetry those a quarter turn
apart. At the sensor's zenith 0 its azimuth does not matter at all. What breaks these symmetries is an error of pose, of
an arm, of polarisation or of time, and hardly ever one of material or dimensions.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree
from scipy.stats import chi2, norm

from instrument.angles import FloatArray, direction
from twin.diagnosis.covariance import structures
from twin.diagnosis.observation import Observation

#: Directions closer than this are the same, degree; illumination zeniths below it are normal incidence.
_SAME = 0.05
_LEVEL = 0.05
IntArray = NDArray[np.int64]


@dataclass(frozen=True)
class Term:
    """A simple cause of asymmetry, and how large it would have to be.

    Attributes
    ----------
    name, meaning
        In words.
    unit
        Of the amplitude.
    amplitude, u
        With standard uncertainty (k = 1).
    p_value
        Probability of an amplitude so far from zero by chance, after the number of terms that were tried.
    explained
        Share of the asymmetry's chi-square beyond chance that the term explains.
    """

    name: str
    meaning: str
    unit: str
    amplitude: float
    u: float
    p_value: float
    explained: float


@dataclass(frozen=True)
class Parity:
    """What the symmetries of a run say.

    Attributes
    ----------
    pairs, shape (pair, 2)
        Points that should read alike.
    asymmetry, u_asymmetry, shape (pair,)
        Logarithm of the ratio of their readings, and its standard uncertainty under the most probable structure.
    chi_square, p_value
        Over the pairs, and probability of more by chance, averaged over how stability may be correlated.
    terms
        Simple causes, the best first; empty without pairs.
    """

    pairs: IntArray
    asymmetry: FloatArray
    u_asymmetry: FloatArray
    chi_square: float
    p_value: float
    terms: tuple[Term, ...]

    def in_words(self) -> list[str]:
        """What the test suggests, and what it cannot confirm."""
        if not len(self.pairs):
            return ["Parity: the run holds no two directions that symmetry makes equal; nothing can be said."]
        size = 100 * float(np.sqrt(np.mean(self.asymmetry**2)))
        text = f"Parity of {len(self.pairs)} pairs of directions: asymmetry {size:.2f} % (root mean square)"
        if self.p_value >= _LEVEL and not (self.terms and self.terms[0].p_value < _LEVEL):
            return [f"{text}, no more than its uncertainty explains (p = {self.p_value:.2g})."]
        lines = [f"{text}, more than its uncertainty explains (p = {min(self.p_value, self.terms[0].p_value):.2g})."]
        for term in self.terms[:2]:
            if term.p_value < _LEVEL:
                lines.append(
                    f"It has the form of {term.meaning}: {term.amplitude:.3g} +- {term.u:.2g} {term.unit},"
                    f" {100 * term.explained:.0f} % of what is beyond chance."
                )
        lines.append(
            "Symmetry alone cannot confirm the cause: a wedge or an uneven sample breaks it like a tilt; errors that keep"
            " the symmetry (material, dimensions, height, stray light, linearity) do not show here."
        )
        return lines


def parity(run: Observation, *, fourfold: bool = True) -> Parity:
    """Test the symmetries of a run.

    Parameters
    ----------
    fourfold
        Whether the sample looks the same after a quarter turn (square lattice, or no structure at all).
    """
    pairs = equal_pairs(run, fourfold=fourfold)
    if not len(pairs):
        return Parity(pairs, np.zeros(0), np.zeros(0), 0.0, 1.0, ())
    difference = np.log(run.brf[pairs[:, 0]] / run.brf[pairs[:, 1]])
    covariances = [(s.weight, _of_pairs(s.covariance, pairs)) for s in structures(run)]
    weighed = [(np.log(weight) + _log_density(difference, c), c) for weight, c in covariances]
    top = max(value for value, _ in weighed)
    share = np.array([np.exp(value - top) for value, _ in weighed])
    share /= share.sum()
    kept = [(w, c) for w, (_, c) in zip(share, weighed, strict=True) if w > 1e-3]
    squares = np.array([_square(difference, c) for _, c in kept])
    weights = np.array([w for w, _ in kept]) / sum(w for w, _ in kept)
    rank = len(difference)
    p_value = float(weights @ chi2.sf(squares, rank))
    terms = _terms(run, pairs, difference, [c for _, c in kept], weights)
    best = kept[int(np.argmax(weights))][1]
    return Parity(pairs, difference, np.sqrt(np.diag(best)), float(weights @ squares), p_value, terms)


def equal_pairs(run: Observation, *, fourfold: bool = True) -> IntArray:
    """Pairs of points whose readings symmetry makes equal, shape (pair, 2); no pair follows from the others."""
    columns = run.columns
    view = direction(columns["sensor_zenith"], columns["sensor_azimuth"] - columns["illumination_azimuth"])
    normal = np.abs(columns["illumination_zenith"]) < _SAME
    wavelength = np.nan_to_num(columns["wavelength"], nan=0.0)
    place = np.column_stack([view, np.deg2rad(columns["illumination_zenith"]), wavelength])
    tree = cKDTree(place)
    root = np.arange(len(run))
    found = []
    for number, change in enumerate(_symmetries(fourfold)):
        moved = place.copy()
        moved[:, :3] = view @ change.T
        distance, partner = tree.query(moved, distance_upper_bound=np.deg2rad(_SAME))
        for point in np.flatnonzero(np.isfinite(distance)):
            if number > 0 and not normal[point]:
                continue
            first, second = _top(root, int(point)), _top(root, int(partner[point]))
            if first != second:
                root[second] = first
                found.append((min(point, partner[point]), max(point, partner[point])))
    for first, second in tree.query_pairs(np.deg2rad(_SAME)):
        one, two = _top(root, first), _top(root, second)
        if one != two:
            root[two] = one
            found.append((first, second))
    return np.array(sorted(found), dtype=np.int64).reshape(-1, 2)


def _symmetries(fourfold: bool) -> list[FloatArray]:
    """The mirror along the plane of incidence first; then what holds at normal incidence only."""
    mirror, half, quarter = np.diag([1.0, -1.0, 1.0]), np.diag([-1.0, -1.0, 1.0]), np.zeros((3, 3))
    quarter[0, 1], quarter[1, 0], quarter[2, 2] = -1.0, 1.0, 1.0
    return [mirror, half, quarter] if fourfold else [mirror, half]


def _top(root: IntArray, point: int) -> int:
    while root[point] != point:
        root[point] = root[root[point]]
        point = int(root[point])
    return point


def _of_pairs(covariance: FloatArray, pairs: IntArray) -> FloatArray:
    first, second = pairs[:, 0], pairs[:, 1]
    return np.asarray(
        covariance[np.ix_(first, first)]
        + covariance[np.ix_(second, second)]
        - covariance[np.ix_(first, second)]
        - covariance[np.ix_(second, first)]
    )


def _square(difference: FloatArray, covariance: FloatArray) -> float:
    return float(difference @ np.linalg.solve(covariance, difference))


def _log_density(difference: FloatArray, covariance: FloatArray) -> float:
    return -0.5 * (_square(difference, covariance) + float(np.linalg.slogdet(covariance)[1]))


Pattern = Callable[[FloatArray, FloatArray, FloatArray, FloatArray], FloatArray]
_DEGREE = np.pi / 180


def _patterns() -> list[tuple[str, str, str, Pattern]]:
    """Name, meaning, unit and relative change of a reading by one unit; of zenith, azimuth, light (rad) and progress."""
    return [
        (
            "tilt about x",
            "a tilt of the sample about the laboratory's x axis (or a wedge)",
            "degree",
            lambda u, a, i, t: _DEGREE * (-np.tan(u) * np.sin(a)),
        ),
        (
            "tilt about y",
            "a tilt of the sample about the laboratory's y axis (or a wedge)",
            "degree",
            lambda u, a, i, t: _DEGREE * np.tan(u) * np.cos(a),
        ),
        (
            "illumination out of its plane",
            "light from beside the plane of incidence, or a tilt of the sample towards the side",
            "degree",
            lambda u, a, i, t: _DEGREE * np.tan(i) * np.sin(a) * np.sign(np.cos(u)),
        ),
        (
            "sensor zenith zero",
            "an error of the sensor zenith's zero",
            "degree",
            lambda u, a, i, t: -_DEGREE * np.tan(u),
        ),
        (
            "sensor axis beside the centre",
            "a sensor axis displaced sideways, or a beam off the centre",
            "per cent at 90 degrees",
            lambda u, a, i, t: 0.01 * np.sin(u),
        ),
        (
            "polarisation",
            "a detector that responds to polarisation, or an anisotropic sample",
            "per cent at 90 degrees",
            lambda u, a, i, t: 0.01 * np.cos(2 * a) * np.sin(u) ** 2,
        ),
        ("drift", "a drift of source or detector", "per cent over the run", lambda u, a, i, t: 0.01 * t),
    ]


def _terms(
    run: Observation, pairs: IntArray, difference: FloatArray, covariances: Sequence[FloatArray], weights: FloatArray
) -> tuple[Term, ...]:
    columns = run.columns
    zenith, azimuth = np.deg2rad(columns["sensor_zenith"]), np.deg2rad(columns["sensor_azimuth"])
    light, found = np.deg2rad(columns["illumination_zenith"]), []
    patterns = _patterns()
    rank = len(difference)
    for name, meaning, unit, pattern in patterns:
        column = pattern(zenith, azimuth, light, run.progress)
        slope = column[pairs[:, 0]] - column[pairs[:, 1]]
        if np.sqrt(np.mean(slope**2)) < 1e-9:
            continue
        fits = [_amplitude(slope, difference, c) for c in covariances]
        value = float(weights @ np.array([a for a, _, _ in fits]))
        variance = float(weights @ np.array([u**2 + (a - value) ** 2 for a, u, _ in fits]))
        gain = float(weights @ np.array([g for _, _, g in fits]))
        total = float(weights @ np.array([_square(difference, c) for c in covariances]))
        p_value = min(1.0, 2 * float(norm.sf(abs(value) / np.sqrt(variance))) * len(patterns))
        explained = min(1.0, gain / max(total - rank, gain, 1e-12))
        found.append(Term(name, meaning, unit, value, float(np.sqrt(variance)), p_value, explained))
    return tuple(sorted(found, key=lambda term: (term.p_value, -term.explained)))


def _amplitude(slope: FloatArray, difference: FloatArray, covariance: FloatArray) -> tuple[float, float, float]:
    """Generalised least squares of one amplitude: value, standard uncertainty, decrease of chi-square."""
    weighed = np.linalg.solve(covariance, slope)
    information = float(slope @ weighed)
    value = float(weighed @ difference) / information
    return value, float(1 / np.sqrt(information)), value**2 * information
