"""Figures show the numbers of the comparison: read back from the drawn artists, not from pixels."""

from __future__ import annotations

import subprocess
import sys

import numpy as np
import pytest
import xarray as xr
from matplotlib.image import imread

from twin.comparison import Comparison, compare
from twin.figures import CATEGORY_STYLE, draw_overview, draw_plane, draw_planes, plane_name
from twin.metrics import Category


def comparison(azimuths=(0.0, 105.0), wavelengths=(500.0,)) -> Comparison:
    """A run whose t-score grows from one side to the other, with the retro-reflection point missing at azimuth 0."""
    rows = [
        (wavelength, 15.0, 0.0, zenith, azimuth)
        for wavelength in wavelengths
        for azimuth in azimuths
        for zenith in np.arange(80.0, -81.0, -5.0)
        if not (azimuth == 0 and zenith == 15)
    ]
    names = ("wavelength", "illumination_zenith", "illumination_azimuth", "sensor_zenith", "sensor_azimuth")
    table = np.array(rows)
    coords = {name: ("point", table[:, column]) for column, name in enumerate(names)}
    simulated = 0.4 + 0.1 * np.cos(np.deg2rad(2 * table[:, 3]))
    t = table[:, 3] / 80 * 3
    u = 0.01 * simulated
    measured = xr.Dataset({"brf": ("point", simulated - t * np.hypot(u, 0.002)), "u_brf": ("point", u)}, coords=coords)
    u_sim = ("point", np.full(len(rows), 0.002))
    predicted = xr.Dataset({"brf": ("point", simulated), "u_brf": u_sim, "u_brf_monte_carlo": u_sim}, coords=coords)
    return compare(measured, predicted)


def lines_of(axis, label):
    return next(line for line in axis.get_lines() if line.get_label() == label)


def test_simulated_line_and_measured_points_are_the_data():
    result = comparison()
    plane = result.planes[1]
    upper, _ = draw_plane(result.points, plane).axes[:2]
    rows = result.points.isel(point=list(plane.rows)).sortby("sensor_zenith")
    x, y = lines_of(upper, "simulated, $k$ = 1, 2").get_data()
    assert x.tolist() == rows["sensor_zenith"].values.tolist()
    assert y.tolist() == rows["simulated"].values.tolist()
    bars = upper.containers
    widths = [np.ptp(np.array(bar.lines[2][0].get_segments())[:, :, 1], axis=1) / 2 for bar in bars]
    assert widths[0] == pytest.approx(2 * rows["u_measured"].values)
    assert widths[1] == pytest.approx(rows["u_measured"].values)
    assert bars[1].lines[0].get_ydata().tolist() == rows["measured"].values.tolist()


def test_no_line_bridges_a_point_that_was_not_measured():
    result = comparison()
    upper = draw_plane(result.points, result.planes[0]).axes[0]
    x, y = lines_of(upper, "simulated, $k$ = 1, 2").get_data()
    gap = np.flatnonzero(np.isnan(x))
    assert gap.tolist() == np.flatnonzero(np.isnan(y)).tolist()
    assert [x[gap[0] - 1], x[gap[0] + 1]] == [10.0, 20.0]


def test_differences_are_drawn_in_per_cent_by_category_of_t():
    result = comparison()
    plane = result.planes[1]
    lower = draw_plane(result.points, plane).axes[1]
    rows = result.points.isel(point=list(plane.rows)).sortby("sensor_zenith")
    t = np.abs(rows["t"].values)
    expected = {Category.GOOD: t < 1, Category.ACCEPTABLE: (t >= 1) & (t <= 2), Category.POOR: t > 2}
    for category, chosen in expected.items():
        colour, marker, name = CATEGORY_STYLE[category]
        line = lines_of(lower, name)
        assert chosen.any()
        assert line.get_xdata().tolist() == rows["sensor_zenith"].values[chosen].tolist()
        assert line.get_ydata() == pytest.approx(100 * rows["relative_difference"].values[chosen])
        assert (line.get_color(), line.get_marker()) == (colour, marker)


def test_bands_are_one_and_two_combined_uncertainties_over_the_measured_value():
    result = comparison()
    plane = result.planes[1]
    lower = draw_plane(result.points, plane).axes[1]
    rows = result.points.isel(point=list(plane.rows))
    sigma = 100 * np.hypot(rows["u_simulated"], rows["u_measured"]) / rows["measured"]
    tops = [band.get_paths()[0].vertices[:, 1].max() for band in lower.collections[:2]]
    assert tops == pytest.approx([2 * float(sigma.max()), float(sigma.max())])


def test_categories_differ_in_shape_as_well_as_in_colour():
    colours, markers, _ = zip(*CATEGORY_STYLE.values(), strict=True)
    assert len(set(colours)) == len(set(markers)) == 3


def test_the_small_picture_shows_the_plane_and_the_light_from_above():
    result = comparison(azimuths=(0.0, 90.0))
    for plane, along, across in ((result.planes[0], 0, 1), (result.planes[1], 1, 0)):
        points, light = draw_plane(result.points, plane).axes[2].get_lines()
        zenith = result.points["sensor_zenith"].values[list(plane.rows)]
        assert points.get_data()[along] == pytest.approx(np.sort(zenith))
        assert points.get_data()[across] == pytest.approx(np.zeros(len(zenith)), abs=1e-12)
        assert [float(v[0]) for v in light.get_data()] == [15.0, 0.0]


def test_one_file_per_plane_and_format_and_an_overview(tmp_path):
    written = draw_planes(comparison(), tmp_path / "new" / "figures")
    assert [path.name for path in written] == [
        "plane_500nm_ill15_azi0.png",
        "plane_500nm_ill15_azi0.svg",
        "plane_500nm_ill15_azi105.png",
        "plane_500nm_ill15_azi105.svg",
        "overview.png",
        "overview.svg",
    ]
    for path in written[::2]:
        image = imread(path)
        assert image.shape[0] > 400
        assert 0.02 < np.mean(image[..., :3].min(axis=-1) < 0.9) < 0.6  # something is drawn, on much white
    assert all(path.read_text().rstrip().endswith("</svg>") for path in written[1::2])


def test_names_tell_every_plane_apart():
    names = [plane_name(plane) for plane in comparison(wavelengths=(500.0, 632.8)).planes]
    assert names[-1] == "plane_632.8nm_ill15_azi105"
    assert len(set(names)) == 4


def test_planes_of_the_overview_share_their_scales():
    figure = draw_overview(comparison())
    limits = [axis.get_ylim() for axis in figure.axes]
    assert limits[0] == limits[2]
    assert limits[1] == limits[3]


def test_a_plane_of_a_single_point_can_be_drawn(tmp_path):
    result = comparison()
    one = result.points.isel(point=[0])
    measured = one.rename(measured="brf", u_measured="u_brf")[["brf", "u_brf"]]
    predicted = one.rename(simulated="brf", u_simulated="u_brf", u_monte_carlo="u_brf_monte_carlo")
    assert len(draw_planes(compare(measured, predicted), tmp_path, ("png",))) == 2


def test_pyplot_and_its_global_state_are_not_touched():
    code = "import sys, twin.figures; assert 'matplotlib.pyplot' not in sys.modules"
    subprocess.run([sys.executable, "-c", code], check=True)
