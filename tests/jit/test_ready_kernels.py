"""Kernels that come with the package, compiled for a level of x86-64."""

import os
import shutil
import subprocess
import sys

import pytest
from llvmlite.binding import get_host_cpu_features

from jit.kernel_package import CALLEE, PROGRAM, copy_package
from raystream.jit import ready_kernels
from raystream.jit.ready_kernels import LEVELS

PLATFORM = "x86_64-unknown-linux-gnu"
V3, V4 = LEVELS["x86-64-v3"], LEVELS["x86-64-v4"]


@pytest.mark.parametrize(
    ("features", "expected"),
    [
        (f"+aes,{V4},+vaes", ["x86-64-v4", "x86-64-v3"]),
        (f"+aes,{V3},-avx512f", ["x86-64-v3"]),
        (V4.replace("+avx512vl", "-avx512vl"), ["x86-64-v3"]),
        (V3.replace("+fma", "-fma"), []),
        ("", []),  # NUMBA_CPU_NAME=generic
        ("+neon", []),
    ],
)
def test_a_machine_takes_the_levels_that_it_has(tmp_path, monkeypatch, features, expected):
    monkeypatch.setattr(ready_kernels, "FOLDER", tmp_path)
    machines_of = ready_kernels.machines_of.__wrapped__
    machine = (PLATFORM, "znver5", features)
    assert machines_of(machine) == ()  # the wheel has none
    for level in LEVELS:
        (tmp_path / level).mkdir()
    found = machines_of(machine)
    assert [folder.name for folder, _ in found] == expected
    for folder, compiled_for in found:
        assert compiled_for == (PLATFORM, folder.name, LEVELS[folder.name])


@pytest.fixture(scope="module")
def package(tmp_path_factory):
    """A copy of the package; tests that edit it restore it."""
    return copy_package(tmp_path_factory.mktemp("copy"))


def run(package, cache, **variables):
    """Run the program: the answer, how often its kernel was read and compiled; and warnings."""
    paths = {"PYTHONPATH": str(package.parent), "RAYSTREAM_CACHE_DIR": str(cache)}
    done = subprocess.run(
        [sys.executable, "-c", PROGRAM],
        env={**os.environ, **paths, **variables},
        capture_output=True,
        text=True,
        check=True,
    )
    return [int(word) for word in done.stdout.split()], done.stderr


def files_in(folder):
    return sorted(path.name for path in folder.rglob("*.nbc"))


def test_kernels_of_a_level_are_read_from_the_package(package, tmp_path):
    has = set(get_host_cpu_features().flatten().split(","))
    level = next((name for name, needs in LEVELS.items() if has >= set(needs.split(","))), None)
    if level is None:
        pytest.skip("the processor has no level with ready kernels")
    chosen = {"NUMBA_CPU_NAME": level, "NUMBA_CPU_FEATURES": LEVELS[level]}
    assert run(package, tmp_path / "made", **chosen)[0] == [2, 0, 1]
    ready = package / "jit" / "ready" / level
    shutil.copytree(tmp_path / "made" / "kernels", ready)
    try:
        assert run(package, tmp_path / "cache")[0] == [2, 1, 0]
        assert files_in(tmp_path / "cache") == []
        # An older processor does not take them, and neither does code that has changed.
        assert run(package, tmp_path / "old", NUMBA_CPU_NAME="generic")[0] == [2, 0, 1]
        (package / "kernels" / "callee.py").write_text(CALLEE.replace("+ 1", "+ 100"))
        assert run(package, tmp_path / "cache")[0] == [101, 0, 1]
        (package / "kernels" / "callee.py").write_text(CALLEE)
        for file in ready.glob("*.nbc"):
            file.write_bytes(b"damaged")
        assert run(package, tmp_path / "damaged")[0] == [2, 0, 1]
        assert len(files_in(tmp_path / "damaged")) == 1
    finally:
        (package / "kernels" / "callee.py").write_text(CALLEE)
        shutil.rmtree(package / "jit" / "ready")


@pytest.mark.skipif(sys.platform == "win32", reason="looks at POSIX permissions")
@pytest.mark.parametrize("how", ["group", "all", "owner"])
def test_kernels_are_not_read_where_another_user_can_write(package, tmp_path, how):
    assert run(package, tmp_path)[0] == [2, 0, 1]
    assert run(package, tmp_path) == ([2, 1, 0], "")
    folder = tmp_path / "kernels"
    before = files_in(folder)
    if how == "owner":
        if os.geteuid() != 0:
            pytest.skip("only the administrator can give a folder away")
        os.chown(folder, 12345, -1)
    else:
        folder.chmod(0o770 if how == "group" else 0o777)
    # Now it is compiled again, and not kept.
    answer, warning = run(package, tmp_path)
    assert answer == [2, 0, 1]
    assert f"{folder}: other users can write there" in warning
    assert warning.count("RuntimeWarning") == 1
    assert files_in(folder) == before


@pytest.mark.skipif(sys.platform == "win32", reason="looks at POSIX permissions")
def test_files_that_another_user_can_write_are_compiled_over(package, tmp_path):
    assert run(package, tmp_path)[0] == [2, 0, 1]
    (file,) = (tmp_path / "kernels").glob("*.nbc")
    assert file.stat().st_mode & 0o022 == 0
    file.chmod(0o666)
    assert run(package, tmp_path)[0] == [2, 0, 1]
    assert run(package, tmp_path)[0] == [2, 1, 0]  # kept as its own again
