"""CUDA's kernels as the assembler reports them: registers, local memory and spills, without a GPU.

    python benchmarks/cuda_registers.py
    python benchmarks/cuda_registers.py --capability 9.0 --structure grid --json registers.json

Compiles every kernel of `raystream.cuda.precompile` to PTX for compute capabilities 7.5, 8.0 and
9.0, and assembles each with ``ptxas -v``, from PATH or from NVIDIA's wheels, which ``pip install
raystream[cuda]`` installs. The stack is a thread's local memory, which includes spilled registers.
*Warps* is how many warps a multiprocessor has enough registers for, out of 32 (7.5) or 64.
"""

import argparse
import json
import re
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path

_ENTRY = re.compile(
    r"Function properties for (\S+)\n\s*(\d+) bytes stack frame, (\d+) bytes spill "
    r"stores, (\d+) bytes spill loads"
)
_USED = re.compile(r"Used (\d+) registers")
_CUMULATIVE = re.compile(r"(\d+) bytes cumulative stack size")

#: Registers of a multiprocessor, for all capabilities; and its maximum number of warps.
REGISTERS = 65_536
MOST_WARPS = {(7, 5): 32}
COLUMNS = {
    "registers": "registers",
    "warps": "warps",
    "stack_bytes": "stack",
    "spill_store_bytes": "spill stores",
    "spill_load_bytes": "spill loads",
    "ptx_bytes": "PTX",
    "seconds": "seconds",
}


def find_ptxas():
    """Path of the assembler, preferably that of the compiler's own version."""
    for folder in map(Path, sys.path):
        for name in ("cuda_nvcc/bin/ptxas", "cu13/bin/ptxas"):
            path = folder / "nvidia" / name
            if path.is_file():
                return str(path)
    return shutil.which("ptxas")


def assemble(ptxas, compiled, capability):
    """The assembler's figures for a kernel."""
    with tempfile.TemporaryDirectory() as folder:
        source = Path(folder, "kernel.ptx")
        source.write_text(compiled.ptx)
        target = f"-arch=sm_{capability[0]}{capability[1]}"
        command = [ptxas, "-v", target, str(source), "-o", str(Path(folder, "kernel.cubin"))]
        done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode:
        raise SystemExit(f"ptxas failed: {done.stderr.strip().splitlines()[-1]}")
    return figures_of(done.stderr, compiled.entry, capability)


def figures_of(said, entry, capability):
    """Registers, stack and spills of a kernel; the stack includes that of its callees."""
    frames = {name: tuple(map(int, rest)) for name, *rest in _ENTRY.findall(said)}
    own, stores, loads = frames[entry]
    registers = int(_USED.search(said)[1])
    cumulative = _CUMULATIVE.search(said)
    # A warp's registers are allocated in steps of 256: eight per thread.
    warps = REGISTERS // (32 * 8 * -(-registers // 8))
    return {
        "registers": registers,
        "warps": min(warps, MOST_WARPS.get(capability, 64)),
        "stack_bytes": max(own, int(cumulative[1]) if cumulative else 0),
        "spill_store_bytes": stores,
        "spill_load_bytes": loads,
    }


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--capability", action="append", help="such as 9.0 [default: all]")
    parser.add_argument("--structure", action="append", help="[default: all]")
    parser.add_argument("--json", type=Path, help="file for the figures")
    arguments = parser.parse_args()
    ptxas = find_ptxas()
    if ptxas is None:
        sys.exit(
            "ptxas: not found on PATH or in NVIDIA's wheels; pip install nvidia-cuda-nvcc-cu12"
        )
    try:
        from raystream.jit.cuda import CAPABILITIES, is_simulated
    except ImportError:
        sys.exit("numba-cuda: not found; pip install 'raystream[cuda]'")
    if is_simulated():
        sys.exit("NUMBA_ENABLE_CUDASIM: the simulator has no compiler; unset it")

    import raystream as rs
    from raystream.cuda.precompile import all_kernels

    wanted = arguments.capability or [".".join(map(str, one)) for one in CAPABILITIES]
    rows = []
    for (group, name), compile_for in all_kernels(rs.load("cornell")).items():
        if arguments.structure and group not in arguments.structure:
            continue
        for text in wanted:
            major, _, minor = text.partition(".")
            capability = int(major), int(minor or 0)
            started = time.perf_counter()
            compiled = compile_for(capability)
            seconds = time.perf_counter() - started
            row = {"group": group, "kernel": name, "capability": text}
            row |= assemble(ptxas, compiled, capability)
            row |= {"ptx_bytes": len(compiled.ptx), "seconds": round(seconds, 2)}
            rows.append(row)
            if len(rows) == 1:
                titles = "".join(f"{title:>13}" for title in COLUMNS.values())
                print(f"{'kernel':28}{'for':>5}{titles}")
            figures = "".join(f"{row[column]:>13,}" for column in COLUMNS)
            print(f"{group + ', ' + name:28}{text:>5}{figures}", flush=True)
    if not rows:
        sys.exit(f"--structure: none of {arguments.structure} has kernels")
    if arguments.json:
        arguments.json.write_text(json.dumps({"ptxas": ptxas, "kernels": rows}, indent=1) + "\n")


if __name__ == "__main__":
    main()
