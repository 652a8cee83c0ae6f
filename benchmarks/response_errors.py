"""How well the responses to effects are known: ``python benchmarks/response_errors.py``.

The first table compares what is read off between the nodes of a tabulated response with what is rendered there, at the
middle between every two neighbours (four random middles of two parameters). The second compares the rendered change
with that of the simulated laboratory, whose ray tracer and quadrature share no code with the twin's, both without any
other error. The first leaves out what all points get wrong alike. Processor seconds: about 250.
"""

from __future__ import annotations

import argparse

import numpy as np

from instrument.angles import FloatArray
from instrument.facility import read_facility
from instrument.plan import read_plan
from sim_fixtures.examples import example_files
from sim_fixtures.reality import Imperfections, Reality
from sim_fixtures.reality.imperfections import OpticsErrors
from twin.content import cache_folder
from twin.diagnosis.acquisition import Acquisition, travel_direction
from twin.diagnosis.preparation import Bench, Inputs
from twin.diagnosis.renders import RenderStore
from twin.diagnosis.response import TabulatedResponse
from twin.diagnosis.responses import responses
from twin.diagnosis.variation import Variation
from twin.optics import Setup, geometry_columns

#: Relative standard uncertainty that errors are told in.
U_RELATIVE = 0.013
ZENITHS = np.array([80.0, 65.0, 50.0, 35.0, 20.0, 5.0, -5.0, -20.0, -35.0, -50.0, -65.0, -80.0])
#: What is off, as the laboratory and the twin call it.
OFF = {
    "beam 0.5, 1.4 mm beside the centre": (
        Imperfections(beam_offset_x_mm=0.5, beam_offset_y_mm=1.4),
        Setup(beam_x_mm=0.5, beam_y_mm=1.4),
    ),
    "sample 2.3 mm too high": (Imperfections(sample_height_mm=2.3), Setup(height_mm=2.3)),
    "sample moved by 1.2, 0.8 mm": (
        Imperfections(sample_offset_x_mm=1.2, sample_offset_y_mm=0.8),
        Setup(offset_x_mm=1.2, offset_y_mm=0.8),
    ),
    "sample turned by 10 degrees": (Imperfections(sample_azimuth_deg=10.0), Setup(sample_azimuth_deg=10.0)),
    "sensor zenith 1 degree off": (Imperfections(sensor_zenith_offset_deg=1.0), Setup(sensor_zenith_deg=1.0)),
    "beam divergence 4 degrees": (Imperfections(beam_divergence_deg=4.0), Setup(divergence_deg=4.0)),
    "mirror 20 mm wider": (Imperfections(optics=OpticsErrors(mirror_radius_mm=20.0)), Setup(mirror_radius_mm=20.0)),
    "iris 1 mm narrower": (Imperfections(optics=OpticsErrors(beam_radius_mm=-1.0)), Setup(beam_radius_mm=-1.0)),
}


def main() -> None:
    """Print both tables."""
    argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter).parse_args()
    files = example_files()
    bench = Bench(Inputs(files.facility, files.artifact, files.material), cache_folder())
    points = read_plan(files.plan, read_facility(files.facility)).points
    columns = geometry_columns(points)
    between_nodes(bench, columns)
    beside_the_laboratory(bench)


def between_nodes(bench: Bench, columns: dict[str, FloatArray]) -> None:
    """Print errors of interpolation at changes of 0.5 to 4 standard uncertainties: over the change, and over these."""
    count = len(columns["sensor_zenith"])
    order = np.arange(count)
    run = Acquisition(
        columns, np.ones(count), 15.0, np.array([0.0, 45.0, 90.0, 135.0]), np.maximum(order - 1, 0),
        travel_direction(columns, order),
    )  # fmt: skip
    found = responses(run, np.full(count, 0.5), bench.store)
    fresh = RenderStore(bench.workbench, None)
    print(f"Changes of 0.5 to 4 u, u = {U_RELATIVE:g}; largest errors.\n")
    print("| effect | nodes | error over change | error over u |\n|---|---|---|---|")
    for name, response in found.found.items():
        if not isinstance(response, TabulatedResponse):
            continue
        values = _middles(response)
        read = response.log_ratio(values)
        group = [Variation(), *(response.effect.variation(value) for value in values)]  # type: ignore[attr-defined]
        rendered = fresh.get([group], columns)[0].log_ratio(columns)
        direct = rendered[1:] - rendered[0]
        # Takes off the change of the reference reading, and with it what all points get wrong alike.
        direct -= np.median(direct - read, axis=1, keepdims=True)
        change, error = _rms(direct), _rms(read - direct)
        seen = (change > 0.5 * U_RELATIVE) & (change < 4 * U_RELATIVE)
        if np.any(seen):
            largest = np.max((error / change)[seen]), np.max(error[seen]) / U_RELATIVE
            nodes = " x ".join(str(len(axis)) for axis in response.axes)
            print(f"| {name} | {nodes} | {largest[0]:.3f} | {largest[1]:.2f} |", flush=True)


def beside_the_laboratory(bench: Bench) -> None:
    """Print differences between the twin's change and the laboratory's, illumination 0 and 30 degrees, in the plane."""
    store = RenderStore(bench.workbench, None)
    perfect = Reality(bench.facility, bench.artifact, rays=2**18)
    print("\n| what is off | change | twin less laboratory |\n|---|---|---|")
    for what, (wrong, setup) in OFF.items():
        spoiled = Reality(bench.facility, bench.artifact, wrong, rays=2**18)
        reference = np.log(_reference(bench, spoiled) / _reference(bench, perfect))
        changes, differences = [], []
        for light in (0.0, 30.0):
            flux = [one.flux_many("sample", light, ZENITHS, np.zeros(len(ZENITHS))) for one in (spoiled, perfect)]
            free = (flux[0] > 0) & (flux[1] > 0)
            there = np.log(flux[0][free] / flux[1][free]) - reference
            columns = {
                "wavelength": np.full(int(free.sum()), 500.0),
                "illumination_zenith": np.full(int(free.sum()), light),
                "illumination_azimuth": np.zeros(int(free.sum())),
                "sensor_zenith": ZENITHS[free],
                "sensor_azimuth": np.zeros(int(free.sum())),
            }
            nominal, off = store.get([[Variation(), Variation(setup)]], columns)[0].log_ratio(columns)
            changes.append(there)
            differences.append(off - nominal - np.log(bench.workbench.reference_change(setup)) - there)
        print(f"| {what} | {_rms(np.concatenate(changes)):.4f} | {_rms(np.concatenate(differences)):.4f} |", flush=True)


def _reference(bench: Bench, reality: Reality) -> float:
    at = bench.facility.reference
    return float(
        np.mean([reality.flux("reference", at.illumination_zenith, at.sensor_zenith, a) for a in at.sensor_azimuth])
    )


def _middles(response: TabulatedResponse) -> FloatArray:
    """Values between nodes, shape (value, parameter)."""
    middles = [(axis[1:] + axis[:-1]) / 2 if len(axis) > 1 else axis for axis in response.axes]
    if len(middles) == 1:
        return middles[0][:, None]
    generator = np.random.default_rng(1)
    return np.stack([generator.choice(axis, 4) for axis in middles], axis=1)


def _rms(rows: FloatArray) -> FloatArray:
    return np.asarray(np.sqrt(np.mean(rows**2, axis=-1)))


if __name__ == "__main__":
    main()
