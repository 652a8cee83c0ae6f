from __future__ import annotations

import sys
from pathlib import Path

import pytest
from report_samples import ARTIFACT, HOLES, pair

from instrument.run_write import write_prediction, write_run
from twin.report.build import build_report
from twin.report.document import Document
from twin.report.sources import Named, Sources, read_sources

sys.path.insert(0, str(Path(__file__).parents[2] / "instrument"))  # journals and run folders: example_runs


@pytest.fixture(scope="session")
def files(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """``run.nc``, ``prediction.nc``, ``artifact.toml`` with its holes and ``coupon.nc``; no test writes there."""
    folder = tmp_path_factory.mktemp("report-files")
    run, prediction = pair()
    write_run(run, folder / "run.nc")
    write_prediction(prediction, folder / "prediction.nc")
    coupon = run.assign(brf=run["brf"] + 0.001 * run["sensor_zenith"])
    coupon["brf"].attrs["units"] = "1"
    write_run(coupon, folder / "coupon.nc")
    (folder / "artifact.toml").write_text(ARTIFACT)
    (folder / "holes.csv").write_text(HOLES)
    return folder


@pytest.fixture(scope="session")
def sources(files: Path) -> Sources:
    return read_sources(
        Named(
            files / "run.nc",
            prediction=files / "prediction.nc",
            artifact=files / "artifact.toml",
            material=files / "coupon.nc",
        )
    )


@pytest.fixture(scope="session")
def document(sources: Sources) -> Document:
    return build_report(sources)
