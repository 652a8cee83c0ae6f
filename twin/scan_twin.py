"""The twin of a scan, made from the files in its run folder."""

from __future__ import annotations

from pathlib import Path

from instrument.request import CORRECTIONS_NAME
from twin.prediction import Twin


def scan_twin(facility: Path, artifact: Path, material: Path) -> Twin:
    """The nominal twin, or the corrected one where a corrections file lies beside the artifact."""
    corrections = artifact.parent / CORRECTIONS_NAME
    if not corrections.exists():
        return Twin.from_files(facility, artifact, material)
    from twin.corrections import corrected_twin

    return corrected_twin(facility, artifact, material, corrections, ordered=False)
