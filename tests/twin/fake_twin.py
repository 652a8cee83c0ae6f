"""A twin without ray tracing for the tests of process plumbing: its answers are known and it misbehaves on demand.

The material file holds its orders as JSON: ``delay_s`` a request, ``die_at`` a sensor zenith at which the process
aborts, ``die_times`` how often it does, ``print`` noise on standard output, ``broken`` an input error,
``answers`` a file with the number of requests, lost ones included, after which it waits before it answers,
``wait_for`` a file without which no uncertainty is told, ``no_uncertainty`` why it is not told at all,
``raise_at`` a sensor zenith at which it raises, ``refuse_at`` one that is bad input, ``hang_at`` one at which it
never answers.
"""

from __future__ import annotations

import json
import os
import time
from pathlib import Path
from types import SimpleNamespace

import numpy as np

from instrument.errors import InputError


def expected_brf(geometry) -> float:
    return 0.4 + 0.001 * geometry.sensor_zenith + 1e-5 * geometry.sensor_azimuth


def expected_u(geometry) -> float:
    return 0.003 + 1e-5 * geometry.sensor_zenith


class FakeTwin:
    @classmethod
    def from_files(cls, facility: Path, artifact: Path, material: Path) -> FakeTwin:
        return cls(json.loads(material.read_text()), material)

    def __init__(self, orders: dict, material: Path) -> None:
        self.orders = orders
        self.deaths = material.with_suffix(".deaths")
        self.log = material.with_suffix(".log")
        if "broken" in orders:
            raise InputError(orders["broken"])
        if orders.get("slow_start_s"):
            time.sleep(orders["slow_start_s"])

    def predict(self, geometries, *, standard_error=0.001, samples=None, seed=None) -> FakeDataset:
        zeniths = [geometry.sensor_zenith for geometry in geometries]
        with self.log.open("a") as log:
            asked = {"zeniths": zeniths, "standard_error": standard_error, "samples": samples, "seed": seed}
            log.write(json.dumps(asked) + "\n")
        if self.orders.get("print"):
            os.write(1, b"printed by a native library\n")
            print("printed by Python", flush=True)
        if self.orders.get("die_at") in zeniths:
            died = len(self.deaths.read_text()) if self.deaths.exists() else 0
            if died < self.orders.get("die_times", 1_000_000):
                self.deaths.write_text("x" * (died + 1))
                os.write(2, b"LLVM ERROR: out of luck\n")
                os.abort()
        if self.orders.get("raise_at") in zeniths:
            raise ZeroDivisionError("no samples")
        if self.orders.get("refuse_at") in zeniths:
            raise InputError(f"sensor zenith {self.orders['refuse_at']:g}: not with this material")
        if self.orders.get("hang_at") in zeniths:
            time.sleep(1000)
        while "answers" in self.orders and self.asked() > int(Path(self.orders["answers"]).read_text()):
            time.sleep(0.01)
        time.sleep(self.orders.get("delay_s", 0.0))
        values = np.array([expected_brf(geometry) for geometry in geometries])
        u = standard_error * values
        attributes = {
            "u_brf_contains": "the ray tracer's standard error alone",
            "seed": np.int64(seed or 0),
            "nice": os.nice(0) if hasattr(os, "nice") else 0,
            "pid": os.getpid(),
        }
        return FakeDataset({"brf": values, "u_brf": u, "u_brf_monte_carlo": u}, attributes)

    def asked(self) -> int:
        return len(self.log.read_text().splitlines())

    def uncertainty(self, geometries) -> SimpleNamespace:
        while self.orders.get("wait_for") and not Path(self.orders["wait_for"]).exists():
            time.sleep(0.01)
        if self.orders.get("no_uncertainty"):
            raise InputError(self.orders["no_uncertainty"])
        u = np.array([expected_u(geometry) for geometry in geometries])
        return SimpleNamespace(u=u, contains="7 uncertain inputs and the ray tracer's standard error", notes=("a", "b"))


class FakeDataset:
    """As much of an xarray.Dataset as the process looks at; importing the real one would double every start."""

    def __init__(self, columns: dict[str, np.ndarray], attrs: dict) -> None:
        self.columns, self.attrs = columns, attrs

    def __getitem__(self, name: str) -> SimpleNamespace:
        return SimpleNamespace(values=self.columns[name])
