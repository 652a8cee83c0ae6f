from __future__ import annotations

import json
import os
from dataclasses import dataclass
from pathlib import Path

import pytest

FACTORY = "fake_twin:FakeTwin.from_files"


@dataclass(frozen=True)
class FakeFiles:
    """Stand-ins for the twin's three files; ``material`` holds the fake twin's orders."""

    facility: Path
    artifact: Path
    material: Path

    def order(self, **orders) -> None:
        self.material.write_text(json.dumps(orders))

    def let_answer(self, requests: int) -> dict[str, str]:
        """The order to answer that many requests, lost ones included, and to hold the next."""
        held, new = self.material.with_suffix(".answers"), self.material.with_suffix(".new")
        new.write_text(str(requests))
        new.replace(held)
        return {"answers": str(held)}

    @property
    def requests(self) -> list[dict]:
        log = self.material.with_suffix(".log")
        return [json.loads(line) for line in log.read_text().splitlines()] if log.exists() else []


@pytest.fixture
def fake_files(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> FakeFiles:
    """Files of a fake twin, which a worker process can import as ``fake_twin``."""
    inherited = os.environ.get("PYTHONPATH")
    here = str(Path(__file__).parent)
    monkeypatch.setenv("PYTHONPATH", here + (os.pathsep + inherited if inherited else ""))
    files = FakeFiles(tmp_path / "facility.toml", tmp_path / "artifact.toml", tmp_path / "material.json")
    files.order()
    return files
