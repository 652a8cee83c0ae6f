"""``goniotwin diagnose`` from end to end: a small plate, some effects, rendered; then all kinds of wrong input."""

from __future__ import annotations

import json
import re
import shutil
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from itertools import product
from pathlib import Path

import numpy as np
import pytest
import xarray as xr
from diagnosis_contract import check_contract

from gui.diagnosis_words import next_plan_of
from instrument.__main__ import main
from instrument.dataset import write_run
from instrument.facility import Arms, read_facility
from instrument.lambertian import lambertian_flux
from instrument.plan import read_plan
from twin.content import content_digest
from twin.corrections import Correction, Corrections, corrected_twin, write_corrections
from twin.diagnosis import command, followup, next_scans, responses
from twin.diagnosis.effects import effect
from twin.diagnosis.observation import Observation, read_observation
from twin.diagnosis.workbench import Workbench
from twin.prediction import Twin

EXAMPLES = Path(__file__).parents[3] / "sim_fixtures" / "examples"
#: Few and cheap to render; one that the minimal file cannot show.
EFFECTS = ("sensor_zenith_offset", "backlash", "stray_light", "polarization", "source_drift", "reference_scale")
TRUE_DEG = 1.5
OTHERS = ("flat coupon", "white reference")
UNITS = {"wavelength": "nm"} | dict.fromkeys(
    ("illumination_zenith", "illumination_azimuth", "sensor_zenith", "sensor_azimuth"), "degree"
)
NOISE, STABILITY, REFERENCE = 0.004, 0.006, 0.005


@dataclass
class Result:
    exit_code: int
    output: str


@dataclass
class Laboratory:
    """Files of a twin, and a run in which the sensor's zenith is off."""

    folder: Path

    def files(self) -> list[object]:
        names = {"--facility": "facility.toml", "--artifact": "artifact.toml", "--material": "material.toml"}
        named = [word for option, name in names.items() for word in (option, self.folder / name)]
        return [*named, "--cache", self.folder / "cache"]

    def run(self) -> xr.Dataset:
        with xr.open_dataset(self.folder / "run.nc", engine="h5netcdf") as data:
            return data.load()


@pytest.fixture(scope="module")
def lab(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Laboratory]:
    folder = tmp_path_factory.mktemp("laboratory")
    shutil.copy(EXAMPLES / "facility.toml", folder)
    rows = [f"{n},{x},{y},2.55,0,0,0" for n, (x, y) in enumerate(product((-7.2, -3.6, 0, 3.6, 7.2), repeat=2))]
    (folder / "holes.csv").write_text("\n".join(["hole,x_mm,y_mm,diameter_mm,u_x_mm,u_y_mm,u_diameter_mm", *rows]))
    (folder / "artifact.toml").write_text(
        'holes = "holes.csv"\noutline = [30.0, 30.0]\nplate_thickness = 1.13\ncavity_depth = 3.26\n'
    )
    (folder / "material.toml").write_text('[default]\nmodel = "lambertian"\nreflectance = 0.6\n')
    write_run(_measured(folder), folder / "run.nc")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(responses, "library", lambda: {name: effect(name) for name in EFFECTS})
        yield Laboratory(folder)


def _measured(folder: Path) -> xr.Dataset:
    """What the ray tracer says with the arm off, with noise, one factor a slice, and an error of the reference."""
    zenith = np.arange(70.0, -71.0, -14.0)
    rows = [(500.0, 30.0, 0.0, z, azimuth) for azimuth in (0.0, 60.0, 120.0) for z in zenith]
    rows = [row for row in rows if not (row[4] == 0 and abs(row[3] - 30) < 5)]
    table = np.array(rows)
    coords = {name: ("point", table[:, k], {"units": unit}) for k, (name, unit) in enumerate(UNITS.items())}
    true = Correction(effect="sensor_zenith_offset", parameters={"angle_deg": TRUE_DEG})
    write_corrections(Corrections(form="corrections", version=1, effects=(true,)), folder / "truth.toml")
    files = (folder / name for name in ("facility.toml", "artifact.toml", "material.toml", "truth.toml"))
    right = corrected_twin(*files, seed=7).predict(xr.Dataset(coords=coords), standard_error=0.002)["brf"].values
    random = np.random.default_rng(11)
    slices = np.repeat(np.arange(3), [np.sum(table[:, 4] == a) for a in (0.0, 60.0, 120.0)])
    brf = right * np.exp(NOISE * random.standard_normal(len(right)) + STABILITY * random.standard_normal(3)[slices])
    u = {"noise": NOISE * brf, "stability": STABILITY * brf, "reference": REFERENCE * brf}
    data = {"brf": brf, "u_brf": np.sqrt(sum(np.square(v) for v in u.values()))}
    data |= {f"u_brf_{name}": value for name, value in u.items()}
    variables = {name: ("point", value, {"units": "1"}) for name, value in data.items()}
    variables["brf"][2]["unc_comps"] = [f"u_brf_{name}" for name in u]
    time = np.datetime64("2026-01-01") + np.arange(len(brf)) * np.timedelta64(22, "s")
    return xr.Dataset(variables, coords | {"time": ("point", time.astype("datetime64[ns]"))})


@pytest.fixture
def call(lab: Laboratory, capsys: pytest.CaptureFixture[str]) -> Callable[..., Result]:
    """Run ``goniotwin diagnose`` as from a shell."""

    def run(*arguments: object) -> Result:
        status = 0
        try:
            status = main(["diagnose", *map(str, arguments)])
        except SystemExit as end:
            status = int(end.code or 0)
        return Result(status or 0, " ".join("".join(capsys.readouterr()).split()))

    return run


@pytest.fixture(scope="module")
def diagnosed(lab: Laboratory) -> dict[str, Path]:
    """Everything that one diagnosis writes."""
    out = {name: lab.folder / f"out.{name}" for name in ("json", "html", "nc", "toml")}
    options = ["--json", out["json"], "--report", out["html"], "--prediction", out["nc"], "--save-twin", out["toml"]]
    with pytest.raises(SystemExit, match="0"):
        main(["diagnose", str(lab.folder / "run.nc"), *map(str, [*lab.files(), *options])])
    return out


def test_what_is_written_keeps_the_contract_and_names_the_cause(lab: Laboratory, diagnosed: dict[str, Path]):
    found = json.loads(diagnosed["json"].read_text())
    with xr.open_dataset(diagnosed["nc"], engine="h5netcdf") as after:
        nominal, corrected = (after[f"brf_{which}"].values for which in ("nominal", "corrected"))
    check_contract(found, read_observation(lab.folder / "run.nc"), nominal, corrected)
    assert found["verdict"] == "effects"
    (named,) = found["effects"]
    assert "sensor_zenith_offset" in named["class"]
    if named["effect"] == "sensor_zenith_offset":
        value = named["parameters"]["angle_deg"]
        assert abs(value["value"] - TRUE_DEG) < 3 * value["u"]
    assert not found["consistency"]["consistent"]
    assert found["gap"]["shrink"] > 0.5
    inputs = found["made_with"]["inputs"]
    assert set(inputs) == {"run", "facility", "artifact", "material"}


def test_scan_in_the_opposite_direction_is_proposed_against_backlash(diagnosed: dict[str, Path]):
    found = json.loads(diagnosed["json"].read_text())
    assert {"sensor_zenith_offset", "backlash"} <= set(found["effects"][0]["class"])
    best = found["next_scan"][0]
    assert "opposite direction" in best["description"]
    assert {"sensor_zenith_offset", "backlash"} in [set(pair) for pair in best["separates"]]
    # Two explanations alike hold no more than ln 2, and others little.
    assert 0.3 < best["information_nats"] < 1.0
    rates = [scan["information_nats"] / scan["duration_s"] * 3600 for scan in found["next_scan"]]
    assert rates == sorted(rates, reverse=True)
    assert rates == pytest.approx([scan["information_per_hour"] for scan in found["next_scan"]])


def test_plan_of_the_proposal_is_what_the_program_plans(lab: Laboratory, diagnosed: dict[str, Path], tmp_path: Path):
    """The text that the window saves as a plan; ``goniotwin plan`` says the same duration of it."""
    scan = json.loads(diagnosed["json"].read_text())["next_scan"][0]
    assert next_plan_of({"next_scan": [scan]}) == scan["plan"]
    (tmp_path / "plan.toml").write_text(scan["plan"])
    words = ["plan", tmp_path / "plan.toml", "--facility", lab.folder / "facility.toml", "--json", tmp_path / "p.json"]
    with pytest.raises(SystemExit, match="0"):
        main([str(word) for word in words])
    summary = json.loads((tmp_path / "p.json").read_text())
    assert summary["duration_s"] == pytest.approx(scan["duration_s"])
    zenith = [point["sensor_zenith"] for point in summary["points"]]
    # The run went from + to -.
    assert zenith == sorted(zenith)
    assert not summary["blocked"]


def test_report_is_one_page_that_says_the_same(diagnosed: dict[str, Path]):
    page = diagnosed["html"].read_text()
    digest = json.loads(diagnosed["json"].read_text())["made_with"]["inputs"]["artifact"]["sha256"]
    for text in ("the cause is named", "sensor_zenith_offset", "backlash", "Next scan", "Made with", digest):
        assert text in page
    assert not re.search(r"(src|href)=.https?:", page)


@pytest.mark.slow
@pytest.mark.usefixtures("diagnosed")
def test_plans_of_other_scans_are_ready_to_run(lab: Laboratory, call, tmp_path: Path, monkeypatch):
    def one_plane(run: Observation, arms: Arms) -> dict[str, np.ndarray]:
        found = next_scans.other_geometries(run, arms)
        return {name: column[found["sensor_azimuth"] == found["sensor_azimuth"][0]] for name, column in found.items()}

    monkeypatch.setattr(followup, "other_geometries", one_plane)
    monkeypatch.setattr(followup, "_LEAST", -1.0)  # scans that say nothing of this cause are proposed as well
    folder, out = tmp_path / "plans", tmp_path / "d.json"
    result = call(lab.folder / "run.nc", *lab.files(), "--plans", folder, "--json", out)
    assert result.exit_code == 0, result.output
    proposed = json.loads(out.read_text())["next_scan"]
    files = sorted(folder.iterdir())
    assert [file.name for file in files] == [f"plan-{n}.toml" for n in range(1, len(proposed) + 1)]
    facility = read_facility(lab.folder / "facility.toml")
    known = set(lab.run()["sensor_azimuth"].values)
    new = False
    for scan, file in zip(proposed, files, strict=True):
        assert file.read_text().endswith(scan["plan"])
        plan = read_plan(file, facility)
        assert not plan.blocked
        new |= not {point.sensor_azimuth for point in plan.points} <= known
    assert new
    assert set(OTHERS) == {word for scan in proposed for word in OTHERS if word in scan["plan"]}
    rates = [scan["information_per_hour"] for scan in proposed]
    assert rates == sorted(rates, reverse=True)
    # What direction tells, no other plane tells as fast.
    assert re.search("opposite direction|back and forth", proposed[0]["description"])


@pytest.mark.slow
@pytest.mark.usefixtures("diagnosed")
def test_scan_of_the_white_reference_counts_with_the_run(lab: Laboratory, call, tmp_path: Path):
    """The arm that is off looks beside the lit part of the plate; nothing of the sample does that."""
    plate, facility = lab.run(), read_facility(lab.folder / "facility.toml")
    light, zenith, azimuth = (plate[n].values for n in ("illumination_zenith", "sensor_zenith", "sensor_azimuth"))
    seen = [lambertian_flux(facility, light, zenith + off, azimuth) for off in (TRUE_DEG, 0.0)]
    at = facility.reference
    scale = [lambertian_flux(facility, at.illumination_zenith, at.sensor_zenith + off, 0.0) for off in (TRUE_DEG, 0.0)]
    scatter = np.exp(NOISE * np.random.default_rng(3).standard_normal(len(zenith)))
    reading = 0.99 * seen[0] / seen[1] / (scale[0] / scale[1]) * scatter
    for name in plate.data_vars:
        plate[name] = plate[name] / lab.run()["brf"] * reading
    plate["brf"].attrs.update(lab.run()["brf"].attrs)
    write_run(plate, tmp_path / "white.nc")
    out = tmp_path / "d.json"
    result = call(lab.folder / "run.nc", *lab.files(), "--white", tmp_path / "white.nc", "--json", out)
    assert result.exit_code == 0, result.output
    found = json.loads(out.read_text())
    assert found["verdict"] == "effects", result.output
    assert {"sensor_zenith_offset", "backlash"} & set(found["effects"][0]["class"])
    # The sample in place of the plate is refused.
    wrong = call(lab.folder / "run.nc", *lab.files(), "--white", lab.folder / "run.nc")
    assert wrong.exit_code == 2
    assert "expected the white reference" in wrong.output


@pytest.mark.slow
def test_corrected_twin_serves_the_comparison(lab: Laboratory, diagnosed: dict[str, Path]):
    sizes = {}
    for name, words in {"nominal": [], "corrected": ["--corrections", diagnosed["toml"]]}.items():
        out = lab.folder / f"{name}.json"
        files = [*lab.files()[:-2], "--standard-error", "0.003", "--no-uncertainty", "--json", out, *words]
        with pytest.raises(SystemExit, match="0"):
            main(["compare", str(lab.folder / "run.nc"), *map(str, files)])
        sizes[name] = json.loads(out.read_text())["global"]["relative_rmse"]
    assert sizes["corrected"] < 0.5 * sizes["nominal"]


@pytest.fixture
def nothing_rendered(monkeypatch: pytest.MonkeyPatch) -> None:
    """Whatever would need a ray fails."""
    monkeypatch.setattr(Workbench, "render", None)
    monkeypatch.setattr(Twin, "predict", None)


@pytest.mark.slow
@pytest.mark.usefixtures("nothing_rendered", "diagnosed")
def test_part_of_a_plan_in_the_other_direction_needs_no_ray(lab: Laboratory, call, tmp_path: Path):
    run = lab.run()
    part = run.isel(point=np.flatnonzero(np.abs(run["sensor_zenith"].values) > 13)[::-1])
    part["time"] = ("point", np.sort(part["time"].values))
    write_run(part, tmp_path / "part.nc")
    result = call(tmp_path / "part.nc", *lab.files(), "--json", tmp_path / "d.json")
    assert result.exit_code == 0, result.output
    found = json.loads((tmp_path / "d.json").read_text())
    assert any("sensor_zenith_offset" in named["class"] for named in found["ranking"][:2])


@pytest.mark.usefixtures("nothing_rendered", "diagnosed")
def test_minimal_file_says_what_it_rules_out(lab: Laboratory, call, tmp_path: Path):
    run = lab.run()[["brf", "u_brf"]].drop_vars("time")
    run["brf"].attrs.pop("unc_comps", None)
    write_run(run, tmp_path / "least.nc")
    result = call(tmp_path / "least.nc", *lab.files(), "--json", tmp_path / "d.json")
    assert result.exit_code == 0, result.output
    found = json.loads((tmp_path / "d.json").read_text())
    assert "says nothing of progress" in found["ruled_out"]["source_drift"]
    assert "not looked for: source_drift" in result.output
    assert any("drift" in note for note in found["notes"])


@pytest.mark.usefixtures("nothing_rendered", "diagnosed")
def test_files_are_written_although_nobody_reads_the_words(lab: Laboratory, call, tmp_path: Path, monkeypatch):
    def hung_up(*_: object) -> None:
        raise BrokenPipeError

    monkeypatch.setattr(command, "_tell", hung_up)
    outputs = [tmp_path / name for name in ("d.json", "d.html", "d.nc", "d.toml")]
    options = [
        w for pair in zip(("--json", "--report", "--prediction", "--save-twin"), outputs, strict=True) for w in pair
    ]
    assert call(lab.folder / "run.nc", *lab.files(), *options).exit_code != 0
    assert all(path.stat().st_size > 0 for path in outputs)


def _few(run: xr.Dataset) -> xr.Dataset:
    return run.isel(point=slice(0, 12))


def _zero_uncertainty(run: xr.Dataset) -> xr.Dataset:
    return run.assign(u_brf=run["u_brf"].where(run["sensor_azimuth"] > 0, 0.0))


def _no_uncertainty(run: xr.Dataset) -> xr.Dataset:
    kept = run.drop_vars([name for name in run.variables if str(name).startswith("u_brf")])
    kept["brf"].attrs.pop("unc_comps", None)
    return kept


def _wrong_unit(run: xr.Dataset) -> xr.Dataset:
    run["brf"].attrs["units"] = "%"
    return run


def _per_cent(run: xr.Dataset) -> xr.Dataset:
    return run.assign({name: run[name] * 100 for name in run.data_vars})


def _brdf(run: xr.Dataset) -> xr.Dataset:
    return run.assign({name: run[name] / np.pi for name in run.data_vars})


def _radians(run: xr.Dataset) -> xr.Dataset:
    run["sensor_zenith"].attrs["units"] = "rad"
    return run


def _coupon(run: xr.Dataset) -> xr.Dataset:
    """The flat coupon, of reflectance 0.6."""
    flat = xr.full_like(run["brf"], 0.6)
    return run.assign({n: run[n] / run["brf"] * 0.6 for n in run.data_vars if n != "brf"}).assign(brf=flat)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (_few, "found 12 usable points; expected at least 20"),
        (_zero_uncertainty, "u_brf: found 0 at point 0; expected a standard uncertainty above 0"),
        (_no_uncertainty, "u_brf: missing"),
        (_wrong_unit, "brf: "),
        (_per_cent, "expected a reflectance factor near 1, not per cent"),
        (_brdf, "BRDF in 1/sr instead of a reflectance factor?"),
        (_radians, "sensor_zenith: "),
        (_coupon, "this looks like the material's coupon"),
    ],
)
@pytest.mark.usefixtures("nothing_rendered", "diagnosed")
def test_wrong_run_is_one_clear_message(lab: Laboratory, call, tmp_path: Path, change, said: str):
    change(lab.run()).to_netcdf(tmp_path / "wrong.nc", engine="h5netcdf")
    result = call(tmp_path / "wrong.nc", *lab.files())
    assert result.exit_code == 2
    assert said in result.output
    assert "wrong.nc" in result.output


def test_plans_need_a_folder_before_anything_is_worked_out(lab: Laboratory, call, tmp_path: Path):
    (tmp_path / "plans").write_text("")
    result = call(lab.folder / "no-run.nc", *lab.files(), "--plans", tmp_path / "plans")
    assert result.exit_code == 2
    assert "plans: is a file; expected a folder" in result.output


def test_sample_of_several_materials_is_refused_at_once(lab: Laboratory, call, tmp_path: Path):
    text = '[default]\nmodel = "lambertian"\nreflectance = 0.6\n[floor]\nmodel = "lambertian"\nreflectance = 0.5\n'
    (tmp_path / "two.toml").write_text(text)
    files = lab.files()
    files[files.index("--material") + 1] = tmp_path / "two.toml"
    result = call(lab.folder / "run.nc", *files)
    assert result.exit_code == 2
    assert "two.toml: found 2 materials" in result.output


def test_cache_tells_configurations_apart(lab: Laboratory, tmp_path: Path):
    """A chamfer of the table of holes alone makes another plate."""
    from instrument.artifact import read_artifact
    from twin.material import lambertian

    rows = (lab.folder / "holes.csv").read_text().splitlines()
    table = [rows[0] + ",chamfer_mm", *(row + ",0.1" for row in rows[1:])]
    (tmp_path / "holes.csv").write_text("\n".join(table))
    shutil.copy(lab.folder / "artifact.toml", tmp_path)
    bench = read_facility(lab.folder / "facility.toml")
    digests = {
        Workbench(bench, read_artifact(folder / "artifact.toml"), lambertian(0.6)).digest()
        for folder in (lab.folder, tmp_path)
    }
    assert len(digests) == 2
    assert content_digest(1) != content_digest(2)
