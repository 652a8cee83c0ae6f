"""What the benchmark measures of the twin: one measurement a process.

::

    python benchmarks/measures.py NAME SETTINGS.json

prints the result as one JSON line. Each runs in a process of its own so that its memory, its start and its compiled
kernels are its own. Costs are processor seconds of all threads, warm where not said otherwise.
"""

from __future__ import annotations

import json
import resource
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np

Json = dict[str, Any]
PITCH, HOLES_A_SIDE, DIAMETER, THICKNESS, DEPTH, SPACER = 3.6, 12, 2.55, 1.13, 3.26, 4.0
#: The references' light comes from a point this far away, mm.
SOURCE_DISTANCE = 2000.0
BEAM_DIAMETER = 10.8


def reference_artifact() -> Any:
    """The sample of the references: the paper's artifact with every hole in its nominal place."""
    from instrument.artifact import ArtifactDimensions, ArtifactForm, Holes

    row = (np.arange(HOLES_A_SIDE) - (HOLES_A_SIDE - 1) / 2) * PITCH
    x, y = (grid.ravel() for grid in np.meshgrid(row, row, indexing="ij"))
    zero = np.zeros(len(x))
    form = ArtifactForm(plate_thickness=THICKNESS, cavity_depth=DEPTH, spacer_edge=SPACER)
    return ArtifactDimensions(form, Holes(x, y, zero + DIAMETER, zero, zero, zero), None, Path("artifact.toml"))


def reference_facility() -> Any:
    """Beam and sensor of the references: a uniform beam and parallel sight lines over a disc normal to the view."""
    from instrument.facility import Facility

    return Facility.model_validate(
        {
            "name": "reference",
            "beam": {"diameter": BEAM_DIAMETER, "profile": "tophat"},
            "sensor": {"target_diameter": BEAM_DIAMETER, "mirror_diameter": 0.0},
            "arms": {},
            "sample": {},
            "reference": {"reflectance_factor": 1.0, "u_relative": 0.0},
            "budget": {},
        }
    )


def reference_run(folder: str) -> Any:
    import xarray as xr

    with xr.open_dataset(Path(folder) / "artifact_qdfix_tophat_llvm.nc", engine="h5netcdf") as data:
        return data.load()


def example_twin() -> Any:
    from sim_fixtures.examples import example_files
    from twin.prediction import Twin

    files = example_files()
    return Twin.from_files(files.facility, files.artifact, files.material)


def example_points() -> Any:
    from instrument.facility import read_facility
    from instrument.plan import read_plan
    from sim_fixtures.examples import example_files

    files = example_files()
    return read_plan(files.plan, read_facility(files.facility)).points


def reference_tracer(folder: str) -> tuple[Any, Any, Any]:
    """Tracer, layout and run of the reference set-up."""
    from twin.artifact import build_mesh
    from twin.material import read_material
    from twin.optics import COORDINATES, Setup, lay_out
    from twin.tracer import Tracer

    run = reference_run(folder)
    tracer = Tracer(build_mesh(reference_artifact()), read_material(Path(folder) / "table_brdf.nc"))
    count = run.sizes["point"]
    columns = {name: np.zeros(count) for name in COORDINATES} | {
        "wavelength": np.full(count, 500.0),
        "illumination_zenith": run.theta_ill.values.astype(float),
        "sensor_zenith": run.theta_sen.values.astype(float),
        "sensor_azimuth": run.phi_sen.values.astype(float),
    }
    layout = lay_out(reference_facility(), columns, Setup(source_distance_mm=SOURCE_DISTANCE))
    return tracer, layout, run


def cost(action: Any) -> tuple[Any, float, float]:
    """Result, processor seconds of all threads, and wall seconds of a call."""
    cpu, wall = time.process_time(), time.perf_counter()
    result = action()
    return result, time.process_time() - cpu, time.perf_counter() - wall


def efficiency(settings: Json) -> Json:
    """Values and errors in the reference set-up, and what they cost, for several sample counts and seeds."""
    from twin.tracer import mean_and_error

    tracer, layout, _ = reference_tracer(settings["reference"])
    table = np.zeros(len(layout), dtype=np.int64)
    runs = []
    for samples in settings["samples"]:
        tracer.radiance(layout, table, 64, seed=1)  # compiles
        for repeat in range(settings["repeats"]):
            values, cpu, _ = cost(
                lambda samples=samples, repeat=repeat: tracer.radiance(layout, table, samples, seed=11 + repeat)
            )
            mean, error = mean_and_error(values)
            runs.append({"samples": samples, "cpu": cpu, "mean": mean.tolist(), "error": error.tolist()})
    return {"runs": runs}


def plan(settings: Json) -> Json:
    """The whole Table IV plan to a standard error, in the example laboratory."""
    twin, points = example_twin(), example_points()[:: settings["every"]]
    twin.predict(points, standard_error=settings["standard_error"], seed=1)
    runs = []
    for repeat in range(settings["repeats"]):
        prediction, cpu, wall = cost(
            lambda repeat=repeat: twin.predict(points, standard_error=settings["standard_error"], seed=2 + repeat)
        )
        relative = (prediction.u_brf_monte_carlo / prediction.brf).values
        worst, median = float(relative.max()), float(np.median(relative))
        runs.append({"cpu": cpu, "wall": wall, "largest_error": worst, "median_error": median})
    return {"points": len(points), "runs": runs}


def live(settings: Json) -> Json:
    """Latency of single points in scan order, in a warm process, as the live twin asks for them."""
    twin, points = example_twin(), example_points()
    chosen = np.random.default_rng(3).permutation(len(points))[: settings["points"]]
    twin.predict(points, standard_error=settings["standard_error"])
    for number in chosen[:3]:
        twin.predict([points[number]], standard_error=settings["standard_error"], seed=5)
    wall, cpu = [], []
    for number in chosen:
        _, used, took = cost(lambda n=number: twin.predict([points[n]], standard_error=settings["standard_error"]))
        wall.append(took)
        cpu.append(used)
    return {"wall": wall, "cpu": cpu}


def change(settings: Json) -> Json:
    """Kernels compiled, and time taken, when one parameter changes and the plan is predicted again."""
    import dataclasses

    import drjit as dr

    from instrument.artifact import ArtifactDimensions
    from twin.optics import Setup
    from twin.prediction import Twin

    twin, points = example_twin(), example_points()[:: settings["every"]]
    artifact = twin.artifact

    def drilled(delta: float) -> ArtifactDimensions:
        return dataclasses.replace(
            artifact, holes=dataclasses.replace(artifact.holes, diameter=artifact.holes.diameter + delta)
        )

    def deeper(delta: float) -> ArtifactDimensions:
        form = artifact.form.model_copy(update={"cavity_depth": artifact.form.cavity_depth + delta})
        return dataclasses.replace(artifact, form=form)

    nominal = {"standard_error": settings["standard_error"], "seed": 1}
    changes = {
        "nothing": lambda: twin.predict(points, **nominal),
        "tilt of the sample": lambda: twin.predict(points, setup=Setup(tilt_x_deg=0.3), **nominal),
        "zero of the sensor arm": lambda: twin.predict(points, setup=Setup(sensor_zenith_deg=0.25), **nominal),
        "diameter of every hole": lambda: Twin(twin.facility, drilled(0.02), twin.material).predict(points, **nominal),
        "depth of the cavity": lambda: Twin(twin.facility, deeper(0.05), twin.material).predict(points, **nominal),
        "reflectance of the coating": lambda: Twin(twin.facility, artifact, twin.material.scaled(0.98)).predict(
            points, **nominal
        ),
    }
    changes["nothing"]()
    changes["nothing"]()
    result = {}
    with dr.scoped_set_flag(dr.JitFlag.KernelHistory):
        for name, action in changes.items():
            dr.kernel_history_clear()
            _, cpu, wall = cost(action)
            kernels = [entry for entry in dr.kernel_history() if entry.get("type") == dr.KernelType.JIT]
            fresh = [entry for entry in kernels if not entry["cache_hit"]]
            result[name] = {"compiled": len(fresh), "launched": len(kernels), "cpu": cpu, "wall": wall}
    return result


def convergence(settings: Json) -> Json:
    """Root mean square deviation from the mean of independent seeds against the number of samples."""
    tracer, layout, _ = reference_tracer(settings["reference"])
    chosen = np.arange(0, len(layout), settings["every"])
    layout, table = layout.take(chosen), np.zeros(len(chosen), dtype=np.int64)
    spread = []
    for samples in settings["samples"]:
        values = np.concatenate(
            [tracer.radiance(layout, table, samples, seed=100 + seed) for seed in range(settings["repeats"])], axis=1
        )
        spread.append(float(np.median(values.std(axis=1, ddof=1) / values.mean(axis=1))))
    slope = float(np.polyfit(np.log(settings["samples"]), np.log(spread), 1)[0])
    return {"samples": settings["samples"], "relative_spread": spread, "slope": slope}


def memory(settings: Json) -> Json:
    """Peak memory of a process that traces the plan with so many sight lines a point."""
    twin, points = example_twin(), example_points()[:: settings["every"]]
    twin.predict(points, samples=settings["samples"], seed=1)
    return {"samples": settings["samples"], "points": len(points), "peak_mb": _peak_mb()}


def start(settings: Json) -> Json:
    """From the start of the process to the first prediction of one point."""
    twin, points = example_twin(), example_points()
    _, cpu, wall = cost(lambda: twin.predict(points[:1], standard_error=settings["standard_error"]))
    return {"first_prediction_wall": wall, "first_prediction_cpu": cpu}


def _peak_mb() -> float:
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024


MEASURES = {f.__name__: f for f in (efficiency, plan, live, change, convergence, memory, start)}


if __name__ == "__main__":
    name, settings_file = sys.argv[1:]
    print(json.dumps(MEASURES[name](json.loads(Path(settings_file).read_text()))))
