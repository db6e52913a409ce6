"""First query and first picture of an installed raystream, timed; writes picture.png.

The interpreter is that of an environment with the wheel alone. Kernels that RAYSTREAM_CACHE_DIR
lacks are compiled and counted; with ``--ready`` the wheel must have all that these two need.
"""

import os
import sys
import time
from pathlib import Path

start = time.perf_counter()

import numpy as np  # noqa: E402

import raystream as rs  # noqa: E402

if not Path(rs.__file__).is_relative_to(sys.prefix):
    sys.exit(f"raystream was imported from {rs.__file__}, not from the wheel")


def kernels() -> set[str]:
    """Kernels in the cache folder."""
    return {file.stem for file in Path(os.environ["RAYSTREAM_CACHE_DIR"]).rglob("*.nbc")}


def rays(count: int) -> tuple[np.ndarray, np.ndarray]:
    """Make rays from outside the Cornell box into it; some miss."""
    random = np.random.default_rng(1)
    origins = random.uniform(-900.0, -700.0, (count, 3)).astype(np.float32)
    targets = random.uniform(-100.0, 700.0, (count, 3)).astype(np.float32)
    return origins, targets - origins


before = kernels()
origins, directions = rays(1000)
scene = rs.load("cornell")
tracer = rs.Tracer(scene)
found = tracer.first_hit(origins, directions)
query_seconds = time.perf_counter() - start

start = time.perf_counter()
rs.render(scene, mode="raycast", size=(320, 240)).save("picture.png")
picture_seconds = time.perf_counter() - start

compiled = sorted(kernels() - before)
if "--ready" in sys.argv and compiled:
    sys.exit(f"the wheel lacks kernels: {', '.join(compiled)}")

expected = rs.Tracer(scene, "brute").first_hit(origins, directions)
for name in ("t", "prim_id"):
    np.testing.assert_array_equal(getattr(found, name), getattr(expected, name))
is_hit = np.isfinite(expected.t)
np.testing.assert_array_equal(tracer.any_hit(origins, directions), is_hit)
assert 0 < is_hit.sum() < len(is_hit)
assert Path("picture.png").stat().st_size > 1000

version = ".".join(map(str, sys.version_info[:3]))
print(
    f"Python {version}: first query after {query_seconds:.1f} s, "
    f"first picture after another {picture_seconds:.1f} s, "
    f"{len(compiled)} kernels added to the cache; queries agree with brute force"
)
