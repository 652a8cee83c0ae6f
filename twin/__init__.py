"""What should be measured, how sure that is, and how the two compare.

The names of ``__all__`` are the surface for programs of others (docs/library.md); each is loaded when it is first
asked for: the ray tracer only where something is predicted.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from instrument.surface import surface

if TYPE_CHECKING:
    from twin.comparison import Comparison, compare
    from twin.corrections import corrected_twin
    from twin.diagnosis.diagnose import Diagnosis, diagnose
    from twin.diagnosis.observation import Observation, read_observation
    from twin.diagnosis.preparation import Bench, Inputs
    from twin.material import Material, lambertian, read_material
    from twin.optics import Setup
    from twin.prediction import Twin
    from twin.propagation_dataset import propagate
    from twin.state_vector import StateVector, state_vector_from_files

#: Where each name lives.
_HOMES = {
    "comparison": ("Comparison", "compare"),
    "corrections": ("corrected_twin",),
    "diagnosis.diagnose": ("Diagnosis", "diagnose"),
    "diagnosis.observation": ("Observation", "read_observation"),
    "diagnosis.preparation": ("Bench", "Inputs"),
    "material": ("Material", "lambertian", "read_material"),
    "optics": ("Setup",),
    "prediction": ("Twin",),
    "propagation_dataset": ("propagate",),
    "state_vector": ("StateVector", "state_vector_from_files"),
}

__all__ = [
    "Bench",
    "Comparison",
    "Diagnosis",
    "Inputs",
    "Material",
    "Observation",
    "Setup",
    "StateVector",
    "Twin",
    "compare",
    "corrected_twin",
    "diagnose",
    "lambertian",
    "propagate",
    "read_material",
    "read_observation",
    "state_vector_from_files",
]

__getattr__, __dir__ = surface(globals(), _HOMES)
