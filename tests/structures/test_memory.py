"""The arrays of structures, at the addresses passed to traversals."""

from __future__ import annotations

import pytest

import raystream as rs
from conftest import TRACERS


@pytest.mark.parametrize("tracer", TRACERS)
def test_addresses_are_those_of_the_arrays(tracer):
    structure = rs.Tracer(rs.load("cornell"), **TRACERS[tracer]).structure
    assert structure.arrays
    for name, array in structure.arrays.items():
        assert array.flags.c_contiguous
        assert int(getattr(structure.view, name)) in (array.ctypes.data, 0)
        assert int(getattr(structure.view, name)) or structure.name == "grid"
