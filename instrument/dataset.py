"""Run files and predictions: reading, checking, building, writing (data contract, sections Run file, Prediction)."""

from __future__ import annotations

from instrument.run_build import build_run, rebuild_run, run_of_journal
from instrument.run_check import component_names
from instrument.run_read import capabilities, read_prediction, read_run
from instrument.run_write import write_prediction, write_run

__all__ = [
    "build_run",
    "capabilities",
    "component_names",
    "read_prediction",
    "read_run",
    "rebuild_run",
    "run_of_journal",
    "write_prediction",
    "write_run",
]
