"""Kernels that are compiled before they are needed."""

import subprocess
import sys

import numba
import numpy as np
import pytest

from conftest import child_environment
from kernel_list import COPIED_MODES, TASKS, run
from raystream.jit import warm as warm_module
from raystream.jit.cpu import kernel
from raystream.jit.signatures import decode_type, encode_type
from raystream.jit.warm import Entry, compile_kernels, entries_of, missing, warm
from raystream.kernels.ray import SceneFrame


@pytest.mark.parametrize(
    "value",
    [
        1,
        True,
        None,
        np.uint64(1),
        np.float32(1),
        np.zeros((2, 3), np.float32),
        np.zeros((2, 3), np.int32, order="F"),
        np.zeros((4, 6))[::2, ::2],
        np.broadcast_to(np.float32(1), 3),
        (1, np.float32(2)),
        (1.0, 2.0),
        SceneFrame(*[np.float32(1)] * len(SceneFrame._fields)),
        (SceneFrame(*[None] * len(SceneFrame._fields)), (1, (2.0,))),
    ],
)
def test_types_become_json_and_come_back(value):
    type_ = numba.typeof(value)
    assert decode_type(encode_type(type_)) == type_


def test_other_types_are_not_listed():
    record = np.zeros(2, [("a", "f4")])
    for value in (record, (1, record), numba.njit(lambda x: x)):
        assert encode_type(numba.typeof(value)) is None


@pytest.mark.parametrize(
    "code", ["int65", {"tuple": "raystream.core.hits:Gone", "of": []}, {"list": "int64"}, 3]
)
def test_names_that_are_not_there_are_refused(code):
    with pytest.raises(ValueError, match=r"int65|Gone|list|3"):
        decode_type(code)


@kernel
def twice(x):
    return 2 * x


@kernel
def thrice(x):
    return 3 * x


def entry_of(dispatcher, *types):
    return Entry(dispatcher._cache.name, list(types), ["tests"], 1.0)


def test_what_is_missing_is_compiled_once(tmp_path, monkeypatch):
    monkeypatch.setenv("RAYSTREAM_CACHE_DIR", str(tmp_path))
    entries = [entry_of(twice, "int64"), entry_of(thrice, "float32"), entry_of(thrice, "int64")]
    gone = [Entry("raystream.nowhere:gone", [], [], 1.0), Entry(__name__ + ":gone", [], [], 1.0)]
    assert missing([*entries, *gone]) == entries
    assert compile_kernels([entries[0], *gone]) == 1
    assert missing(entries) == entries[1:]
    assert compile_kernels(entries) == 2
    assert missing(entries) == []
    assert compile_kernels(entries) == 0
    assert len(list(tmp_path.rglob("*.nbc"))) == 3


def test_a_helper_that_dies_leaves_its_part_to_this_process(tmp_path, monkeypatch):
    monkeypatch.setenv("RAYSTREAM_CACHE_DIR", str(tmp_path))
    begun = []

    def die(task, count):
        begun.append(count)
        return [subprocess.Popen([sys.executable, "-c", "exit(1)"]) for _ in range(count)]

    monkeypatch.setattr(warm_module, "start_helpers", die)
    entries = [entry_of(twice, "uint64"), entry_of(thrice, "uint64")]
    shares = []
    assert warm(entries, "tests", 8, shares.append) == 2
    assert begun == [2]  # no more processes than kernels
    assert missing(entries) == []
    assert shares[-1] == 1.0
    assert shares == sorted(shares)
    assert warm(entries, "tests", 8, shares.append) == 0


def test_every_entry_names_a_kernel():
    entries = entries_of("all")
    assert len(entries) > 25
    assert [entry.kernel for entry in entries if warm_module._prepare(entry) is None] == []
    assert {task for entry in entries for task in entry.tasks} == set(TASKS)
    seconds = [entry.seconds for entry in entries]
    assert seconds == sorted(seconds, reverse=True)
    of_kinds = [entry for task in TASKS if "query" in task for entry in entries_of(task)]
    assert {entry.kernel for entry in entries_of("query")} == {e.kernel for e in of_kinds}


@pytest.mark.parametrize(
    "task",
    [
        pytest.param(one, marks=[pytest.mark.exhaustive] * (one not in ("query-any", "render-vis")))
        for one in TASKS
    ],
)
def test_the_list_is_what_the_command_asks_for(task):
    """If it is not: python tests/kernel_list.py."""
    asked = {(row["kernel"], str(row["types"])) for row in run(task) if None not in row["types"]}
    listed = {(entry.kernel, str(entry.types)) for entry in entries_of(task)}
    if task.endswith(":full"):  # the list is for scenes of any size
        assert asked <= listed
    else:
        assert asked == listed


@pytest.mark.parametrize("mode", COPIED_MODES)
def test_scenes_that_are_not_plain_need_another_shading_kernel(mode):
    plain, full = (
        {entry.kernel for entry in entries_of(f"render-{mode}{kind}")} for kind in ("", ":full")
    )
    (copy,) = plain - full
    assert copy.endswith("_of_plain_scenes")
    assert copy.removesuffix("_of_plain_scenes") in full - plain


@pytest.mark.exhaustive
@pytest.mark.slow
def test_a_first_picture_compiles_in_two_processes(tmp_path):
    """Kernels compiled by the helper are not compiled again, and none is left to compile."""
    environment = child_environment(
        RAYSTREAM_CACHE_DIR=str(tmp_path / "cache"), RAYSTREAM_THREADS="2"
    )
    command = [sys.executable, "-m", "raystream", "render", "-o", "picture.png"]
    command += ["--mode", "raycast", "--samples", "1"]
    pictures = []
    for _ in range(2):
        done = subprocess.run(
            command, cwd=tmp_path, env=environment, capture_output=True, text=True, check=False
        )
        assert done.returncode == 0, done.stderr
        pictures.append((tmp_path / "picture.png").read_bytes())
        notes = [line for line in done.stderr.splitlines() if "compiling" in line]
        assert len(notes) == (len(pictures) == 1)
    assert pictures[0] == pictures[1]
    listed = len(entries_of("render-raycast"))
    assert len(list(tmp_path.rglob("*.nbc"))) == listed
