"""The peer's side of the benchmark: Eradiate's kernel on a scene handed over as arrays.

Runs in an environment of its own (``eradiate-mitsuba``, a fork of Mitsuba 3.7.1) and imports nothing of this project::

    python peer_eradiate.py SCENE.npz RESULT.npz

The scene holds ``vertices`` and ``faces`` of a closed mesh (mm), the table ``brdf(cos_o, phi, cos_i)`` with its first
azimuth repeated at 360 degrees, the geometries, and how to sample. The result holds radiances over those of a white
Lambertian surface at normal incidence on the axis, standard errors from independent pixels, and processor seconds.
"""

from __future__ import annotations

import resource
import sys
import time
from typing import Any

started = time.perf_counter(), time.process_time()

import drjit as dr  # noqa: E402
import mitsuba as mi  # noqa: E402
import numpy as np  # noqa: E402

mi.set_variant("llvm_ad_rgb")
imported = time.perf_counter(), time.process_time()

#: Pixels of the film: independent estimates of the same radiance, whose scatter is its standard error.
PIXELS = 256
#: Texels across the image of the round beam; symmetric and of the right area to 1e-4.
TEXELS = 2048
#: How far along the view the sight lines begin, mm: above the whole sample for every view used here.
LIFT = 60.0
#: Where :class:`TableBSDF` finds its values: the kernel hands no tensors to plugins written in Python.
TABLES: list[Any] = []


class TableBSDF(mi.BSDF):  # type: ignore[misc]
    """The kernel's ``mqdiffuse`` with the azimuth difference wrapped to 0..360 degrees where it samples, too."""

    def __init__(self, props: Any) -> None:
        super().__init__(props)
        self.table = mi.Texture3f(TABLES[-1], False, False, dr.FilterMode.Linear, dr.WrapMode.Clamp)
        self.size = [float(n) for n in reversed(TABLES[-1].shape[:3])]
        self.m_flags = mi.BSDFFlags.DiffuseReflection | mi.BSDFFlags.FrontSide
        self.m_components = [self.m_flags]

    def brdf(self, wi: Any, wo: Any, active: Any) -> Any:
        turned = (dr.atan2(wo.y, wo.x) - dr.atan2(wi.y, wi.x)) / dr.two_pi
        place = mi.Point3f(wo.z, turned - dr.floor(turned), wi.z)
        pixel = mi.Point3f(*(1 / n for n in self.size))
        return self.table.eval(place * (1 - pixel) + 0.5 * pixel, active)[0]

    def sample(self, ctx: Any, si: Any, sample1: Any, sample2: Any, active: Any = True) -> Any:
        bs = mi.BSDFSample3f()
        bs.wo = mi.warp.square_to_cosine_hemisphere(sample2)
        bs.pdf = mi.warp.square_to_cosine_hemisphere_pdf(bs.wo)
        bs.eta = 1.0
        bs.sampled_type = mi.UInt32(+mi.BSDFFlags.DiffuseReflection)
        bs.sampled_component = mi.UInt32(0)
        active &= (si.wi.z > 0) & (bs.pdf > 0)
        weight = dr.pi * self.brdf(si.wi, bs.wo, active)
        return bs, mi.Color3f(dr.select(active, weight, 0))

    def eval(self, ctx: Any, si: Any, wo: Any, active: Any = True) -> Any:
        active &= (si.wi.z > 0) & (wo.z > 0)
        return mi.Color3f(dr.select(active, self.brdf(si.wi, wo, active) * wo.z, 0))

    def pdf(self, ctx: Any, si: Any, wo: Any, active: Any = True) -> Any:
        return dr.select((si.wi.z > 0) & (wo.z > 0), mi.warp.square_to_cosine_hemisphere_pdf(wo), 0)

    def eval_pdf(self, ctx: Any, si: Any, wo: Any, active: Any = True) -> Any:
        return self.eval(ctx, si, wo, active), self.pdf(ctx, si, wo, active)

    def to_string(self) -> str:
        return "TableBSDF[]"


def direction(zenith: float, azimuth: float) -> np.ndarray:
    z, a = np.deg2rad([zenith, azimuth])
    return np.array([np.sin(z) * np.cos(a), np.sin(z) * np.sin(a), np.cos(z)])


def look_at(origin: np.ndarray, target: np.ndarray) -> Any:
    axis = target - origin
    up = [0.0, 1.0, 0.0] if abs(axis[1]) < 0.9 * np.linalg.norm(axis) else [1.0, 0.0, 0.0]
    return mi.ScalarTransform4f().look_at(origin=origin.tolist(), target=target.tolist(), up=up)


def round_beam(radius: float, distance: float, zenith: float) -> dict[str, Any]:
    """A point source that lights a disc uniformly: the image of a disc, because a narrow spot is inexact here."""
    centre = np.arange(TEXELS) + 0.5 - TEXELS / 2
    width = 2.2 * radius  # of the whole image on the sample
    inside = np.hypot(*np.meshgrid(centre, centre)) * width / TEXELS <= radius
    image = np.repeat(inside[:, :, None].astype(np.float32), 3, axis=2)
    texture = {"type": "bitmap", "bitmap": mi.Bitmap(image), "raw": True, "filter_type": "nearest"}
    return {
        "type": "projector",
        "irradiance": texture,
        "scale": float(distance**2 / np.pi),  # the plugin multiplies by pi
        "fov": float(np.rad2deg(2 * np.arctan(width / 2 / distance))),
        "to_world": look_at(distance * direction(zenith, 0.0), np.zeros(3)),
    }


def sensor(view: np.ndarray, radius: float) -> dict[str, Any]:
    """Parallel rays over a disc normal to the view."""
    lifted = LIFT * view
    disc = {"type": "disk", "to_world": look_at(lifted, 2 * lifted) @ mi.ScalarTransform4f().scale(radius)}
    return {"type": "distant", "direction": (-view).tolist(), "target": disc}


def film(width: int) -> dict[str, Any]:
    layout = {"width": width, "height": 1, "pixel_format": "luminance", "component_format": "float32"}
    return {"type": "hdrfilm", "rfilter": {"type": "box"}} | layout


def camera(views: list[np.ndarray], radius: float) -> Any:
    """One sensor a view; several are rendered side by side in one launch."""
    common = {"sampler": {"type": "independent"}, "film": film(PIXELS * len(views))}
    if len(views) == 1:
        return mi.load_dict(sensor(views[0], radius) | common)
    members = {f"view{number}": sensor(view, radius) | {"film": film(1)} for number, view in enumerate(views)}
    return mi.load_dict({"type": "batch"} | members | common)


def solid(vertices: np.ndarray, faces: np.ndarray, bsdf: Any) -> Any:
    props = mi.Properties()
    props["bsdf"] = bsdf
    mesh = mi.Mesh("sample", len(vertices), len(faces), props=props, has_vertex_normals=False)
    parameters = mi.traverse(mesh)
    parameters["vertex_positions"] = vertices.astype(np.float32).ravel()
    parameters["faces"] = faces.astype(np.uint32).ravel()
    parameters.update()
    return mesh


def main(scene_file: str, result_file: str) -> None:
    scene_data = np.load(scene_file)
    TABLES.append(mi.TensorXf(scene_data["brdf"].astype(np.float32)[..., None]))
    mi.register_bsdf("table", TableBSDF)
    native = bool(scene_data["native"])
    grid = mi.VolumeGrid(scene_data["brdf"].astype(np.float32))
    bsdf = mi.load_dict({"type": "mqdiffuse", "grid": grid} if native else {"type": "table"})
    mesh = solid(scene_data["vertices"], scene_data["faces"], bsdf)
    samples, repeats = int(scene_data["samples"]), int(scene_data["repeats"])
    geometries = np.stack([scene_data[name] for name in ("illumination", "sensor_zenith", "sensor_azimuth")], axis=1)
    count = len(geometries)
    mean, error = np.zeros((repeats, count)), np.zeros((repeats, count))
    cpu, first_pass = np.zeros((repeats, count)), 0.0
    for illumination in np.unique(geometries[:, 0]):
        beam = round_beam(float(scene_data["beam_radius"]), float(scene_data["source_distance"]), illumination)
        integrator = {"type": "path", "max_depth": -1, "rr_depth": int(scene_data["rr_depth"])}
        scene = mi.load_dict({"type": "scene", "integrator": integrator, "sample": mesh, "beam": beam})
        rows = np.flatnonzero(geometries[:, 0] == illumination)
        for together in [rows] if bool(scene_data["one_launch"]) else rows[:, None]:
            views = [direction(*geometries[row, 1:]) for row in together]
            eye = camera(views, float(scene_data["target_radius"]))
            for repeat in range(-1, repeats):  # the first pass compiles
                before = time.process_time()
                seed = 1 + (repeat + 1) * count + int(together[0])
                image = mi.render(scene, sensor=eye, spp=max(1, samples // PIXELS), seed=seed)
                values = np.pi * np.array(image, dtype=float).reshape(len(views), PIXELS)
                spent = time.process_time() - before
                if repeat < 0:
                    first_pass += spent
                    continue
                cpu[repeat, together] = spent / len(views)
                mean[repeat, together] = values.mean(axis=1)
                error[repeat, together] = values.std(axis=1, ddof=1) / np.sqrt(PIXELS)
    np.savez(
        result_file, mean=mean, error=error, cpu=cpu, first_pass_cpu=first_pass, version=mi.__version__,
        import_s=imported[0] - started[0], import_cpu=imported[1] - started[1],
        peak_mb=resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024,
    )  # fmt: skip


if __name__ == "__main__":
    main(*sys.argv[1:])
