"""The twin's speed, and how it compares with the program that the paper tested.

::

    make bench                                  # everything; the peer where its environment exists or can be made
    python benchmarks/bench_tracer.py --no-peer --size small

Every measurement is a process of its own (:mod:`measures`, ``peer_eradiate``). Agreement with the references comes
first: an estimator that is off has no speed. Results go into ``docs/performance.md`` between its markers, the raw
numbers into ``benchmarks/results.json``.
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import resource
import subprocess
import sys
import tempfile
import time
import venv
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import measures
import numpy as np
from report import machine, write_report

Json = dict[str, Any]
HERE = Path(__file__).resolve().parent
ROOT = HERE.parent
PEER_PACKAGE = "eradiate-mitsuba==0.5.0"
PEER_FOLDER = ROOT / ".bench" / "peer"

SIZES: dict[str, Json] = {
    "full": {
        "repeats": 3,
        "every": 1,
        "efficiency": [2048],
        "standard_error": 0.001,
        "live": 40,
        "change_every": 8,
        "convergence": [32, 64, 128, 256, 512, 1024, 2048],
        "convergence_every": 20,
        "memory": [2**12, 2**14, 2**16],
        "memory_every": 8,
        "peer_samples": 16384,
        "peer_every": 6,
    },
    "medium": {
        "repeats": 1,
        "every": 1,
        "efficiency": [2048],
        "standard_error": 0.001,
        "live": 12,
        "change_every": 39,
        "convergence": [64, 256, 1024],
        "convergence_every": 40,
        "memory": [2**13, 2**15],
        "memory_every": 39,
        "peer_samples": 16384,
        "peer_every": 12,
    },
    "small": {
        "repeats": 2,
        "every": 39,
        "efficiency": [64],
        "standard_error": 0.02,
        "live": 3,
        "change_every": 39,
        "memory_every": 39,
        "convergence": [16, 64],
        "convergence_every": 99,
        "memory": [512, 1024],
        "peer_samples": 1024,
        "peer_every": 99,
    },
}


def main() -> int:
    arguments = parse()
    size = SIZES[arguments.size]
    reference = str(arguments.reference) if arguments.reference.is_dir() else None
    results: Json = {"size": arguments.size, "machine": machine(), "python": platform.python_version()}
    with tempfile.TemporaryDirectory() as folder:
        scratch = Path(folder)
        results |= twin_results(scratch, size, reference)
        peer = None if arguments.no_peer else peer_python(arguments.peer)
        if reference is not None and peer is not None:
            results["peer"] = peer_results(scratch, size, reference, peer, arguments.peer_bsdf)
    if reference is not None:
        results["comparison"] = compare(results, reference)
    arguments.json.write_text(json.dumps(results, indent=1) + "\n")
    write_report(results, arguments.out)
    say(f"written: {arguments.out}, {arguments.json}")
    return 0 if results.get("comparison", {}).get("agrees", True) else 1


def parse() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--size", choices=SIZES, default="full")
    parser.add_argument("--no-peer", action="store_true", help="the twin alone")
    parser.add_argument("--peer", type=Path, help="Python of an environment with the peer; made where not given")
    parser.add_argument("--peer-bsdf", choices=("corrected", "native"), default="corrected",
                        help="the peer's own plugin samples wrongly; its speed is the same")  # fmt: skip
    parser.add_argument("--reference", type=Path, default=ROOT.parent / "shared" / "reference")
    parser.add_argument("--out", type=Path, default=ROOT / "docs" / "performance.md")
    parser.add_argument("--json", type=Path, default=HERE / "results.json")
    return parser.parse_args()


def twin_results(scratch: Path, size: Json, reference: str | None) -> Json:
    """Every measurement of the twin."""
    every, goal = size["every"], size["standard_error"]
    results: Json = {}
    if reference is not None:
        settings = {"reference": reference, "samples": size["efficiency"], "repeats": size["repeats"]}
        results["efficiency"] = measure(scratch, "efficiency", settings)
        settings = {"reference": reference, "samples": size["convergence"], "every": size["convergence_every"]}
        results["convergence"] = measure(scratch, "convergence", settings | {"repeats": size["repeats"]})
    common = {"every": every, "standard_error": goal}
    results["plan"] = measure(scratch, "plan", common | {"repeats": size["repeats"]})
    results["live"] = measure(scratch, "live", {"points": size["live"], "standard_error": goal})
    results["change"] = measure(scratch, "change", common | {"every": size["change_every"]})
    results["memory"] = [
        measure(scratch, "memory", {"every": size["memory_every"], "samples": samples}) for samples in size["memory"]
    ]
    with empty_kernel_cache(scratch) as environment:
        results["start"] = {
            state: [measure(scratch, "start", common, environment) for _ in range(repeats)]
            for state, repeats in (("first_ever", 1), ("later", size["repeats"]))
        }
    return results


def measure(scratch: Path, name: str, settings: Json, environment: dict[str, str] | None = None) -> Json:
    """Run one measurement in a process of its own; adds what the whole process took."""
    say(f"twin: {name} {json.dumps({k: v for k, v in settings.items() if k != 'reference'})}")
    file = scratch / "settings.json"
    file.write_text(json.dumps(settings))
    output, cost = run([sys.executable, str(HERE / "measures.py"), name, str(file)], environment)
    return json.loads(output.splitlines()[-1]) | {"process": cost}


def run(command: list[str], environment: dict[str, str] | None = None) -> tuple[str, Json]:
    """Output of a program, and the processor and wall seconds of the whole process."""
    before, started = resource.getrusage(resource.RUSAGE_CHILDREN), time.perf_counter()
    paths = os.pathsep.join(filter(None, [str(ROOT), os.environ.get("PYTHONPATH")]))
    done = subprocess.run(
        command, capture_output=True, text=True, check=False,
        env=os.environ | {"PYTHONPATH": paths} | (environment or {}),
    )  # fmt: skip
    wall, after = time.perf_counter() - started, resource.getrusage(resource.RUSAGE_CHILDREN)
    if done.returncode:
        raise SystemExit(f"{Path(command[1]).name} ended with status {done.returncode}:\n{done.stderr}")
    cpu = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    return done.stdout, {"cpu": cpu, "wall": wall}


@contextmanager
def empty_kernel_cache(scratch: Path) -> Iterator[dict[str, str]]:
    """An environment in which no kernel was ever compiled: Dr.Jit keeps them in the home folder."""
    home = scratch / "home"
    home.mkdir()
    yield {"HOME": str(home)}


def peer_python(given: Path | None) -> Path | None:
    """Python of the peer's environment, made where there is none; None where that fails (no network, say)."""
    if given is not None:
        return given
    python = PEER_FOLDER / "bin" / "python"
    if not python.exists():
        say(f"peer: making an environment with {PEER_PACKAGE}")
        venv.create(PEER_FOLDER, with_pip=True)
    installed = subprocess.run([python, "-c", "import mitsuba"], capture_output=True, check=False).returncode == 0
    if not installed:
        command = [str(python), "-m", "pip", "install", "--quiet", PEER_PACKAGE, "numpy"]
        installed = subprocess.run(command, check=False).returncode == 0
    if not installed:
        say(f"peer: {PEER_PACKAGE} cannot be installed here; going on without")
    return python if installed else None


def peer_results(scratch: Path, size: Json, reference: str, python: Path, bsdf: str) -> Json:
    """The peer on the same mesh, table and geometries."""
    say(f"peer: {size['peer_samples']} paths a geometry, {size['repeats']} repeats")
    from twin.artifact import build_mesh
    from twin.llvm import choose_llvm
    from twin.material import read_material

    mesh = build_mesh(measures.reference_artifact())
    table = read_material(Path(reference) / "table_brdf.nc").brdf[0]
    geometries = measures.reference_run(reference)
    rows = np.arange(0, geometries.sizes["point"], size["peer_every"])
    scene, result = scratch / "scene.npz", scratch / "result.npz"
    np.savez(
        scene,
        vertices=mesh.vertices,
        faces=mesh.faces,
        brdf=table,
        illumination=geometries.theta_ill.values[rows].astype(float),
        sensor_zenith=geometries.theta_sen.values[rows].astype(float),
        sensor_azimuth=geometries.phi_sen.values[rows].astype(float),
        beam_radius=measures.BEAM_DIAMETER / 2,
        target_radius=measures.BEAM_DIAMETER / 2,
        source_distance=measures.SOURCE_DISTANCE,
        samples=size["peer_samples"],
        repeats=size["repeats"],
        native=bsdf == "native",
        one_launch=True,
        rr_depth=5,
    )
    environment = {"DRJIT_LIBLLVM_PATH": str(choose_llvm())}
    _, cost = run([str(python), str(HERE / "peer_eradiate.py"), str(scene), str(result)], environment)
    with np.load(result) as data:
        found = {name: data[name].tolist() for name in data.files}
    return found | {"rows": rows.tolist(), "samples": size["peer_samples"], "bsdf": bsdf, "process": cost}


def compare(results: Json, reference: str) -> Json:
    """Agreement with the references, efficiencies, and their ratios."""
    run_data = measures.reference_run(reference)
    truth, u_truth = np.pi * run_data.L_art.values, np.pi * run_data.L_art_se.values
    sensor, light = run_data.theta_sen.values, run_data.theta_ill.values
    retro = (sensor == light) & ((run_data.phi_sen.values == 0) | (light == 0))
    grazing = np.abs(sensor) == 80
    runs = results["efficiency"]["runs"]
    finest = max(run["samples"] for run in runs)
    chosen = [run for run in runs if run["samples"] == finest]
    count = len(truth)
    twin = {name: np.array([run[name] for run in chosen]) for name in ("mean", "error", "cpu")}
    figures: Json = {"twin": figures_of(twin["mean"], twin["error"], twin["cpu"][:, None] / count, grazing)}
    figures["twin"] |= {"samples": finest, "agreement": agreement(twin, truth, u_truth, ~retro)}
    figures["twin"]["other_samples"] = {
        str(run["samples"]): figures_of(
            np.array([run["mean"]]), np.array([run["error"]]), np.array([[run["cpu"] / count]]), grazing
        )
        for run in runs
        if run["samples"] != finest
    }
    agrees = sound(figures["twin"]["agreement"])
    if "peer" in results:
        rows = np.array(results["peer"]["rows"])
        peer = {name: np.array(results["peer"][name]) for name in ("mean", "error", "cpu")}
        figures["peer"] = figures_of(peer["mean"], peer["error"], peer["cpu"], grazing[rows])
        figures["peer"]["agreement"] = agreement(peer, truth[rows], u_truth[rows], ~retro[rows])
        twin_each = efficiency_of(twin["mean"], twin["error"], twin["cpu"][:, None] / count)[rows]
        ratio = (efficiency_of(peer["mean"], peer["error"], peer["cpu"]) / twin_each) ** 2
        figures["ratio"] = {
            "median": float(np.median(ratio)),
            "grazing": float(np.median(ratio[grazing[rows]])),
            "smallest": float(ratio.min()),
            "largest": float(ratio.max()),
        }
        agrees = agrees and sound(figures["peer"]["agreement"])
    return figures | {"agrees": agrees}


def efficiency_of(mean: np.ndarray, error: np.ndarray, cpu: np.ndarray) -> np.ndarray:
    """Relative standard error times the square root of processor seconds, root mean square over the repeats, %."""
    return 100 * np.sqrt(np.mean((error / mean) ** 2 * cpu, axis=0))


def figures_of(mean: np.ndarray, error: np.ndarray, cpu: np.ndarray, grazing: np.ndarray) -> Json:
    """Medians over all and over the grazing geometries, and their spread over the repeats."""
    each = 100 * error / mean * np.sqrt(cpu)
    found: Json = {"cpu_per_geometry": float(np.mean(cpu)), "median_error": float(np.median(error / mean))}
    for name, which in (("median", np.ones(len(grazing), dtype=bool)), ("grazing", grazing)):
        by_repeat = np.median(each[:, which], axis=1)
        found[name] = float(np.median(efficiency_of(mean, error, cpu)[which]))
        found[f"{name}_spread"] = float(np.ptp(by_repeat) / 2)
    return found


def agreement(found: Json, truth: np.ndarray, u_truth: np.ndarray, use: np.ndarray) -> Json:
    """Chi-square a point and mean ratio against the reference, apart from exact retro-reflection."""
    repeats = len(found["mean"])
    mean, error = found["mean"].mean(axis=0)[use], np.sqrt(np.mean(found["error"] ** 2, axis=0) / repeats)[use]
    truth, variance = truth[use], error**2 + u_truth[use] ** 2
    # Geometries may share light paths: what the repeats say of the mean ratio counts where it is more.
    ratios = np.mean(found["mean"][:, use] / truth, axis=1)
    between = np.std(ratios, ddof=1) / np.sqrt(repeats) if repeats > 1 else 0.0
    return {
        "chi_square": float(np.mean((mean - truth) ** 2 / variance)),
        "points": int(use.sum()),
        "ratio": float(np.mean(mean / truth)),
        "ratio_error": float(max(between, np.sqrt(np.sum(variance / truth**2)) / len(truth))),
    }


def sound(agreement: Json) -> bool:
    """Within what chance allows: four standard deviations of each."""
    chance = 4 * np.sqrt(2 / agreement["points"])
    return bool(abs(agreement["ratio"] - 1) < 4 * agreement["ratio_error"] and agreement["chi_square"] < 1 + chance)


def say(text: str) -> None:
    print(text, file=sys.stderr, flush=True)


if __name__ == "__main__":
    sys.exit(main())
