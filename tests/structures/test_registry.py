"""The registry of structures, and names that are written twice."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

import raystream
from raystream.kernels.leaf_block import BLOCK_SIZE
from raystream.structures import STRUCTURES, form_of, names_with, structure_class
from raystream.structures.base import Structure
from raystream.structures.bvh.build import QUALITIES
from raystream.structures.bvh.layout import MAX_LEAF_BLOCKS
from raystream.structures.bvh.options import MAX_LEAF_SIZE

SOURCE = Path(raystream.__file__).resolve().parents[1]

FORMS = (
    *("nearest", "nearest search", "multipass"),
    *("cuda kernels", "cuda build", "graphics", "graphics multipass"),
)


def test_the_default_comes_first():
    assert next(iter(STRUCTURES)) == "bvh"
    assert list(STRUCTURES)[:5] == ["bvh", "brute", "graph", "grid", "kdtree"]


@pytest.mark.parametrize("name", STRUCTURES)
def test_what_is_built_has_the_name(name):
    made = structure_class(name)
    assert issubclass(made, Structure)
    assert made.stack_bytes >= 8
    built = raystream.Tracer(raystream.load("cornell"), name).structure
    assert type(built) is made
    assert built.name == name
    assert built.options == STRUCTURES[name]()


@pytest.mark.parametrize(
    ("name", "form"), [(name, form) for name in STRUCTURES for form in STRUCTURES[name].forms]
)
def test_forms_are_where_they_are_said_to_be(name, form):
    """Without importing them: some need packages that may be missing."""
    assert form in FORMS
    module, _, function = STRUCTURES[name].forms[form].partition(":")
    text = SOURCE.joinpath(*module.split(".")).with_suffix(".py").read_text(encoding="utf-8")
    assert not function or re.search(rf"^(def {function}\(|{function} = )", text, re.MULTILINE)


def test_forms_of_unknown_structures():
    assert form_of("octree", "multipass") is None
    assert "octree" not in names_with("multipass")


def test_a_bvh_s_options_are_those_of_its_builder():
    assert {*STRUCTURES["bvh"].choices("quality")} == {*QUALITIES}
    assert MAX_LEAF_SIZE == BLOCK_SIZE * MAX_LEAF_BLOCKS == 32
