"""Plates poured into one topology are the plates that are built from scratch."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, reject, settings
from hypothesis import strategies as st
from traced_samples import artifact, columns, facility, flat

from instrument.artifact import ArtifactDimensions, read_artifact
from instrument.errors import InputError
from twin.artifact import Surface, build_mesh
from twin.llvm import import_mitsuba
from twin.material import lambertian
from twin.mould import Mould
from twin.optics import lay_out
from twin.surface_mesh import SurfaceMesh
from twin.tracer import Part, Tracer, mean_and_error

EXAMPLE = Path(__file__).resolve().parents[2] / "sim_fixtures" / "examples" / "artifact.toml"
REAL = facility(profile="gaussian", mirror=10.8)
PLAN = columns([0, 15, 30, 30, 15], [40.0, -65, 80, -30, 5], [45.0, 50, 60, 120, 75])


def moved(dimensions: ArtifactDimensions, seed: int, times: float = 1.0) -> ArtifactDimensions:
    """Every hole a little elsewhere and of another diameter, by its uncertainty."""
    random, holes = np.random.default_rng(seed), dimensions.holes
    return replace(
        dimensions,
        holes=replace(
            holes,
            x=holes.x + random.normal(0, times * holes.u_x),
            y=holes.y + random.normal(0, times * holes.u_y),
            diameter=holes.diameter + random.normal(0, times * holes.u_diameter),
        ),
    )


def areas(mesh: SurfaceMesh) -> dict[Surface, float]:
    return {surface: float(mesh.areas()[mesh.labels == surface].sum()) for surface in Surface}


def assert_same_solid(poured: SurfaceMesh, built: SurfaceMesh) -> None:
    assert poured.open_edges() == 0
    assert poured.volume() == pytest.approx(built.volume(), rel=1e-12)
    # Where a hole crosses the spacer's edge the corners of its polygon are spaced a little differently.
    for surface, area in areas(built).items():
        assert areas(poured)[surface] == pytest.approx(area, rel=1e-5, abs=1e-3)
    np.testing.assert_allclose(poured.vertices.min(axis=0), built.vertices.min(axis=0))
    np.testing.assert_allclose(poured.vertices.max(axis=0), built.vertices.max(axis=0))


def test_the_measured_artifact_moves_within_its_topology() -> None:
    dimensions = read_artifact(EXAMPLE)
    mould = Mould(dimensions)
    for seed in range(4):
        other = moved(dimensions, seed)
        mesh = mould.mesh(other)
        assert_same_solid(mesh, build_mesh(other))
        assert mesh.plate is not None
        np.testing.assert_allclose(mesh.plate.centre[:, 0], other.holes.x)
    assert mould.made == 1


CHANGES: list[dict[str, float]] = [
    {"hole_diameter": 0.05},
    {"hole_diameter": -0.05},
    {"plate_thickness": 0.1},
    {"cavity_depth": -0.2},
    {"block_tilt_x": 0.5, "block_tilt_y": -1.0},
]


@pytest.mark.parametrize("change", CHANGES, ids=",".join)
@pytest.mark.parametrize("spacer", [4.0, 0.0], ids=["closed", "open"])
def test_dimensions_of_plate_and_block_move_too(change: dict[str, float], spacer: float) -> None:
    dimensions = artifact([(0.0, 0.0, 3.0), (4.0, 1.0, 2.0), (20.3, 3.0, 1.9)], spacer=spacer)
    mould = Mould(dimensions)
    other = dimensions.changed(**change)
    assert_same_solid(mould.mesh(other), build_mesh(other))
    assert mould.made == 1


def test_a_chamfer_changes_its_width_in_the_mould_and_begins_a_new_one() -> None:
    plain = artifact([(0.0, 0.0, 3.0), (4.0, 1.0, 2.0)])
    mould = Mould(plain)
    for width, made in ((0.1, 2), (0.2, 2), (0.05, 2), (0.0, 3)):
        other = plain.changed(edge_chamfer=width)
        assert_same_solid(mould.mesh(other), build_mesh(other))
        assert mould.made == made


def test_a_hole_that_comes_to_cross_the_spacer_needs_other_triangles() -> None:
    mould = Mould(artifact([(0.0, 0.0, 3.0), (19.9, 3.0, 2.0)]))
    other = artifact([(0.0, 0.0, 3.0), (20.1, 3.0, 2.0)])
    assert_same_solid(mould.mesh(other), build_mesh(other))
    assert mould.made == 2


def test_holes_that_leave_their_cells_need_other_triangles() -> None:
    mould = Mould(artifact([(-3.0, 0.0, 2.0), (3.0, 0.0, 2.0)]))
    other = artifact([(2.0, 0.0, 2.0), (8.0, 0.0, 2.0)])
    assert_same_solid(mould.mesh(other), build_mesh(other))
    assert mould.made == 2


def test_a_mould_refuses_what_is_no_solid() -> None:
    mould = Mould(artifact([(0.0, 0.0, 3.0), (4.0, 0.0, 2.0)]))
    with pytest.raises(InputError, match="holes 0 and 1 overlap"):
        mould.mesh(artifact([(0.0, 0.0, 3.0), (2.0, 0.0, 2.0)]))


def test_a_flat_sample_has_no_topology_to_keep() -> None:
    assert Mould(flat()).mesh(flat()).volume() == pytest.approx(2500 * 5.0)


def test_a_hole_that_grazes_the_edge_of_the_cavity_leaves_it_closed() -> None:
    # The circle reaches over the edge by a hundredth of its radius: less than a polygon's side bulges.
    edge = 25.0 - 10.5
    grazing = artifact([(-edge - 2.97, 5.7, 6.0), (3.0, 0.0, 4.0)], spacer=10.5)
    mesh = build_mesh(grazing, 24)
    assert mesh.open_edges() == 0
    assert_same_solid(Mould(grazing, 24).mesh(grazing), mesh)


def test_a_rim_through_a_corner_of_the_cavity_is_refused() -> None:
    corner = 25.0 - 7.5567143200688776
    rim = artifact([(-15.864194051801515, -16.569504004010813, 2 * 1.7934366860005317)], spacer=25.0 - corner)
    with pytest.raises(InputError, match="corner of the cavity"):
        build_mesh(rim, 24)


@settings(max_examples=20, deadline=None)
@given(
    seed=st.integers(0, 2**31),
    spacer=st.floats(0.5, 12.0),
    chamfer=st.sampled_from([0.0, 0.1]),
    step=st.floats(0.001, 0.2),
)
def test_any_layout_poured_is_the_same_solid(seed: int, spacer: float, chamfer: float, step: float) -> None:
    random = np.random.default_rng(seed)
    grid = (np.arange(4) - 1.5) * 11.0
    x, y = (a.ravel() + random.uniform(-1, 1, 16) for a in np.meshgrid(grid, grid))
    first = artifact(list(zip(x, y, random.uniform(1.0, 6.0, 16), strict=True)), spacer=spacer)
    first = first.changed(edge_chamfer=chamfer)
    holes = first.holes
    other = replace(first, holes=replace(holes, x=holes.x + random.uniform(-step, step, 16)))
    try:
        mould = Mould(first, 24)
        poured, built = mould.mesh(other), build_mesh(other, 24)
    except InputError:  # a rim through a corner of the cavity: see the test above
        reject()
    assert poured.open_edges() == 0
    assert poured.volume() == pytest.approx(built.volume(), rel=1e-9)
    assert areas(poured)[Surface.PLATE_TOP] == pytest.approx(areas(built)[Surface.PLATE_TOP], rel=1e-9)


def parts(tracer: Tracer, seed: int, samples: int = 512) -> list[Any]:
    layout = lay_out(REAL, PLAN)
    prepared = tracer.prepare(layout, np.zeros(5, int))
    return [tracer.part(part, prepared, samples, seed=seed) for part in Part]


@pytest.mark.parametrize("quick", [False, True])
def test_a_tracer_that_goes_on_with_another_mesh_is_as_good_as_a_new_one(quick: bool) -> None:
    dimensions = artifact(diameter=2.6)
    mould = Mould(dimensions, 32)
    tracer = Tracer(mould.mesh(dimensions), lambertian(0.8), quick=quick)
    parts(tracer, seed=1)
    mesh = mould.mesh(dimensions.changed(hole_diameter=-0.1, cavity_depth=0.3))
    assert mould.made == 1
    tracer.move(mesh)
    top, once, scattered = parts(tracer, seed=1)
    new_top, new_once, new_scattered = parts(Tracer(mesh, lambertian(0.8)), seed=1)
    np.testing.assert_allclose(top, new_top, rtol=1e-12)
    np.testing.assert_allclose(once, new_once, rtol=2e-4)
    (value, error), (new, new_error) = mean_and_error(scattered), mean_and_error(new_scattered)
    assert np.all(np.abs(value - new) < 5 * np.hypot(error, new_error))
    assert np.all(np.hypot(error, new_error) < 0.2 * new)


def test_going_on_with_another_mesh_compiles_nothing() -> None:
    import_mitsuba()
    import drjit as dr

    dimensions = artifact()
    mould = Mould(dimensions, 16)
    parts(Tracer(mould.mesh(dimensions), lambertian(0.8)), seed=1, samples=64)
    tracer = Tracer(mould.mesh(dimensions), lambertian(0.8), quick=True)
    with dr.scoped_set_flag(dr.JitFlag.KernelHistory, True):
        dr.kernel_history_clear()
        tracer.move(mould.mesh(dimensions.changed(hole_diameter=0.01)))
        parts(tracer, seed=1, samples=64)
        kernels = dr.kernel_history([dr.KernelType.JIT])
    assert len(kernels) > 2
    assert all(kernel["cache_hit"] for kernel in kernels)


def test_a_tracer_of_a_plate_does_not_go_on_with_a_flat_sample() -> None:
    tracer = Tracer(build_mesh(artifact([(0.0, 0.0, 3.0)])), lambertian(0.8))
    with pytest.raises(ValueError, match="another kind of sample"):
        tracer.move(build_mesh(flat()))
