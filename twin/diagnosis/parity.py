"""Symmetries that a sound run has whatever the sample reflects: a test without any simulation.

Of a sample that looks the same in a mirror along the plane of incidence, directions on either side of that plane
reflect alike; at normal incidence so do opposite directions, for a sample of fourfold symmetry those a quarter turn
apart, and for one without any structure all of a zenith. At the sensor's zenith 0 its azimuth does not matter at all.
What breaks these symmetries is an error of pose, of an arm, of polarisation or of time, and hardly ever one of material
or dimensions.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree
from scipy.stats import chi2

from instrument.angles import FloatArray, direction
from twin.diagnosis import parity_nadir
from twin.diagnosis.covariance import structures
from twin.diagnosis.observation import Observation
from twin.diagnosis.parity_nadir import Nadir, at_nadir
from twin.diagnosis.parity_terms import Term, fit_terms, square
from twin.diagnosis.turned import rotation

__all__ = ["Nadir", "Parity", "Symmetry", "Term", "equal_pairs", "parities", "parity"]

#: How the sample looks when it is turned about its normal; all have a mirror along the plane of incidence as they lie.
Symmetry = Literal["isotropic", "fourfold", "twofold", "mirror"]
#: By how much a sample must be turned to look the same, degree; by half of it, to have its mirror there again.
_PERIOD: dict[Symmetry, float] = {"isotropic": 0.0, "fourfold": 90.0, "twofold": 180.0, "mirror": 360.0}
#: Directions closer than this are the same, degree; illumination zeniths below it are normal incidence.
_SAME = 0.05
_LEVEL = 0.05
#: Points that are tested together at most: their number squared is the cost.
MOST_POINTS = 500
#: A reading that differs by more than this from its like, and so many times more than nine in ten do, has failed.
_DROP_OUT, _DROP_OUT_RATIO = 0.1, 8.0
IntArray = NDArray[np.int64]


@dataclass(frozen=True)
class Parity:
    """What the symmetries of a run say, at one wavelength.

    Attributes
    ----------
    wavelength
        nm; NaN where the run names none.
    pairs, shape (pair, 2)
        Points that should read alike.
    asymmetry, u_asymmetry, shape (pair,)
        Logarithm of the ratio of their readings, and its standard uncertainty under the most probable structure.
    chi_square, p_value
        Over the pairs, and probability of more by chance, averaged over how stability may be correlated.
    terms
        Simple causes, the best first; empty without pairs.
    nadir
        What the azimuth does at sensor zenith 0.
    drop_outs
        Points left out because their reading has failed.
    notes
        What else was left out.
    """

    wavelength: float
    pairs: IntArray
    asymmetry: FloatArray
    u_asymmetry: FloatArray
    chi_square: float
    p_value: float
    terms: tuple[Term, ...]
    nadir: tuple[Nadir, ...] = ()
    drop_outs: IntArray = field(default_factory=lambda: np.zeros(0, dtype=np.int64))
    notes: tuple[str, ...] = ()

    @property
    def broken(self) -> bool:
        """Whether the run is less symmetric than its uncertainty explains."""
        return bool(len(self.pairs)) and self.least_p < _LEVEL

    @property
    def least_p(self) -> float:
        """The smaller probability: of the scatter of all pairs, or of the best simple cause; doubled for two tests."""
        best = self.terms[0].p_value if self.terms else 1.0
        return float(min(1.0, 2 * min(self.p_value, best)))

    def in_words(self) -> list[str]:
        """What the test suggests, and what it cannot confirm."""
        if not len(self.pairs):
            return ["Parity: the run holds no two directions that symmetry makes equal; nothing can be said."]
        size = 100 * float(np.sqrt(np.mean(self.asymmetry**2)))
        at = "" if np.isnan(self.wavelength) else f" at {self.wavelength:g} nm"
        text = f"Parity of {len(self.pairs)} pairs of directions{at}: asymmetry {size:.2f} % (root mean square)"
        if not self.broken:
            return [f"{text}, no more than noise and stability explain ({_probability(self.least_p)}).", *self.notes]
        lines = [f"{text}, more than noise and stability explain ({_probability(self.least_p)})."]
        clear = [term for term in self.terms[:2] if term.p_value < _LEVEL]
        for number, term in enumerate(clear):
            lines.append(
                f"{'Or, also alone,' if number else 'It has the form of'} {term.meaning}: {term.amplitude:.3g} +-"
                f" {term.u:.2g} {term.unit}; fitted alone, that explains {100 * term.explained:.0f} % of what is beyond"
                " chance."
            )
        if clear:
            lines.append("An amplitude within the uncertainty of the alignment, which is not known here, is no fault.")
        else:
            lines.append("It has the form of none of the simple causes that were tried (tilts, zero errors, drift).")
        lines += parity_nadir.in_words(self.nadir)
        lines.append(
            "Symmetry alone cannot confirm a cause: a wedge or an uneven sample breaks it like a tilt; errors that"
            " keep the symmetry (material, dimensions, height, stray light, linearity) do not show here."
        )
        return lines + list(self.notes)

    def to_dict(self) -> dict[str, Any]:
        """As JSON; points are counted along the run that was tested."""
        return {
            "wavelength": None if np.isnan(self.wavelength) else self.wavelength,
            "pairs": len(self.pairs),
            "rms_asymmetry": float(np.sqrt(np.mean(self.asymmetry**2))) if len(self.pairs) else 0.0,
            "p_value": self.least_p,
            "broken": self.broken,
            "terms": [vars(term) for term in self.terms],
            "nadir": [vars(n) | {"tilt_deg": n.tilt_deg} for n in self.nadir],
            "drop_outs": self.drop_outs.tolist(),
            "words": self.in_words(),
        }


def _probability(p_value: float) -> str:
    """Tails of assumed distributions are not known further out than this."""
    return f"p = {p_value:.2g}" if p_value >= 1e-6 else "p below 1e-6"


def parities(run: Observation, *, symmetry: Symmetry = "fourfold") -> tuple[Parity, ...]:
    """The test at each wavelength of a run; points of a result are counted along the whole run."""
    wavelengths = np.round(run.columns["wavelength"], 3)
    groups = [np.flatnonzero(_is(wavelengths, one)) for one in np.unique(wavelengths)]
    found = []
    for rows in groups:
        one = parity(run.take(rows), symmetry=symmetry)
        found.append(Parity(**(vars(one) | {"pairs": rows[one.pairs], "drop_outs": rows[one.drop_outs]})))
    return tuple(found)


def _is(values: FloatArray, one: float) -> NDArray[np.bool_]:
    return np.isnan(values) if np.isnan(one) else np.equal(values, one)


def parity(run: Observation, *, symmetry: Symmetry = "fourfold") -> Parity:
    """Test the symmetries of a run of one wavelength.

    Parameters
    ----------
    symmetry
        How the sample looks when it is turned: ``fourfold`` holds for a square lattice and for no structure at all.
    """
    pairs, wavelength = equal_pairs(run, symmetry=symmetry), float(run.columns["wavelength"][0])
    failed = _drop_outs(run, pairs)
    notes = []
    if len(failed):
        notes.append(f"Left out as drop-outs, more than 10 % from their like: {len(failed)} of {len(run)} readings.")
        kept = np.setdiff1d(np.arange(len(run)), failed)
        pairs = kept[equal_pairs(run.take(kept), symmetry=symmetry)]
    if not len(pairs):
        return Parity(wavelength, pairs, np.zeros(0), np.zeros(0), 0.0, 1.0, (), (), failed, tuple(notes))
    chosen = _thinned(pairs)
    if len(chosen) < len(pairs):
        notes.append(f"{len(chosen)} of {len(pairs)} pairs were tested, evenly chosen.")
    points, place = np.unique(chosen, return_inverse=True)
    part, local = run.take(points), place.reshape(-1, 2)
    difference = np.log(part.brf[local[:, 0]] / part.brf[local[:, 1]])
    covariances = [(s.weight, _of_pairs(s.covariance, local)) for s in structures(part)]
    weighed = [(np.log(weight) + _log_density(difference, c), c) for weight, c in covariances]
    top = max(value for value, _ in weighed)
    share = np.array([np.exp(value - top) for value, _ in weighed])
    share /= share.sum()
    kept_members = [(w, c) for w, (_, c) in zip(share, weighed, strict=True) if w > 1e-3]
    squares = np.array([square(difference, c) for _, c in kept_members])
    weights = np.array([w for w, _ in kept_members]) / sum(w for w, _ in kept_members)
    p_value = float(weights @ chi2.sf(squares, len(difference)))
    terms = fit_terms(part, local, difference, [c for _, c in kept_members], weights)
    u_best = np.sqrt(np.diag(kept_members[int(np.argmax(weights))][1]))
    mean_square = float(weights @ squares)
    nadir = at_nadir(run, failed)
    return Parity(wavelength, chosen, difference, u_best, mean_square, p_value, terms, nadir, failed, tuple(notes))


def equal_pairs(run: Observation, *, symmetry: Symmetry = "fourfold") -> IntArray:
    """Pairs of points whose readings symmetry makes equal, shape (pair, 2); no pair follows from the others."""
    columns = run.columns
    view = direction(columns["sensor_zenith"], columns["sensor_azimuth"] - columns["illumination_azimuth"])
    normal = np.abs(columns["illumination_zenith"]) < _SAME
    if symmetry == "isotropic":
        view[normal, 0], view[normal, 1] = np.hypot(view[normal, 0], view[normal, 1]), 0.0
    wavelength = np.nan_to_num(columns["wavelength"], nan=0.0)
    turned = np.deg2rad(_turned(run, _PERIOD[symmetry]))
    mirrored = _turned(run, _PERIOD[symmetry] / 2) < _SAME
    place = np.column_stack([view, np.deg2rad(columns["illumination_zenith"]), wavelength, turned])
    tree = cKDTree(place)
    root = np.arange(len(run))
    found: list[tuple[int, int]] = []
    for number, change in enumerate(_symmetries(symmetry)):
        moved = place.copy()
        moved[:, :3] = view @ change.T
        distance, nearest = tree.query(moved, distance_upper_bound=np.deg2rad(_SAME))
        partner = np.asarray(nearest, dtype=np.int64)
        for point in np.flatnonzero(np.isfinite(distance)):
            if normal[point] if number else mirrored[point]:
                _join(root, found, int(point), int(partner[point]))
    for first, second in sorted(tree.query_pairs(np.deg2rad(_SAME))):
        _join(root, found, first, second)
    return np.array(sorted(found), dtype=np.int64).reshape(-1, 2)


def _turned(run: Observation, period_deg: float) -> FloatArray:
    """How far the sample lies from where it looks the same as unturned, degree, shape (point,)."""
    if period_deg == 0:
        return np.zeros(len(run))
    rest = np.mod(rotation(run.columns), period_deg)
    return np.where(period_deg - rest < _SAME, 0.0, rest)


def _join(root: IntArray, found: list[tuple[int, int]], first: int, second: int) -> None:
    """Note a pair unless it follows from those noted before."""
    one, two = _top(root, first), _top(root, second)
    if one != two:
        root[two] = one
        found.append((min(first, second), max(first, second)))


def _symmetries(symmetry: Symmetry) -> list[FloatArray]:
    """The mirror along the plane of incidence first; then what holds at normal incidence only."""
    mirror, half, quarter = np.diag([1.0, -1.0, 1.0]), np.diag([-1.0, -1.0, 1.0]), np.zeros((3, 3))
    quarter[0, 1], quarter[1, 0], quarter[2, 2] = -1.0, 1.0, 1.0
    return {"mirror": [mirror], "twofold": [mirror, half]}.get(symmetry, [mirror, half, quarter])


def _top(root: IntArray, point: int) -> int:
    while root[point] != point:
        root[point] = root[root[point]]
        point = int(root[point])
    return point


def _drop_outs(run: Observation, pairs: IntArray) -> IntArray:
    """Points whose reading has failed: far from the median of those that should read alike."""
    if not len(pairs):
        return np.zeros(0, dtype=np.int64)
    root = np.arange(len(run))
    for first, second in pairs:
        _join(root, [], int(first), int(second))
    group = np.array([_top(root, point) for point in range(len(run))])
    log_brf, apart = np.log(run.brf), np.zeros(len(run))
    for one in np.unique(group[pairs.ravel()]):
        rows = np.flatnonzero(group == one)
        apart[rows] = np.abs(log_brf[rows] - np.median(log_brf[rows]))
    usual = float(np.quantile(apart[np.unique(pairs)], 0.9))
    return np.flatnonzero(apart > max(_DROP_OUT, _DROP_OUT_RATIO * usual))


def _thinned(pairs: IntArray) -> IntArray:
    """Few enough pairs, evenly chosen."""
    if len(np.unique(pairs)) <= MOST_POINTS:
        return pairs
    return pairs[np.linspace(0, len(pairs) - 1, MOST_POINTS // 2).round().astype(int)]


def _of_pairs(covariance: FloatArray, pairs: IntArray) -> FloatArray:
    first, second = pairs[:, 0], pairs[:, 1]
    return np.asarray(
        covariance[np.ix_(first, first)]
        + covariance[np.ix_(second, second)]
        - covariance[np.ix_(first, second)]
        - covariance[np.ix_(second, first)]
    )


def _log_density(difference: FloatArray, covariance: FloatArray) -> float:
    return -0.5 * (square(difference, covariance) + float(np.linalg.slogdet(covariance)[1]))
