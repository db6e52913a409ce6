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
import shutil
import subprocess
import sys
import tarfile
import tempfile
from importlib.metadata import version
from pathlib import Path

from peer_tests import Peer, counted

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
        files = [path for pattern in PATTERNS for path in (args.checkout / "tests").glob(pattern)]
        sys.exit(peer().run(args.checkout, sorted(files), args.run))
    with tempfile.TemporaryDirectory() as scratch:
        folder = download(Path(scratch))
        complete(folder, args.checkout or clone(Path(scratch)))
        sys.exit(peer().compare(folder))


def peer():
    """Describe trimesh."""
    return Peer("trimesh", version("trimesh"), __file__, EXPLAINED, replace_intersectors)


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


def replace_intersectors(calls):
    """Replace trimesh's intersectors with the adapter, and count its calls by method."""
    import types

    import trimesh

    from raystream.adapters.trimesh import RayMeshIntersector

    kind = counted(RayMeshIntersector, ("intersects", "contains"), calls)
    if not trimesh.ray.has_embree:
        module = types.ModuleType("trimesh.ray.ray_pyembree")
        sys.modules[module.__name__] = trimesh.ray.ray_pyembree = module
        trimesh.ray.has_embree = True
    trimesh.ray.ray_pyembree.RayMeshIntersector = kind
    trimesh.ray.ray_triangle.RayMeshIntersector = kind


if __name__ == "__main__":
    main()
