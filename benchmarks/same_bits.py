"""Whether two versions of raystream give the same bits: answers of every kind, and images.

    python benchmarks/same_bits.py
    python benchmarks/same_bits.py --record before.json
    ... edit, or check out another version ...
    python benchmarks/same_bits.py --compare before.json

Records a digest of each query's answers, over all columns and six kinds of rays, for each scene
and each structure and kernel: plain triangles, instances, worlds, spheres, height fields and
float64; closest points and inside tests, filters, programs and masks, updates, ray files, physics
and lines of sight; and images (``bits_cases.py``, ``bits_kinds.py``, ``bits_images.py``). By
default it compares with ``same_bits.json``, prints the digests that differ, and exits with 1 if
there are any. ``--only`` runs single parts.

Models in the folder ``RAYSTREAM_SCENES`` are left out where it is not set, also when comparing. A
part whose optional package is missing is left out when recording; comparing needs it.

Digests of attenuation and LiDAR depend on the vector instructions that NumPy uses for exponentials
and sines, and those of view factors on the processor's kernels for matrix products; no others did
when these were changed. Built-in scenes may depend on NumPy's version, and images of models on
Pillow's: ``same_bits.json`` says where and with which versions it was recorded. Where a scene or
its rays differ, its "inputs" do.
"""

import argparse
import hashlib
import importlib.metadata
import json
import platform
import sys
import time
import warnings
from pathlib import Path

import bits_cases
import bits_images
import bits_kinds
import numpy as np

import raystream as rs

RECORDED = Path(__file__).with_suffix(".json")

PARTS = {**bits_cases.PARTS, **bits_kinds.PARTS, "images": bits_images.images}

#: Rays of a scene for the default tracer.
RAYS = 250_000


def environment():
    """The processor and the versions with which digests are recorded."""
    processor = platform.processor() or platform.machine()
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
        names = [line.partition(":")[2] for line in lines if line.startswith("model name")]
        processor = names[0].strip() if names else processor
    except OSError:
        pass
    packages = ("numpy", "numba", "llvmlite", "pillow")
    versions = {name: importlib.metadata.version(name) for name in packages}
    return {"processor": processor, "python": platform.python_version(), **versions}


def add(whole, array):
    """Add an array to a digest; all NaNs are equal."""
    array = np.asarray(array)
    if array.dtype.kind == "f":
        array = np.where(np.isnan(array), array.dtype.type(np.nan), array)
    whole.update(f"{array.dtype} {array.shape}".encode())
    whole.update(np.ascontiguousarray(array).tobytes())


def digests_of(answers):
    """Digests of a case's answers, by query."""
    wholes = {}
    for query, arrays in answers():
        whole = wholes.setdefault(query, hashlib.sha256())
        for array in arrays:
            add(whole, array)
    return {query: whole.hexdigest()[:12] for query, whole in wholes.items()}


def digests(names, count, is_comparing):
    """Run parts: digests by case and query, and the cases without their scenes."""
    found, absent = {}, []
    for name in names:
        start, before = time.perf_counter(), sum(map(len, found.values()))
        try:
            for case, answers in PARTS[name](count):
                if answers is None:
                    print(f"{case}: left out, see RAYSTREAM_SCENES")
                    absent.append(case)
                    continue
                try:
                    found[case] = digests_of(answers)
                except Exception as error:
                    if not is_comparing:
                        raise
                    print(f"{case}: {type(error).__name__}: {error}")
        except ImportError as error:
            print(f"{name}: left out: {error}")
        seconds, after = time.perf_counter() - start, sum(map(len, found.values()))
        print(f"{name}: {after - before:,} digests, {seconds:.0f} s", flush=True)
    return found, absent


def compare(recorded, found, absent):
    """Print the digests that differ or are missing; returns their number."""
    count = 0
    for case, queries in recorded["digests"].items():
        name, scene = case.split(": ")[:2]
        if f"{name}: {scene}" in absent:
            continue
        now = found.get(case, {})
        lists = {
            "differs": [
                query for query in queries if now.get(query, "") not in ("", queries[query])
            ],
            "missing": [query for query in queries if query not in now],
        }
        for what, names in lists.items():
            count += len(names)
            if names:
                print(f"{what}: {case}: {', '.join(names)}")
            if what == "differs" and case.endswith(": inputs") and names:
                print("  the scene or its rays differ, so all its answers may")
    new = sum(
        len(queries.keys() - recorded["digests"].get(case, {})) for case, queries in found.items()
    )
    total = sum(map(len, recorded["digests"].values()))
    print(f"{count:,} of {total:,} differ or are missing; {new:,} were not recorded")
    if count:
        for name, value in environment().items():
            before = recorded["recorded with"].get(name)
            if value != before:
                print(f"  recorded with {name} {before}, now {value}")
    return count


def save(path, count, found):
    """Write digests, a line for each case."""
    head = json.dumps({"recorded with": environment(), "rays": count})
    lines = [f"{json.dumps(case)}: {json.dumps(queries)}" for case, queries in found.items()]
    path.write_text(head[:-1] + ',\n"digests": {\n' + ",\n".join(lines) + "\n}}\n")


def main():
    """Record digests, or compare them."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    group = parser.add_mutually_exclusive_group()
    group.add_argument("--record", type=Path, metavar="FILE")
    group.add_argument("--compare", type=Path, metavar="FILE", default=RECORDED)
    parser.add_argument("--only", choices=PARTS, nargs="+", help="parts to run [default: all]")
    parser.add_argument(
        "--rays",
        type=int,
        default=RAYS,
        help="rays per scene when recording [default: %(default)s]",
    )
    asked = parser.parse_args()
    warnings.simplefilter("ignore", rs.RaystreamWarning)
    names = asked.only or list(PARTS)
    if asked.record:
        found, _ = digests(names, asked.rays, is_comparing=False)
        save(asked.record, asked.rays, found)
        return 0
    recorded = json.loads(asked.compare.read_text())
    recorded["digests"] = {
        case: queries
        for case, queries in recorded["digests"].items()
        if case.partition(":")[0] in names
    }
    found, absent = digests(names, recorded["rays"], is_comparing=True)
    return 1 if compare(recorded, found, absent) else 0


if __name__ == "__main__":
    sys.exit(main())
