"""The table of what each kind of scene supports."""

from types import SimpleNamespace
from typing import Any

import pytest

import raystream as rs
from raystream.core.scene_kinds import REFUSALS, check_support, is_supported


def store_of(*kinds: str) -> Any:
    return SimpleNamespace(kinds=kinds)


def test_features_that_are_not_listed_are_those_of_triangles_alone():
    check_support("any feature", store_of())
    for kind, text in REFUSALS.items():
        with pytest.raises(rs.RaystreamError) as caught:
            check_support("any feature", store_of(kind))
        assert str(caught.value) == f"any feature: {text}"


def test_a_scene_of_several_kinds_has_what_all_of_them_have():
    assert is_supported("render", store_of("instances"))
    assert not is_supported("render", store_of("instances", "worlds"))
    with pytest.raises(rs.RaystreamError, match="render: not supported in a scene whose instances"):
        check_support("render", store_of("instances", "worlds"))


def test_other_values_of_the_argument_are_named():
    chosen = "device='graphics', machine='branching'"
    with pytest.raises(ValueError, match=r"with instances.*use .* or device='graphics', .*compute"):
        check_support(chosen, store_of("instances"), ValueError)
    with pytest.raises(
        ValueError, match=r"float64'; use device='cpu'.* or device='cuda'[^;]*ing'$"
    ):
        check_support(chosen, store_of("float64"), ValueError)
