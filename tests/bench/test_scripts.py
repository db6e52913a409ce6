"""The CUDA scripts in benchmarks/, without a GPU and with failing tools."""

from __future__ import annotations

import contextlib
import importlib.util
import json
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from conftest import child_environment, reason_against_cuda
from extras import need

FOLDER = Path(__file__).resolve().parents[2] / "benchmarks"
if not FOLDER.is_dir():
    pytest.skip("the scripts are not in an installed package", allow_module_level=True)

#: Output of ptxas for two functions, the second of which is called by the first.
SAID = """\
ptxas info    : 480 bytes gmem
ptxas info    : Compiling entry function '_Zkernel' for 'sm_75'
ptxas info    : Function properties for _Zkernel
    72 bytes stack frame, 16 bytes spill stores, 24 bytes spill loads
ptxas info    : Used 97 registers, used 0 barriers, 200 bytes cumulative stack size
ptxas info    : Function properties for _Zcalled
    128 bytes stack frame, 0 bytes spill stores, 0 bytes spill loads
"""


def script(name):
    """A script as a module."""
    spec = importlib.util.spec_from_file_location(name, FOLDER / f"{name}.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.fixture
def check(tmp_path):
    module = script("cuda_check")
    module.LEAST = 0.5
    return module.Check(tmp_path / "results.json", 100.0)


def steps_of(check):
    return [(one["step"], one["status"]) for one in check.results["steps"]]


def test_registers_are_read_from_the_assembler():
    figures = script("cuda_registers").figures_of(SAID, "_Zkernel", (7, 5))
    assert figures == {
        "registers": 97,
        "warps": 19,  # of 104 registers a thread
        "stack_bytes": 200,
        "spill_store_bytes": 16,
        "spill_load_bytes": 24,
    }
    few = SAID.replace("Used 97", "Used 24")
    read = script("cuda_registers").figures_of
    assert read(few, "_Zkernel", (7, 5))["warps"] == 32
    assert read(few, "_Zkernel", (9, 0))["warps"] == 64


def test_no_assembler(monkeypatch):
    registers = script("cuda_registers")
    monkeypatch.setattr(registers, "find_ptxas", lambda: None)
    monkeypatch.setattr(sys, "argv", ["cuda_registers.py"])
    with pytest.raises(SystemExit, match="ptxas: not found on PATH or in NVIDIA's wheels"):
        registers.main()


def test_the_assembler_is_asked(tmp_path):
    registers = script("cuda_registers")
    ptxas = registers.find_ptxas()
    if ptxas is None:
        pytest.skip("needs ptxas")
    text = ".version 7.0\n.target sm_75\n.address_size 64\n.visible .entry nothing()\n{\nret;\n}\n"
    figures = registers.assemble(ptxas, SimpleNamespace(ptx=text, entry="nothing"), (8, 0))
    assert figures["stack_bytes"] == figures["spill_store_bytes"] == 0
    assert 0 < figures["registers"] < 32
    with pytest.raises(SystemExit, match="ptxas failed"):
        registers.assemble(ptxas, SimpleNamespace(ptx="nothing", entry="nothing"), (8, 0))


def test_a_machine_without_a_gpu():
    need("numba_cuda")
    if not reason_against_cuda():
        pytest.skip("there is a GPU")
    done = subprocess.run(
        [sys.executable, FOLDER / "cuda_check.py"],
        env=child_environment(),
        capture_output=True,
        text=True,
        timeout=120,
    )
    assert done.returncode == 2
    assert done.stdout == ""
    assert done.stderr.startswith("cuda_check: device 'cuda': there is no NVIDIA ")
    assert done.stderr.count("\n") == 1


def test_steps_that_fail_do_not_stop_the_others(check):
    def ask(name, code, limit=20.0):
        return check.run(name, [sys.executable, "-c", code], limit, lambda _, out, err: out + err)

    assert ask("right", "print(1, end='')")
    assert not ask("wrong", "print(2); raise SystemExit(3)")
    assert not ask("absent", "import nothing_of_this_name")
    assert not ask("slow", "import time; print('begun', flush=True); time.sleep(60)", 1.0)
    assert not check.run("no program", ["/nowhere/at/all"], 20.0, lambda *_: "")
    no_answer = [sys.executable, "-c", "print('no JSON')"]
    assert not check.run("no answer", no_answer, 20.0, lambda _, out, __: json.loads(out))
    assert not ask("no time", "print(1)", 0.2)
    kinds = ["passed", "failed", "failed", "timed out", "failed", "failed", "left out"]
    assert [status for _, status in steps_of(check)] == kinds
    assert check.results["steps"][0]["line"] == "1"
    assert check.results["steps"][3]["output"] == "begun\n"


def test_results_are_kept_as_they_come(check, tmp_path):
    check.keep("first", "passed", "well")
    check.results["speed"] = [{"scene": "none", "rows": []}]
    check.write()
    kept = json.loads((tmp_path / "results.json").read_text())
    assert kept["steps"][0]["line"] == "well"
    assert kept["speed"][0]["scene"] == "none"


def test_the_table(check, capsys):
    row = {"set": "ao", "contender": "bvh", "mrays_per_second": 1234.5}
    row |= {"mrays_per_second_whole": 12.0}
    other = {**row, "contender": "warp", "mrays_per_second": None}
    check.results["speed"] = [{"scene": "sponza", "rows": [row, other]}]
    script("cuda_check").table(check)
    assert capsys.readouterr().out.splitlines()[-1].split() == [
        *("sponza", "ao", "1,234.5", "(12)", "-", "(12)"),
    ]


class Clock:
    """A CUDA stream whose events are a quarter of a millisecond apart."""

    def __init__(self):
        self.count = 0

    def record(self, options):
        assert options == {"timing_enabled": True}
        self.count += 1
        return Event(0.25 * self.count)


class Event(float):
    def sync(self):
        """Wait for nothing."""


def test_launches_are_timed(monkeypatch):
    need("numba_cuda")
    from raystream.jit.cuda import Gpu

    monkeypatch.setitem(sys.modules, "cuda.core", SimpleNamespace(EventOptions=dict))
    asked = []
    monkeypatch.setattr(Gpu, "launch", lambda gpu, values, stream=None: asked.append(values))
    before = Gpu.launch
    legacy, other = Clock(), Clock()
    gpu = SimpleNamespace(
        doing=lambda _: contextlib.nullcontext(), _legacy=SimpleNamespace(native=legacy)
    )
    with script("cuda_speed").launches() as seconds:
        Gpu.launch(gpu, [1])
        Gpu.launch(gpu, [2], stream=other)
        assert (legacy.count, other.count) == (2, 2)
    assert seconds == [0.25e-3] * 2
    assert asked == [[1], [2]]
    assert Gpu.launch is before


def test_pixels_in_morton_order():
    order = script("cuda_speed").morton(4, 2)
    assert order.tolist() == [0, 1, 4, 5, 2, 3, 6, 7]


def test_secondary_rays_leave_what_was_hit():
    """From a square seen from above: upwards, by the cosine, 32 of a hit in a row."""
    import raystream as rs

    corners = np.array([[-1, 0, -1], [1, 0, -1], [1, 0, 1], [-1, 0, 1]], float) * 9
    scene = rs.Scene.from_arrays(corners, [[0, 1, 2], [0, 2, 3]])
    origins = np.random.default_rng(1).uniform([-4, 5, -4], [4, 5, 4], (500, 3))
    hits = rs.Tracer(scene, "brute").first_hit(origins, [0.0, -1.0, 0.0])
    rng = np.random.default_rng(2)
    rays = script("cuda_speed").secondary(hits, (0.0, 5.0, 0.0), 32, 2.0, rng)
    assert rays.origins.dtype == rays.directions.dtype == np.float32
    assert rays.directions.shape == (500 * 32, 3)
    np.testing.assert_allclose(np.linalg.norm(rays.directions, axis=1), 1.0, atol=1e-5)
    assert (rays.directions[:, 1] > 0.0).all()
    # The mean of the cosine is 2/3, its variance 1/18.
    assert abs(rays.directions[:, 1].mean() - 2 / 3) < 5 * np.sqrt(1 / 18 / len(rays.directions))
    np.testing.assert_array_equal(rays.origins[::32], rays.origins[31::32])
    assert not rs.Tracer(scene, "brute").any_hit(rays.origins, rays.directions).any()
