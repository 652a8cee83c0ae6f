"""Symmetries of a run: what breaks them is found with its size, what keeps them is not, and no twin is needed."""

from pathlib import Path

import numpy as np
import pytest

from instrument.column_mapping import read_mapped
from instrument.facility import read_facility
from instrument.plan import read_plan
from twin.diagnosis.observation import Observation, observe
from twin.diagnosis.parity import equal_pairs, parities, parity
from twin.optics import geometry_columns

SPECTRALON = Path(__file__).parents[4] / "shared/data/mastcamz_spectralon/20200313_mastcamz_spectralon.csv"
MAPPING = """
form = "column mapping"
version = 1
arm_on_other_side_above = 90
[columns]
wavelength = { column = "bandpass_central" }
illumination_zenith = { column = "incidence" }
illumination_azimuth = { column = "azimuth" }
sensor_zenith = { column = "emission" }
sensor_azimuth = { constant = 0.0 }
brf = { column = "reflectance_factor" }
u_brf_noise = { column = "standard_deviation", unit = "%", relative = true, least = 0.02 }
u_brf_stability = { constant = 0.2, unit = "%", relative = true }
[time]
column = "relative_time"
"""


def made(change=None, *, noise: float = 0.003, seed: int = 1, light=(0.0, 30.0)) -> Observation:
    """A run of a Lambertian sample, with a relative change of its readings by (view, illumination) in rad."""
    grid = [(i, a, z) for i in light for a in (0.0, 45.0, 90.0, 135.0) for z in np.arange(-75.0, 76.0, 15.0)]
    zenith_i, azimuth, zenith = np.array(grid).T
    count = len(zenith)
    brf = np.full(count, 0.5)
    if change is not None:
        brf = brf * (1 + change(np.deg2rad(zenith), np.deg2rad(azimuth), np.deg2rad(zenith_i)))
    brf = brf * (1 + noise * np.random.default_rng(seed).standard_normal(count))
    columns = {
        "wavelength": np.full(count, 500.0),
        "illumination_zenith": zenith_i,
        "illumination_azimuth": np.zeros(count),
        "sensor_zenith": zenith,
        "sensor_azimuth": azimuth,
    }
    components = {"noise": noise * brf, "stability": 0.002 * brf}
    return Observation("made", np.arange(count), columns, brf, np.hypot(noise, 0.002) * brf, components)


def test_a_tilt_is_found_with_its_axis_and_its_size():
    """cos of the view to a normal (y, -x, 1): exact, not the first order that the test uses."""
    tilt_x, tilt_y = np.deg2rad(0.8), 0.0

    def tilted(zenith, azimuth, light):
        view = np.stack([np.sin(zenith) * np.cos(azimuth), np.sin(zenith) * np.sin(azimuth), np.cos(zenith)])
        normal = np.array([tilt_y, -tilt_x, 1.0]) / np.sqrt(1 + tilt_x**2 + tilt_y**2)
        return normal @ view / np.cos(zenith) - 1

    found = parity(made(tilted))
    assert found.broken
    assert found.terms[0].name == "tilt about x"
    assert abs(found.terms[0].amplitude - 0.8) < 3 * found.terms[0].u + 0.01
    assert found.terms[0].explained > 0.8


@pytest.mark.parametrize(
    "change",
    [
        lambda z, a, i: 0.2 * np.cos(z) ** 2,
        lambda z, a, i: 0.01 / np.cos(z),
        lambda z, a, i: 0.3 * np.exp(-((np.abs(z) - 0.5) ** 2)) * (i + 1),
    ],
    ids=["limb", "stray light", "scale of an illumination"],
)
def test_what_keeps_the_symmetry_does_not_show(change):
    assert not parity(made(change)).broken


def test_sound_runs_are_rarely_called_broken():
    broken = sum(parity(made(seed=seed, noise=0.004)).broken for seed in range(20))
    assert broken <= 4  # 1 expected at the level of 5 %; 5 or more has a probability of 0.3 %


def test_a_failed_reading_is_left_out_and_said():
    run = made()
    run.brf[17] *= 0.6
    found = parity(run)
    assert 17 in found.drop_outs
    assert not found.broken
    assert "drop-outs" in found.in_words()[-1]


def test_pairs_of_an_isotropic_sample_join_all_azimuths_at_normal_incidence():
    run = made(light=(0.0,))
    directions = 11 * 4  # 5 zeniths twice each of 8 azimuths, and 4 times straight above
    distinct = 6  # zeniths 0 to 75
    assert len(equal_pairs(run, symmetry="isotropic")) == directions - distinct
    # The mirror alone leaves plane 0 as it is, folds plane 90 onto itself, and lays 45 on 135.
    straight_above, folded, laid = 3, 5, 10
    assert len(equal_pairs(run, symmetry="mirror")) == straight_above + folded + laid


def orbit(light: float, zenith: float, azimuth: float) -> tuple[float, ...]:
    """The same for directions that a square lattice makes equal: folded by hand, without a tree."""
    if zenith < 0:
        zenith, azimuth = -zenith, azimuth + 180
    if zenith == 0:
        return light, 0.0, 0.0
    azimuth = min(azimuth % 360, -azimuth % 360)
    if light == 0:
        azimuth = min(azimuth % 90, -azimuth % 90)
    return light, zenith, azimuth


@pytest.mark.parametrize(("plan", "points", "pairs"), [("table_iv", 390, 198), ("table_iii", 652, 300)])
def test_plans_of_the_paper_hold_so_many_pairs(plan: str, points: int, pairs: int):
    """Each orbit of n directions has n - 1 pairs that do not follow from each other."""
    examples = Path(__file__).parents[3] / "sim_fixtures" / "examples"
    where = geometry_columns(read_plan(examples / f"{plan}.toml", read_facility(examples / "facility.toml")).points)
    rows = zip(where["illumination_zenith"], where["sensor_zenith"], where["sensor_azimuth"], strict=True)
    distinct = len({orbit(*map(float, row)) for row in rows})
    run = Observation("plan", np.arange(points), where, np.ones(points), np.full(points, 0.01), {})
    assert len(equal_pairs(run)) == points - distinct == pairs


def test_a_run_without_equal_directions_says_so():
    run = made(light=(30.0,))
    rows = np.flatnonzero((run.columns["sensor_azimuth"] == 45) & (run.columns["sensor_zenith"] > 0))
    assert "nothing can be said" in parity(run.take(rows)).in_words()[0]


@pytest.mark.skipif(not SPECTRALON.exists(), reason="needs ../shared/data/mastcamz_spectralon")
class TestSpectralon:
    @pytest.fixture
    def mapping(self, tmp_path):
        file = tmp_path / "mapping.toml"
        file.write_text(MAPPING)
        return file

    def test_the_sine_of_the_azimuth_grows_as_the_tangent_of_the_incidence(self, mapping):
        """Straight above, at 550 nm: 0.07 % at 15 to 1.66 % at 70 degrees, as of a tilt of 0.2 to 0.4 degrees."""
        run = observe(read_mapped(SPECTRALON, mapping), "spectralon", foreign=True)
        (found,) = parities(run.take(np.flatnonzero(run.columns["wavelength"] == 550)))
        assert found.broken
        sizes = {n.illumination_zenith: 100 * abs(n.amplitude) for n in found.nadir}
        assert sizes[15] == pytest.approx(0.07, abs=0.01)
        assert sizes[70] == pytest.approx(1.66, abs=0.01)
        assert all(0.15 <= n.tilt_deg <= 0.42 for n in found.nadir)
        words = " ".join(found.in_words())
        assert "grows about as tan" in words
        assert "tilted by 0.2 to 0.4 degrees" in words
        assert "cannot confirm" in words
        assert "Left out as drop-outs" in words

    def test_the_command_works_without_a_twin(self, mapping, tmp_path, capsys):
        import json

        from instrument.__main__ import main

        out = tmp_path / "found.json"
        arguments = ["diagnose", str(SPECTRALON), "--columns", str(mapping), "--wavelength", "550", "--json", str(out)]
        with pytest.raises(SystemExit, match="0"):
            main(arguments)

        assert "tan(illumination zenith)" in capsys.readouterr().out
        (found,) = json.loads(out.read_text())["parity"]
        assert found["broken"]
