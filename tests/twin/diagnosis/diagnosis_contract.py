"""The data contract of ``diagnosis.json``: keys, types, ranges, and what they must have to do with each other."""

from __future__ import annotations

import math
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, Field

from twin.diagnosis.observation import Observation

Probability = Annotated[float, Field(ge=0, le=1)]
NotNegative = Annotated[float, Field(ge=0)]

#: Parameters of every effect that the contract names; session_scale has one ratio for each illumination.
PARAMETERS = {
    "sample_tilt": {"x_deg", "y_deg"},
    **{key: {"angle_deg"} for key in ("sample_azimuth", "illumination_zenith_offset", "sensor_zenith_offset")},
    **{key: {"angle_deg"} for key in ("sensor_azimuth_offset", "backlash", "beam_divergence")},
    "sample_height": {"height_mm"},
    **{key: {"x_mm", "y_mm"} for key in ("sample_offset", "beam_offset")},
    "sensor_arm_runout": {"offset_mm"},
    **{key: {"radius_mm"} for key in ("beam_radius", "field_of_view", "acceptance_angle")},
    "retroreflection": {"amplitude", "width_deg"},
    "specular_lobe": {"amplitude", "roughness"},
    "anisotropy": {"amplitude", "axis_deg"},
    "translucency": {"length_mm", "fraction"},
    **{key: {"ratio"} for key in ("cavity_reflectance", "reflectance_scale", "reference_scale")},
    **{key: {"delta_mm"} for key in ("hole_diameter", "plate_thickness", "cavity_depth", "edge_chamfer")},
    **{key: {"fraction"} for key in ("stray_light", "gain_step", "stale_sample", "polarization", "arm_shadow")},
    **{key: {"fraction"} for key in ("detector_nonlinearity", "source_drift")},
    "dark_offset": {"voltage_v"},
}


class _Strict(BaseModel):
    model_config = ConfigDict(strict=True, allow_inf_nan=False)


class _Consistency(_Strict):
    consistent: bool
    p_value: Probability
    dark_uncertainty: NotNegative


class _Region(_Strict):
    points: list[int]
    description: Annotated[str, Field(min_length=10)]
    strength: NotNegative


class _Value(_Strict):
    value: float
    u: NotNegative


class _Ranked(_Strict):
    effect: str
    members: list[str] = Field(alias="class", min_length=1)
    probability: Probability


class _Effect(_Ranked):
    parameters: dict[str, _Value]


class _Gap(_Strict):
    rms_before: NotNegative
    rms_after: NotNegative
    heldout_rms_before: NotNegative
    heldout_rms_after: NotNegative
    shrink: Annotated[float, Field(le=1)]
    shrink_interval: Annotated[list[float], Field(min_length=2, max_length=2)]
    removable: Probability


class _Scan(_Strict):
    description: str
    separates: list[Annotated[list[str], Field(min_length=2, max_length=2)]]
    gain_nats: NotNegative
    duration_s: Annotated[float, Field(gt=0)]


class _Diagnosis(_Strict):
    consistency: _Consistency
    where: list[_Region]
    verdict: Literal["none", "effects", "unknown", "undecided"]
    effects: Annotated[list[_Effect], Field(max_length=2)]
    ranking: list[_Ranked]
    gap: _Gap
    next_scan: list[_Scan]


def check_contract(document: dict[str, Any], run: Observation, nominal: np.ndarray, corrected: np.ndarray) -> None:
    """Fail where a diagnosis is not what the contract says of it.

    Parameters
    ----------
    nominal, corrected, shape (point,)
        ``brf_nominal`` and ``brf_corrected`` of the prediction written with it.
    """
    found = _Diagnosis.model_validate(document)
    assert (found.verdict == "effects") == bool(found.effects)
    assert found.consistency.consistent == (found.consistency.p_value >= 0.05)
    for region in found.where:
        assert set(region.points) <= set(run.rows.tolist())
        assert region.points == sorted(set(region.points))
    for named in found.effects:
        _check_named(named)
        assert any(r.effect == named.effect and r.members == named.members for r in found.ranking)
    chances = [r.probability for r in found.ranking]
    assert chances == sorted(chances, reverse=True)
    assert all(r.effect in r.members for r in found.ranking)
    before, after = (np.sqrt(np.mean(((p - run.brf) / run.brf) ** 2)) for p in (nominal, corrected))
    assert math.isclose(found.gap.rms_before, before, rel_tol=1e-9)
    assert math.isclose(found.gap.rms_after, after, rel_tol=1e-9)
    assert found.gap.shrink_interval[0] <= found.gap.shrink_interval[1] <= 1
    _check_shrink(found.gap)
    for scan in found.next_scan:
        assert all(one != other for one, other in scan.separates)


def _check_named(named: _Effect) -> None:
    assert named.effect in named.members
    assert len(set(named.members)) == len(named.members) <= 5
    if named.effect in PARAMETERS:
        # More may be added to those of the contract.
        assert set(named.parameters) >= PARAMETERS[named.effect]
    elif named.effect == "session_scale":
        assert named.parameters
        assert all(name.startswith("ratio") for name in named.parameters)


def _check_shrink(gap: _Gap) -> None:
    """With the mean square that noise and budget leave, from ``removable``."""
    variance = (gap.heldout_rms_before * (1 - gap.removable)) ** 2
    was, left = (max(0.0, rms**2 - variance) for rms in (gap.heldout_rms_before, gap.heldout_rms_after))
    expected = 1 - math.sqrt(left / was) if was > 1e-12 else 0.0
    assert math.isclose(gap.shrink, expected, abs_tol=1e-6)
