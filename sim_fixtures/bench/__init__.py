"""One physical state behind all simulated devices: arms, light, sample and detector, with a clock of its own."""

from __future__ import annotations

from sim_fixtures.bench.bench import AXES, Bench, MonitorBench
from sim_fixtures.bench.clock import BenchClock, ManualClock
from sim_fixtures.bench.flux import FluxFunction, lambertian_flux

__all__ = ["AXES", "Bench", "BenchClock", "FluxFunction", "ManualClock", "MonitorBench", "lambertian_flux"]
