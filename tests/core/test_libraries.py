"""Results in the library of the rays: by their types, with xarray's labels."""

from __future__ import annotations

import sys
import types

import numpy as np
import pytest

import raystream as rs
from conftest import assert_same_bits
from extras import need
from raystream.core.libraries import library_of
from raystream.core.library_hits import LibraryHits, LibraryMultiHits
from raystream.physics.library_results import LibraryLidarReturns, LibraryThickness


@pytest.fixture(scope="module")
def tracer():
    return rs.Tracer(rs.load("cornell"))


@pytest.fixture
def rays(tracer):
    origins, directions = tracer.scene.camera.rays(6, 4)
    return np.broadcast_to(origins, directions.shape).copy(), directions


class Derived(np.ndarray):
    """Such as masked arrays and quantities."""


@pytest.mark.parametrize(
    "values", [np.zeros(3), [0, 0, 0], (0, 0, 0), 1.0, None, np.zeros(3).view(Derived), memoryview]
)
def test_numpy_and_what_is_unknown_are_answered_in_numpy(values):
    assert library_of(values, np.zeros(3)) is None
    assert library_of(np.zeros(3), values) is None


def test_results_of_numpy_are_as_ever(tracer, rays):
    assert type(tracer.first_hit(*rays)) is rs.Hits
    assert type(tracer.multi_hit(*rays)) is rs.MultiHits
    assert type(tracer.any_hit(*rays)) is np.ndarray
    assert type(tracer.count_hits(rays[0].tolist(), rays[1])) is np.ndarray


@pytest.fixture
def cupy(monkeypatch):
    """A library that is not installed: what it has to offer, without a GPU."""
    module = types.ModuleType("cupy")

    class ndarray:  # noqa: N801
        shape = ()

        def __init__(self, values):
            self.values = np.asarray(values)
            self.shape = self.values.shape
            self.__array_interface__ = self.values.__array_interface__

    ndarray.__module__ = "cupy"
    module.ndarray, module.asarray, module.from_dlpack = ndarray, ndarray, ndarray
    monkeypatch.setitem(sys.modules, "cupy", module)
    return module


def test_every_query_answers_in_the_library_of_its_rays(cupy, tracer, rays):
    given = cupy.ndarray(rays[0]), rays[1]
    expected = tracer.first_hit(*rays)
    for arguments in (given, (rays[0], cupy.ndarray(rays[1]))):
        hits = tracer.first_hit(*arguments)
        assert type(hits) is LibraryHits
        for name in ("t", "u", "v", "prim_id", "status", "positions", "texcoords"):
            column = getattr(hits, name)
            assert type(column) is cupy.ndarray
            assert column is getattr(hits, name)
            assert np.shares_memory(column.values, getattr(hits.host(), name))
            assert_same_bits(column.values, getattr(expected, name))
    assert hits.sectors is None
    assert type(hits[0].t) is cupy.ndarray
    assert hits[hits.host().is_hit].t.shape == hits.ravel()[expected.is_hit.ravel()].t.shape
    many = tracer.multi_hit(*given)
    assert type(many) is LibraryMultiHits
    for name in ("ray_splits", "t", "ray_id", "counts"):
        assert type(getattr(many, name)) is cupy.ndarray
        assert_same_bits(getattr(many, name).values, getattr(tracer.multi_hit(*rays), name))
    assert_same_bits(tracer.any_hit(*given).values, tracer.any_hit(*rays))
    assert_same_bits(tracer.count_hits(*given).values, tracer.count_hits(*rays))
    assert repr(hits).startswith("LibraryHits of Hits(")
    for result in (hits, many):
        with pytest.raises(AttributeError, match="Hits has no attribute 'nothing'"):
            _ = result.nothing


def test_what_a_gpu_does_not_derive_is_on_the_host(cupy, tracer, rays):
    on_gpu = types.SimpleNamespace(t=np.zeros(2), prim_id=np.zeros(2), host=lambda: "copied")
    hits = LibraryHits(on_gpu, library_of(cupy.ndarray([0, 0, 0]), None))
    assert type(hits.t) is cupy.ndarray
    assert hits.host() == "copied"
    with pytest.raises(AttributeError, match=r"positions: not available on a GPU; see host\(\)"):
        _ = hits.positions


def deepest(hit, payload):
    payload[0] = hit.t


@pytest.mark.ci
def test_physics_and_programs_answer_in_the_library_of_their_rays(cupy, tracer, rays):
    given = rays[0], cupy.ndarray(rays[1])
    found, expected = rs.thickness(tracer, *given), rs.thickness(tracer, *rays)
    assert type(found) is LibraryThickness
    for name in ("ray_splits", "t_entry", "mesh_id", "unpaired_t", "status", "is_complete"):
        column = getattr(found, name)
        assert type(column) is cupy.ndarray
        assert_same_bits(column.values, getattr(expected, name))
    assert type(found.total_length()) is cupy.ndarray
    assert_same_bits(found.total_length("mesh").values, expected.total_length("mesh"))
    assert found.mesh_names == expected.mesh_names
    assert found.material_names == expected.material_names
    passed = rs.attenuation(found, 0.01, incomplete="ignore")
    assert type(passed) is cupy.ndarray
    assert_same_bits(passed.values, rs.attenuation(expected, 0.01, incomplete="ignore"))
    found, expected = rs.lidar_returns(tracer, *given), rs.lidar_returns(tracer, *rays)
    assert type(found) is LibraryLidarReturns
    for name in ("ranges", "positions", "return_number", "prim_id", "status", "counts"):
        assert type(getattr(found, name)) is cupy.ndarray
        assert_same_bits(getattr(found, name).values, getattr(expected, name))
    made = tracer.trace(*given, on_hit=deepest, payload=float)
    assert type(made) is cupy.ndarray
    plain = tracer.trace(*rays, on_hit=deepest, payload=float)
    assert_same_bits(made.values, plain)
    hits, bare = tracer.first_hit(*given), tracer.first_hit(*rays)
    beyond = tracer.first_hit(*given, skip_prim_ids=hits)
    assert_same_bits(beyond.t.values, tracer.first_hit(*rays, skip_prim_ids=bare.prim_id).t)
    own = np.zeros(plain.shape)
    assert tracer.trace(*given, on_hit=deepest, payload=own) is own
    assert_same_bits(own, plain)
    records = tracer.trace(*given, on_hit=lambda hit, payload: None, payload=[("a", "f8")])
    assert type(records) is np.ndarray
    points = cupy.ndarray([[100.0, 100.0, 100.0], [460.0, 100.0, 300.0]])
    for form in ("dense", "bits"):
        seen = rs.visibility(tracer, points, form=form)
        assert type(seen) is cupy.ndarray
        assert_same_bits(seen.values, rs.visibility(tracer, points.values, form=form))
    assert type(rs.visibility(tracer, points, form="sparse").indices) is np.ndarray


# ---- xarray.


@pytest.fixture
def labelled(rays):
    need("xarray")
    import xarray as xr

    coords = {"row": [10, 20, 30, 40], "xyz": list("xyz"), "time": ("column", np.arange(6.0))}
    return [xr.DataArray(one, dims=("row", "column", "xyz"), coords=coords) for one in rays]


def test_labels_are_kept(tracer, rays, labelled):
    hits, expected = tracer.first_hit(*labelled), tracer.first_hit(*rays)
    assert hits.t.dims == ("row", "column")
    assert set(hits.t.coords) == {"row", "time"}
    assert_same_bits(hits.t.sel(row=30).values, expected.t[2])
    assert hits.positions.dims == ("row", "column", "xyz")
    assert set(hits.positions.coords) == {"row", "time", "xyz"}
    assert hits.texcoords.dims == ("row", "column", "component")
    assert tracer.any_hit(*labelled).dims == tracer.count_hits(*labelled).dims == ("row", "column")
    assert tracer.any_hit(rays[0], labelled[1]).dims == ("row", "column")
    many = tracer.multi_hit(*labelled)
    assert many.counts.dims == ("row", "column")
    assert many.t.ndim == 1
    assert not many.t.coords
    assert_same_bits(many.t.values, tracer.multi_hit(*rays).t)
    assert hits[1].t.shape == (6,)


def test_labels_are_left_out_where_shapes_differ(tracer, rays, labelled):
    hits = tracer.first_hit(labelled[0][:, :1], rays[1])
    assert hits.t.shape == (4, 6)
    assert not hits.t.coords


def test_labels_of_physics(tracer, rays, labelled):
    found, expected = rs.thickness(tracer, *labelled), rs.thickness(tracer, *rays)
    assert found.total_length().dims == ("row", "column")
    assert_same_bits(found.total_length().sel(row=30).values, expected.total_length()[2])
    assert found.total_length("mesh").dims == ("row", "column", "component")
    assert not found.t_entry.coords
    passed = rs.attenuation(found, 0.01, incomplete="ignore")
    assert set(passed.coords) == {"row", "time"}
    assert rs.lidar_returns(tracer, *labelled).counts.dims == ("row", "column")
    far = tracer.trace(*labelled, on_hit=deepest, payload=float)
    assert far.dims == ("row", "column")
    again = far * 0.0
    assert tracer.trace(*labelled, on_hit=deepest, payload=again) is again
    assert_same_bits(again.values, far.values)


def test_arrays_that_do_not_change_are_no_payloads(tracer, rays):
    need("jax")
    import jax.numpy as jnp

    with pytest.raises(ValueError, match=r"payload: the array is read-only.*give a dtype"):
        tracer.trace(*rays, on_hit=deepest, payload=jnp.zeros((4, 6)))
    made = tracer.trace(jnp.asarray(rays[0]), rays[1], on_hit=deepest, payload=np.float32)
    assert isinstance(made, jnp.ndarray)
    assert_same_bits(np.asarray(made), tracer.trace(*rays, on_hit=deepest, payload=np.float32))
    found = rs.thickness(tracer, jnp.asarray(rays[0]), jnp.asarray(rays[1]))
    assert isinstance(found.t_entry, jnp.ndarray)
