import os
import sys
import time
from pathlib import Path
from types import SimpleNamespace

import pytest

from forks import Fork
from jit.kernel_package import CALLEE, PROGRAM, copy_package
from raystream.core.cache_folder import cache_folder
from raystream.jit import cache as cache_module
from raystream.jit.cpu import kernel


def begin(source: Path, folder: Path) -> Fork:
    return Fork(source.parent / "program.py", [source], {"RAYSTREAM_CACHE_DIR": str(folder)})


def run(source: Path, folder: Path) -> list[str]:
    return begin(source, folder).words()


@pytest.fixture(scope="module")
def source(tmp_path_factory):
    """A copy of the package, to be edited; tests that edit it restore it."""
    folder = tmp_path_factory.mktemp("copy")
    (folder / "program.py").write_text(PROGRAM)
    return copy_package(folder / "src").parent


def test_kernels_are_compiled_once_and_again_after_an_edit(source, tmp_path):
    folder = tmp_path / "cache"
    assert run(source, folder) == ["2", "0", "1"]
    assert run(source, folder) == ["2", "1", "0"]
    callee = source / "raystream" / "kernels" / "callee.py"
    callee.write_text(CALLEE.replace("+ 1", "+ 100"))
    assert run(source, folder) == ["101", "0", "1"]
    callee.write_text(CALLEE)
    assert run(source, folder) == ["2", "1", "0"]  # the older code is still there


@pytest.mark.ci
def test_damaged_files_are_compiled_over(source, tmp_path):
    folder = tmp_path / "cache"
    run(source, folder)
    files = [*folder.rglob("*.nbc")]
    assert files
    for path in files:
        path.write_bytes(path.read_bytes()[:-20])
    assert run(source, folder) == ["2", "0", "1"]
    assert run(source, folder) == ["2", "1", "0"]


def test_a_folder_that_cannot_be_written_is_no_error(source, tmp_path):
    blocked = tmp_path / "file"
    blocked.write_text("not a folder")
    assert run(source, blocked / "cache") == ["2", "0", "1"]


@pytest.mark.ci
def test_two_processes_at_once_share_one_folder(source, tmp_path):
    folder = tmp_path / "cache"
    both = [begin(source, folder) for _ in range(2)]
    answers = [process.words() for process in both]
    assert sorted(answers) == [["2", "0", "1"], ["2", "1", "0"]]  # one waited for the other
    assert run(source, folder) == ["2", "1", "0"]
    assert not list(folder.rglob("*.tmp.*"))


def test_old_files_and_the_least_recently_used_ones_go(tmp_path, monkeypatch):
    monkeypatch.setattr(cache_module, "SIZE_LIMIT", 1000)
    now = time.time()
    ages = {"new.nbc": 0, "used.ptx": 1, "older.nbc": 2, "oldest.nbc": 3, "unused.nbc": 100}
    for name, days in ages.items():
        (tmp_path / name).write_bytes(bytes(50 if name == "unused.nbc" else 400))
        os.utime(tmp_path / name, (now - 86_400 * days,) * 2)
    (tmp_path / "turns").touch()
    (tmp_path / "0123456789abcdef").mkdir()  # an earlier layout: a folder for each state
    (tmp_path / "0123456789abcdef" / "kernel.nbi").touch()
    os.utime(tmp_path / "0123456789abcdef", (now - 86_400 * 100,) * 2)
    os.utime(tmp_path / "turns", (now - 86_400 * 100,) * 2)
    cache_module.evict(tmp_path)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["new.nbc", "turns", "used.ptx"]


@kernel
def twice(x):
    return x + x


def test_code_for_another_processor_is_not_read(tmp_path, monkeypatch):
    monkeypatch.setenv("RAYSTREAM_CACHE_DIR", str(tmp_path))
    assert twice(2) == 4
    (signature,) = twice.signatures

    def is_there(machine):
        codegen = SimpleNamespace(magic_tuple=lambda: machine)
        return twice._cache.is_on_disk(signature, SimpleNamespace(codegen=lambda: codegen))

    own = twice.targetctx.codegen().magic_tuple()  # platform, processor, what it can do
    assert is_there(own)
    for place in range(len(own)):
        assert not is_there((*own[:place], "another", *own[place + 1 :]))


@pytest.mark.ci
def test_files_that_are_read_count_as_used(source, tmp_path):
    folder = tmp_path / "cache"
    run(source, folder)
    (file,) = folder.rglob("*.nbc")
    os.utime(file, (time.time() - 10 * 86_400,) * 2)
    run(source, folder)
    assert time.time() - file.stat().st_mtime < 3600


def test_the_folder_follows_the_platform(monkeypatch, tmp_path):
    monkeypatch.delenv("RAYSTREAM_CACHE_DIR", raising=False)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    monkeypatch.setattr(sys, "platform", "linux")
    assert cache_folder() == tmp_path / "raystream"
    monkeypatch.setattr(sys, "platform", "win32")
    monkeypatch.setenv("LOCALAPPDATA", str(tmp_path / "local"))
    assert cache_folder() == tmp_path / "local" / "raystream"
    monkeypatch.setenv("RAYSTREAM_CACHE_DIR", str(tmp_path / "chosen"))
    assert cache_folder() == tmp_path / "chosen"
