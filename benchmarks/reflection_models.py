"""Reflection models on directions held out: linear table, smooth fit, Torrance-Sparrow.

    .venv/bin/python benchmarks/reflection_models.py [--shared ../shared]

Data: white PTFE at 532 nm (NIST, Germer 2017; a grid of six incidences, and 1760 random geometries) and the example
coupon. Of the grid the models see the planes 0/180, 45/135 and 90 degrees, as a plan for a coupon has them; the rest
and the random geometries are held out. The random geometries repeat to about 1.4 %, which is in every number of theirs.
"""

from __future__ import annotations

import argparse
import csv
from collections.abc import Callable
from pathlib import Path

import numpy as np

from instrument.angles import FloatArray
from instrument.dataset import read_run
from twin.coupon import coupon_readings, left_out_errors
from twin.coupon_heldout import fill_errors
from twin.coupon_layout import lay_out
from twin.reflection_models.compiled import Grid, interpolate
from twin.reflection_models.smooth import Directions, smooth
from twin.reflection_models.torrance_sparrow import fit_torrance_sparrow

Predictor = Callable[[Directions], FloatArray]


def read_ptfe(path: Path, wavelength_um: float) -> tuple[Directions, FloatArray]:
    """Directions and reflectance factors; a negative incident zenith means forward scattering at azimuth 0."""
    with path.open(encoding="utf-8") as file:
        rows = [row for row in csv.DictReader(file) if abs(float(row["lambda"]) - wavelength_um) < 1e-3]
    incident, turned, emergent, azimuth, brdf = (
        np.array([float(row[key]) for row in rows]) for key in ("thetai", "phi", "thetar", "phir", "f_r11")
    )
    phi = np.deg2rad(np.where(incident < 0, 180 - azimuth, azimuth - turned))
    phi = np.arccos(np.cos(phi))  # 0 to pi
    return Directions(np.deg2rad(np.abs(incident)), np.deg2rad(emergent), phi), np.pi * brdf


def linear_table(known: Directions, brf: FloatArray) -> Predictor:
    """The paper's table of readings in planes: linear in zenith along each plane, then linear in the three axes."""
    theta_i, theta_o, phi = (np.rad2deg(a) for a in (known.incident_rad, known.emergent_rad, known.phi_rad))
    incidences = np.unique(np.round(theta_i, 1))
    planes, zeniths = np.array([0.0, 45.0, 90.0, 135.0, 180.0]), np.arange(0.0, 85.0, 5.0)
    table = np.zeros((len(zeniths), len(planes), len(incidences)))
    for k, incidence in enumerate(incidences):
        at = np.abs(theta_i - incidence) < 0.1
        for p, plane in enumerate(planes):
            ahead = at & ((np.abs(phi - plane) < 0.6) | (theta_o < 0.1))
            behind = at & (np.abs(phi - (180 - plane)) < 0.6) & (theta_o >= 0.1)
            line = np.concatenate([-theta_o[behind], theta_o[ahead]])
            order = np.argsort(line)
            table[:, p, k] = np.interp(zeniths, line[order], np.concatenate([brf[behind], brf[ahead]])[order])
    grid = Grid(np.cos(np.deg2rad(zeniths))[::-1], np.deg2rad(planes), np.cos(np.deg2rad(incidences))[::-1])
    values = np.ascontiguousarray(table[::-1, :, ::-1])
    return lambda d: interpolate(grid, values, np.cos(d.emergent_rad), d.phi_rad, np.cos(d.incident_rad))


def models(known: Directions, brf: FloatArray) -> dict[str, Predictor]:
    """Every model, made from the same readings."""
    fit = fit_torrance_sparrow(known, brf)
    return {
        "linear table": linear_table(known, brf),
        "smooth fit": lambda d: smooth(known, brf, d),
        "Torrance-Sparrow": lambda d: np.pi * fit.model.brdf(np.cos(d.emergent_rad), d.phi_rad, np.cos(d.incident_rad)),
    }


def rms(predictor: Predictor, directions: Directions, brf: FloatArray) -> float:
    """Relative root mean square error in per cent."""
    return 100 * float(np.sqrt(np.mean((predictor(directions) / brf - 1) ** 2)))


def ptfe(folder: Path) -> None:
    """Held-out errors on the PTFE data, with the incidence of 75 degrees seen and not seen."""
    grid, brf = read_ptfe(folder / "PTFE.data.csv", 0.532)
    scattered, scattered_brf = read_ptfe(folder / "PTFE.data.random.csv", 0.532)
    azimuth = np.rad2deg(grid.phi_rad)
    planar = (np.abs(azimuth[:, None] - [0, 45, 90, 135, 180]).min(axis=1) < 0.6) | (grid.emergent_rad < 1e-3)
    below = np.rad2deg(grid.incident_rad) < 61
    print("white PTFE, 532 nm: relative rms error in per cent")
    print(f"{'model':18s} {'seen':>12s} {'readings':>9s} {'rest of grid':>13s} {'75 degrees':>11s} {'random':>7s}")
    for label, seen in (("0 to 75", planar), ("0 to 60", planar & below)):
        for name, predictor in models(grid.take(seen), brf[seen]).items():
            rest = ~planar & (below | (label == "0 to 75"))
            beyond = "-" if label == "0 to 75" else f"{rms(predictor, grid.take(~below), brf[~below]):.2f}"
            print(
                f"{name:18s} {label:>12s} {int(seen.sum()):9d} {rms(predictor, grid.take(rest), brf[rest]):13.2f}"
                f" {beyond:>11s} {rms(predictor, scattered, scattered_brf):7.2f}"
            )


def coupon(path: Path) -> None:
    """Left-out and held-out errors on a coupon run."""
    run = read_run(path)
    print(f"\ncoupon {path.name}: relative rms error in per cent")
    for readings in coupon_readings(run, str(path)).values():
        layout = lay_out(readings.theta_i, readings.theta_o, readings.phi, str(path))
        linear, fitted = (100 * float(np.sqrt(np.mean(e**2))) for e in left_out_errors([readings], [layout]))
        fit = fit_torrance_sparrow(readings.directions(), readings.brf)
        print(f"one reading left out: linear {linear:.2f}, smooth {fitted:.2f}")
        print(f"Torrance-Sparrow, residuals of the fit: {100 * fit.rms:.2f} ({fit.model})")
    for method in ("linear", "filled"):
        errors = {rule: round(100 * error, 2) for rule, error in fill_errors(run, str(path), method).items()}
        print(f"filled by {'the paper' if method == 'linear' else 'the smooth fit'}: {errors}")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--shared", type=Path, default=Path(__file__).resolve().parents[2] / "shared")
    shared = parser.parse_args().shared
    if not (shared / "data" / "nist_ptfe").is_dir():
        raise SystemExit(f"{shared}: no data/nist_ptfe there; name the folder with --shared")
    ptfe(shared / "data" / "nist_ptfe")
    coupon(shared / "cases" / "common" / "material.nc")


if __name__ == "__main__":
    main()
