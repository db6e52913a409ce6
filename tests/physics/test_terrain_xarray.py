"""Terrain from xarray: coordinates are used, and results have the raster's labels."""

from __future__ import annotations

import numpy as np
import pytest

from extras import need

need("xarray")
import xarray as xr

import raystream as rs


def raster(heights, **changes):
    rows, columns = np.shape(heights)
    parts = {
        "dims": ("y", "x"),
        "coords": {"y": 2000.0 - 10.0 * np.arange(rows), "x": 500.0 + 10.0 * np.arange(columns)},
        "attrs": {"units": "m"},
        "name": "height",
    }
    return xr.DataArray(np.array(heights, float), **(parts | changes))


HEIGHTS = np.random.default_rng(0).uniform(0, 30, (12, 15))


def test_results_have_the_labels():
    dem = raster(HEIGHTS)
    ground = rs.terrain(dem)
    plain = rs.terrain(HEIGHTS, transform=(10, 0, 495, 0, -10, 2005))
    assert (ground.x == plain.x).all()
    assert (ground.y == plain.y).all()
    observer = (571.0, 1943.0)
    visible = ground.viewshed(observer, height=5.0)
    shade = ground.hillshade(300.0, 30.0, shadows=True)
    for result, name, wanted in (
        (visible, "viewshed", plain.viewshed(observer, height=5.0)),
        (shade, "hillshade", plain.hillshade(300.0, 30.0, shadows=True)),
    ):
        assert isinstance(result, xr.DataArray)
        assert result.name == name
        assert result.dims == dem.dims
        assert all((result[one] == dem[one]).all() for one in dem.dims)
        assert not result.attrs
        assert np.array_equal(result.values, wanted)
    assert visible.dtype == bool
    assert (dem.values == HEIGHTS).all()
    assert dem.name == "height"
    south = ground.viewshed(observer, height=5.0).sortby("y")
    assert (south.sel(y=1900.0) == visible.sel(y=1900.0)).all()


def test_irregular_coordinates():
    x = np.array([0.0, 1, 3, 7, 8, 20])
    y = np.array([10.0, 4, 3, -6])
    dem = xr.DataArray(0.2 * x - 0.5 * y[:, None], dims=("y", "x"), coords={"x": x, "y": y})
    ground = rs.terrain(dem)
    assert ground.viewshed((2.0, 0.0), height=1.0).all()
    shade = ground.hillshade(0.0, 90.0)
    assert np.allclose(shade, 1 / np.sqrt(1 + 0.2**2 + 0.5**2))


def test_missing_heights():
    holes = HEIGHTS.copy()
    holes[2, 3] = -9999.0
    for dem in (
        raster(np.where(holes < 0, np.nan, holes)),
        raster(holes, attrs={"_FillValue": -9999.0}),
    ):
        assert np.isnan(rs.terrain(dem).heights).sum() == 1
    assert np.isnan(rs.terrain(raster(holes), nodata=-9999).heights).sum() == 1


def test_no_data_is_not_hidden():
    holes = np.tile([0.0, 0, 0, np.nan, np.nan, 100, 100], (5, 1))
    for dem in (raster(holes), raster(np.nan_to_num(holes, nan=-1.0), attrs={"_FillValue": -1.0})):
        seen = rs.terrain(dem).viewshed((500.0, 1980.0), height=10.0)
        assert seen.dtype == np.float32
        np.testing.assert_array_equal(seen[2], [1, 1, 1, np.nan, np.nan, 1, 0])
        assert float(seen.mean()) == np.float32(4 / 5)


@pytest.mark.parametrize("hole", [1.0, np.nan])
def test_results_do_not_have_the_encoding_of_the_raster(hole):
    heights = np.where(HEIGHTS[3, 4] == HEIGHTS, hole, HEIGHTS)
    dem = raster(heights)
    dem.encoding = {
        "dtype": "int16",
        "_FillValue": -9999,
        "scale_factor": 0.1,
        "grid_mapping": "crs",
    }
    ground = rs.terrain(dem)
    seen, shade = ground.viewshed((570.0, 1940.0), height=5.0), ground.hillshade(shadows=True)
    for result in (seen, shade):
        assert result.encoding["grid_mapping"] == "crs"
        variables = xr.conventions.encode_dataset_coordinates(result.to_dataset())[0]
        written = xr.conventions.encode_cf_variable(variables[result.name])
        read = xr.conventions.decode_cf_variable(result.name, written)
        np.testing.assert_array_equal(read.values, result.values)
        assert written.dtype == (np.uint8 if result is seen else np.float32)
    assert dem.encoding["dtype"] == "int16"


def test_without_coordinates_the_spacing_is_used():
    dem = xr.DataArray(HEIGHTS, dims=("north", "east"))
    assert rs.terrain(dem, spacing=5.0).x[-1] == 70.0
    assert rs.terrain(dem, spacing=5.0).hillshade().dims == ("north", "east")


@pytest.mark.parametrize(
    ("dem", "options", "match"),
    [
        (raster(HEIGHTS).transpose("x", "y"), {}, r"dem.transpose\('y', 'x'\)"),
        (raster(HEIGHTS).rename(x="lon", y="lat"), {}, "dem: dimensions 'lat', 'lon' are angles"),
        (raster(HEIGHTS).expand_dims("band"), {}, "dem: expected two dimensions"),
        (raster(HEIGHTS), {"spacing": 1.0}, "spacing: dem has its own coordinates"),
        (raster(HEIGHTS).assign_coords(x=np.zeros(15)), {}, "x: expected finite coordinates"),
    ],
)
def test_bad_rasters_are_named(dem, options, match):
    with pytest.raises(ValueError, match=match):
        rs.terrain(dem, **options)
