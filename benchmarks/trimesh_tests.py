"""trimesh's own tests of ray queries, with raystream's adapter in place of its intersectors.

    python benchmarks/trimesh_tests.py                # tests of the installed version, from PyPI
    python benchmarks/trimesh_tests.py ~/trimesh      # the same, with models of this checkout

The tests are run unchanged, and stay outside the repository: the source distribution is downloaded
into a temporary folder. It has the tests, but neither the module `generic` that they import nor
their models. These come from a checkout of trimesh's repository, which is cloned from GitHub if no
checkout is given. Each test runs twice, with trimesh's intersectors and with the adapter; the
classes `ray_pyembree.RayMeshIntersector` and `ray_triangle.RayMeshIntersector` are replaced before
the tests are imported. Tests that pass with trimesh's intersectors but not with the adapter are
listed with the reason. The exit status is 1 if a reason is missing or no longer applies, or if the
adapter was never called.

The tests need more packages than ours: pip install trimesh embreex rtree scipy networkx shapely
manifold3d pytest.
"""

import argparse
import collections
import json
import os
import shutil
import subprocess
import sys
import tarfile
import tempfile
from importlib.metadata import version
from pathlib import Path

#: Files of tests that cast rays.
PATTERNS = ("test_ray*.py", "test_proximity.py", "test_mutate.py", "test_thickness.py")

#: Tests that fail with the adapter, and the fault of trimesh that they test.
EXPLAINED: dict[str, str] = {}


def main():
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("checkout", nargs="?", type=Path, help="trimesh's repository")
    parser.add_argument("--run", choices=("trimesh", "adapter"), help=argparse.SUPPRESS)
    args = parser.parse_args()
    if args.run:
        sys.exit(run(args.checkout, args.run))
    with tempfile.TemporaryDirectory() as scratch:
        folder = download(Path(scratch))
        complete(folder, args.checkout or clone(Path(scratch)))
        sys.exit(compare(folder))


def download(scratch):
    """Fetch and unpack the source distribution."""
    command = [sys.executable, "-m", "pip", "download", "--quiet", "--no-deps"]
    command += ["--no-binary", ":all:", "--dest", str(scratch), f"trimesh=={version('trimesh')}"]
    subprocess.run(command, check=True)
    (archive,) = scratch.glob("trimesh-*.tar.gz")
    with tarfile.open(archive) as files:
        files.extractall(scratch, filter="data")
    return scratch / archive.name.removesuffix(".tar.gz")


def clone(scratch):
    """Fetch trimesh's repository at the installed version."""
    folder = scratch / "checkout"
    address = "https://github.com/mikedh/trimesh"
    command = ["git", "clone", "--quiet", "--depth", "1", "--branch", version("trimesh")]
    subprocess.run([*command, address, str(folder)], check=True)
    return folder


def complete(folder, checkout):
    """Add the files that the distribution lacks; existing files are not replaced."""
    for path in sorted((checkout / "tests").rglob("*")):
        place = folder / path.relative_to(checkout)
        if path.is_file() and not place.exists() and not path.name.startswith("test_"):
            place.parent.mkdir(parents=True, exist_ok=True)
            shutil.copy(path, place)
    if not (folder / "models").exists():
        shutil.copytree(checkout / "models", folder / "models")


def compare(folder):
    """Run the tests twice, print both results, and check the explanations."""
    results = {}
    for who in ("trimesh", "adapter"):
        command = [sys.executable, __file__, str(folder), "--run", who]
        environment = {**os.environ, "PYTHONDONTWRITEBYTECODE": "1"}
        done = subprocess.run(command, env=environment, capture_output=True, text=True)
        lines = done.stdout.splitlines()
        if not lines or not lines[-1].startswith("{"):
            print(done.stdout, done.stderr, sep="\n")
            return 1
        results[who] = json.loads(lines[-1])
    tests, calls = results["adapter"]["tests"], results["adapter"]["calls"]
    print(f"trimesh {version('trimesh')}, tests in {folder}\n")
    print(f"{'test':75} {'trimesh':>8} {'adapter':>8}")
    for name, (outcome, _) in tests.items():
        own = results["trimesh"]["tests"].get(name, ["", ""])[0]
        print(f"{name:75} {own:>8} {outcome:>8}")
    counts = collections.Counter(outcome for outcome, _ in tests.values())
    print(f"\nwith the adapter: {dict(counts)}; its methods were called: {calls}")
    failed = {name for name, (outcome, _) in tests.items() if outcome == "failed"}
    both = {name for name in failed if results["trimesh"]["tests"].get(name, [""])[0] == "failed"}
    for name in sorted(both):
        print(f"\n{name} also fails with trimesh's intersectors:\n    {last_line(tests[name][1])}")
    failed -= both
    for name in sorted(failed):
        print(f"\n{name}: {EXPLAINED.get(name, 'NOT EXPLAINED')}\n{tests[name][1]}")
    stale = set(EXPLAINED) & set(tests) - failed
    for name in sorted(stale):
        print(f"\n{name} passes: its explanation no longer applies")
    skipped = {name: text for name, (outcome, text) in tests.items() if outcome == "skipped"}
    for name, text in skipped.items():
        print(f"\n{name} was skipped: {text}")
    is_right = counts["passed"] and calls and not stale and failed <= set(EXPLAINED)
    return 0 if is_right else 1


def last_line(text):
    """The error of a test: the last line that pytest marks with E."""
    errors = [line[1:].strip() for line in text.splitlines() if line.startswith("E ")]
    return errors[-1] if errors else text


def run(folder, who):
    """Run the tests in this process; the last line printed is the results as JSON."""
    import pytest

    calls = collections.Counter()
    if who == "adapter":
        replace_intersectors(calls)
    results = Results()
    files = sorted(path for pattern in PATTERNS for path in (folder / "tests").glob(pattern))
    if not files:
        print(f"{folder}: no tests/test_ray*.py")
        return 1
    options = [
        "-q",
        "-p",
        "no:cacheprovider",
        "--override-ini",
        "addopts=",
        "--rootdir",
        str(folder),
    ]
    os.chdir(folder)
    status = pytest.main([*options, *map(str, files)], plugins=[results])
    print(json.dumps({"tests": results.tests, "calls": dict(calls), "status": int(status)}))
    return 0


class Results:
    """A plugin that records the outcome of each test."""

    def __init__(self):
        self.tests = {}

    def pytest_runtest_logreport(self, report):
        name = report.nodeid.rpartition("/")[2]
        if report.when == "call" or report.outcome != "passed":
            text = report.longreprtext if report.failed else str(report.longrepr or "")
            self.tests[name] = (report.outcome, text[-2000:])

    def pytest_collectreport(self, report):
        if report.outcome != "passed":
            self.tests[report.nodeid] = (report.outcome, str(report.longrepr)[-2000:])


def replace_intersectors(calls):
    """Replace trimesh's intersectors with the adapter, and count its calls by method."""
    import types

    import trimesh

    from raystream.adapters.trimesh import RayMeshIntersector

    class Counted(RayMeshIntersector):
        def __getattribute__(self, name):
            if name.startswith(("intersects", "contains")):
                calls[name] += 1
            return super().__getattribute__(name)

    if not trimesh.ray.has_embree:
        module = types.ModuleType("trimesh.ray.ray_pyembree")
        sys.modules[module.__name__] = trimesh.ray.ray_pyembree = module
        trimesh.ray.has_embree = True
    trimesh.ray.ray_pyembree.RayMeshIntersector = Counted
    trimesh.ray.ray_triangle.RayMeshIntersector = Counted


if __name__ == "__main__":
    main()
