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
