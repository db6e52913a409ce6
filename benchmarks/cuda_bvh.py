"""The layouts of a BVH on CUDA beside each other, without a GPU.

    python benchmarks/cuda_bvh.py --scenes sponza conference bunny
    python benchmarks/cuda_bvh.py --assembler --queries first_hit multi_hit

Counts what rays meet in each layout, by the kernels as they are compiled for the CPU: nodes, leaves
and triangles a ray, and the bytes that it reads of them. With ``--assembler``, what ``ptxas`` says
of the kernels for each compute capability instead: registers, bytes of local memory, bytes spilled.
Neither is a time.
"""

import argparse
import re
import subprocess
import tempfile
import time
from pathlib import Path

import numpy as np

import raystream as rs
from raystream.bench.ray_sets import make_ray_sets
from raystream.core.rays import RayBatch
from raystream.cuda.bvh.kernels import lay_out
from raystream.cuda.precompile import structure_kernels
from raystream.cuda.structures import kernels_of
from raystream.jit.cuda import CAPABILITIES
from raystream.kernels.hits import HitArrays
from raystream.kernels.ray_source import RaySource, ResultAddresses
from raystream.kernels.tally import COLUMNS, new_tallies

KERNELS = ("wide", "compressed", "binary")

#: Bytes of a node, and of what is tested at once: a block of four triangles, or a triangle.
NODE_BYTES = {"wide": 256, "compressed": 80, "binary": 64}
TRIANGLE_BYTES = {"wide": 40, "compressed": 48, "binary": 48}


def address(array):
    return np.uint64(array.ctypes.data)


def counts_of(tracer, kernel, rays, count):
    """Steps, leaves and tests a ray of some rays, and their first hits."""
    structure = tracer.structure
    queries, (tree, arrays) = kernels_of("bvh", kernel), lay_out(structure, kernel)
    batch = RayBatch(rays.origins, rays.directions, 0.0, rays.t_max)
    rows = np.linspace(0, len(batch) - 1, min(count, len(batch))).astype(int)
    batch = RayBatch(batch.origins[rows], batch.directions[rows], 0.0, rays.t_max)
    source, _kept = RaySource.of(batch.origins, batch.directions, batch.limits)
    status, hits = np.zeros(len(rows), np.uint8), HitArrays.empty(len(rows))
    tallies = new_tallies(len(rows))
    to = ResultAddresses(*map(address, hits), np.uint64(0), address(status))
    for i in map(np.uint64, range(len(rows))):
        queries.first_hit.function(i, source, structure.frame, tree, address(tallies), to)
    del arrays
    return dict(zip(COLUMNS, tallies.mean(axis=0), strict=True)), hits


def print_counts(names, ray_sets, size, count):
    print("scene, rays, kernel: nodes, leaves, triangles, bytes a ray; MB; seconds to lay out")
    for name in names:
        scene = rs.load(name)
        tracer = rs.Tracer(scene)
        sets = make_ray_sets(tracer, scene.camera_for(1.0), (size, size), ray_sets)
        for one in sets:
            first = None
            for kernel in KERNELS:
                started = time.perf_counter()
                arrays = lay_out(tracer.structure, kernel).arrays
                seconds = time.perf_counter() - started
                megabytes = sum(array.nbytes for array in arrays.values()) / 1e6
                met, hits = counts_of(tracer, kernel, one.rays, count)
                first = first or hits
                assert all(a.tobytes() == b.tobytes() for a, b in zip(hits, first, strict=True))
                nodes, leaves, tests = met["steps"], met["leaves"], met["tests"]
                read = nodes * NODE_BYTES[kernel] + tests * TRIANGLE_BYTES[kernel]
                print(
                    f"{name}, {one.name}, {kernel}: {nodes:.1f}, {leaves:.1f}, {tests:.1f}, "
                    f"{read:,.0f}; {megabytes:.1f}; {seconds:.2f}",
                    flush=True,
                )


def print_assembled(queries, launches):
    scene = rs.load("cornell")
    print("kernel, launch, query, capability: registers, bytes of local memory, bytes spilled")
    for kernel in KERNELS:
        for launch in launches:
            entries = structure_kernels("bvh", scene, kernel=kernel, launch=launch)
            for query in queries:
                made, arguments = entries[query]
                for capability in CAPABILITIES:
                    compiled = made.compiled(arguments, capability)
                    name = f"sm_{capability[0]}{capability[1]}"
                    print(f"{kernel}, {launch}, {query}, {name}:", *assembled(compiled, name))


def assembled(compiled, name):
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "kernel.ptx"
        path.write_text(compiled.ptx, encoding="ascii")
        command = ["ptxas", "-v", f"-arch={name}", "-o", str(Path(folder) / "kernel"), str(path)]
        said = subprocess.run(command, capture_output=True, text=True, check=True).stderr
    of_kernel = said[said.index(f"Compiling entry function '{compiled.entry}'") :]
    registers = re.search(r"Used (\d+) registers", of_kernel)
    pattern = r"(\d+) bytes stack frame, (\d+) bytes spill stores, (\d+) bytes spill loads"
    frame, stores, loads = map(int, re.search(pattern, of_kernel).groups())
    return int(registers[1]), frame, stores + loads


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--scenes", nargs="+", default=["sponza", "conference", "bunny"])
    parser.add_argument("--rays", nargs="+", default=["primary", "bounce"])
    parser.add_argument("--size", type=int, default=256, help="of the picture of primary rays")
    parser.add_argument("--count", type=int, default=4000, help="rays of each set")
    parser.add_argument("--assembler", action="store_true")
    parser.add_argument("--queries", nargs="+", default=["first_hit"])
    parser.add_argument("--launches", nargs="+", default=["range"])
    asked = parser.parse_args()
    if asked.assembler:
        print_assembled(asked.queries, asked.launches)
    else:
        print_counts(asked.scenes, asked.rays, asked.size, asked.count)


if __name__ == "__main__":
    main()
