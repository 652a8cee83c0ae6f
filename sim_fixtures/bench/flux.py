"""Flux on the detector, computed ahead of the reading.

The optical model takes a fraction of a wall-clock second for a new geometry. The bench knows where every arm is
bound for, so that the computation starts with the motion and has usually ended when the meter asks.
"""

from __future__ import annotations

import math
import threading
from concurrent.futures import Future
from typing import Any, Literal, NamedTuple, Protocol

from sim_fixtures.polarizer import USUAL_AMPLITUDE, behind_polarizer

Mounted = Literal["reference", "sample"]
#: How much more light the plain sample sends sideways when it is turned by 45 degrees.
_GRAIN = 0.05


class Geometry(NamedTuple):
    """What the flux depends on: angles in degree, wavelength in nm; ``polarizer`` None where there is none."""

    mounted: str
    illumination_zenith: float
    sensor_zenith: float
    sensor_azimuth: float
    wavelength: float
    sample_rotation: float = 0.0
    polarizer: float | None = None

    def rounded(self) -> Geometry:
        """The same to 0.01 degree and 0.01 nm, as the cache knows it (``+ 0.0`` turns -0.0 into 0.0)."""

        def near(value: float) -> float:
            return round(value, 2) + 0.0

        return self._replace(
            illumination_zenith=near(self.illumination_zenith),
            sensor_zenith=near(self.sensor_zenith),
            sensor_azimuth=near(self.sensor_azimuth),
            wavelength=near(self.wavelength),
            sample_rotation=near(self.sample_rotation),
            polarizer=None if self.polarizer is None else near(self.polarizer),
        )

    def arguments(self) -> tuple[Any, ...]:
        """What a flux function is asked with; one that knows three arms only is asked for no more."""
        return tuple(self) if self.sample_rotation or self.polarizer is not None else self[:5]


class FluxFunction(Protocol):
    """Detected flux relative to an ideal Lambertian sample of reflectance factor 1 at the reference geometry."""

    def __call__(
        self,
        mounted: Any,
        illumination_zenith: float,
        sensor_zenith: float,
        sensor_azimuth: float,
        wavelength: float,
        sample_rotation: float = 0.0,
        polarizer: float | None = None,
    ) -> float: ...


def lambertian_flux(
    mounted: Mounted,
    illumination_zenith: float,
    sensor_zenith: float,
    sensor_azimuth: float,
    wavelength: float,
    sample_rotation: float = 0.0,
    polarizer: float | None = None,
) -> float:
    """Flux of a flat Lambertian sample (reflectance factor 0.5; reference 0.99) with a narrow parallel beam.

    The spot lies within the field of view, so that the detected flux goes with the cosine of the sensor zenith;
    1 at sensor zenith 15 degrees and reflectance factor 1, whatever the illumination. The sample has a grain that shows
    when it is turned.
    """
    reflectance = 0.99 if mounted == "reference" else 0.5
    flux = reflectance * max(math.cos(math.radians(sensor_zenith)), 0.0) / math.cos(math.radians(15.0))
    if mounted == "sample":
        flux *= (
            1.0 + _GRAIN * math.sin(math.radians(sensor_zenith)) ** 2 * math.sin(2 * math.radians(sample_rotation)) ** 2
        )
    if polarizer is None:
        return flux
    return flux * behind_polarizer(polarizer, sensor_zenith, sensor_azimuth, USUAL_AMPLITUDE)


class FluxAhead:
    """Caches a flux function and computes the value expected next in a background thread.

    Only the last expectation counts: targets of arms that are still being commanded one after the other are
    superseded before their computation starts.

    Parameters
    ----------
    flux
        Thread-safe function of the geometry.
    patience
        Wall-clock seconds without a new expectation before the computation starts.
    """

    def __init__(self, flux: FluxFunction, patience: float = 0.03) -> None:
        self._flux, self._patience = flux, patience
        self._known: dict[Geometry, Future[float]] = {}
        self._lock = threading.Lock()
        self._wanted: Geometry | None = None
        self._news = threading.Event()
        self._closed = False
        self._thread = threading.Thread(target=self._work, name="flux-ahead", daemon=True)
        self._thread.start()

    def expect(self, geometry: Geometry) -> None:
        """Announce the geometry that will probably be read next."""
        with self._lock:
            self._wanted = geometry.rounded()
        self._news.set()

    def value(self, geometry: Geometry) -> float:
        """The flux at a geometry; waits for a computation that is under way."""
        return self._computed(geometry.rounded()).result()

    def close(self) -> None:
        """End the background thread."""
        self._closed = True
        self._news.set()
        self._thread.join(timeout=5.0)

    def _computed(self, geometry: Geometry) -> Future[float]:
        with self._lock:
            future = self._known.get(geometry)
            mine = future is None
            if future is None:
                future = self._known[geometry] = Future()
        if mine:
            try:
                future.set_result(float(self._flux(*geometry.arguments())))
            except Exception as error:  # noqa: BLE001 - handed on to whoever asks for the value
                future.set_exception(error)
        return future

    def _work(self) -> None:
        while True:
            self._news.wait()
            while self._news.is_set() and not self._closed:
                self._news.clear()
                self._news.wait(self._patience)
            if self._closed:
                return
            with self._lock:
                wanted, self._wanted = self._wanted, None
            if wanted is not None:
                self._computed(wanted)
