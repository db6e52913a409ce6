"""Open3D's own tests of ray queries, with raystream's adapter in place of its RaycastingScene.

    python benchmarks/open3d_tests.py                                # of the installed version
    python benchmarks/open3d_tests.py .../test_raycasting_scene.py   # of a checkout of Open3D

The tests are run unchanged, and stay outside the repository: without a path, the folder of Open3D's
repository that holds them is fetched from GitHub into a temporary folder. Each test runs twice,
with Open3D's class and with the adapter. Tests that pass with Open3D's but not with the adapter are
listed with the reason. The exit status is 1 if a reason is missing or no longer applies, or if the
adapter was never called.

The tests need more packages than ours: pip install open3d pytest; and the system's libusb-1.0.
"""

import argparse
import subprocess
import sys
import tempfile
from pathlib import Path

from peer_tests import Peer, counted

#: The file, in Open3D's repository. It imports ``open3d_test.py`` of the first folder there.
FOLDER, FILE = "python/test", "t/geometry/test_raycasting_scene.py"

#: Tests that fail with the adapter, and the fault of Open3D that they test.
EXPLAINED: dict[str, str] = {}

#: What the names of the class's queries begin with.
QUERIES = ("cast_", "test_", "count_", "list_", "compute_")


def main():
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("file", nargs="?", type=Path, help=f"{FILE} in a checkout of Open3D")
    parser.add_argument("--run", choices=("Open3D", "adapter"), help=argparse.SUPPRESS)
    args = parser.parse_args()
    if args.run:
        sys.exit(peer().run(args.file.parent, [args.file], args.run))
    if args.file is not None:
        if not args.file.is_file():
            parser.error(f"{args.file}: no such file")
        sys.exit(peer().compare(args.file.resolve()))
    with tempfile.TemporaryDirectory() as scratch:
        sys.exit(peer().compare(clone(Path(scratch)) / FOLDER / FILE))


def peer():
    """Describe Open3D."""
    import open3d

    return Peer("Open3D", open3d.__version__, __file__, EXPLAINED, replace_scene)


def clone(scratch):
    """Fetch the tests of the installed version or, if it has no tag, the newest ones."""
    version = ".".join(peer().version.split("+")[0].split(".")[:3])
    command = ["git", "clone", "--quiet", "--depth", "1", "--filter=blob:none", "--sparse"]
    command += ["https://github.com/isl-org/Open3D", str(scratch)]
    if subprocess.run([*command, "--branch", f"v{version}"]).returncode:
        print(f"no tag v{version}: the newest tests", flush=True)
        subprocess.run(command, check=True)
    subprocess.run(["git", "-C", str(scratch), "sparse-checkout", "set", FOLDER], check=True)
    return scratch


def replace_scene(calls):
    """Replace Open3D's class with the adapter, and count its calls by method."""
    import open3d

    from raystream.adapters.open3d import RaycastingScene

    open3d.t.geometry.RaycastingScene = counted(RaycastingScene, QUERIES, calls)


if __name__ == "__main__":
    main()
