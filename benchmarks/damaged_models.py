"""Half a million damaged model files: does any of them crash a reader?

    python benchmarks/damaged_models.py --files 500000

Takes the tests' tiny models, one for each format and kind, changes up to four bytes in a copy, and
reads it. It must be read, or rejected with a one-line error, within two seconds. Anything else is
printed and counted as a crash. The figures in docs/decisions come from here.
"""

import argparse
import sys
import tempfile
import time
from pathlib import Path

from raystream.scene.scene import Scene

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests"))
from scene.io import tiny
from scene.io.test_fuzz import damaged, outcome


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--files", type=int, default=500_000)
    parser.add_argument("--seed", type=int, default=0)
    asked = parser.parse_args()
    each = -(-asked.files // len(tiny.ALL))
    begin = time.monotonic()
    totals = [0, 0, 0]
    print(f"{'model':12} {'read':>9} {'refused':>9} {'crashed':>9}")
    with tempfile.TemporaryDirectory() as folder:
        for number, (name, content) in enumerate(tiny.ALL.items()):
            counts = [0, 0, 0]
            for changed in damaged(content, asked.seed + 1000 * number, each):
                try:
                    result = outcome(Path(folder) / name, changed)
                except Exception as error:
                    print(f"{name}: {error!r} from {changed!r}")
                    counts[2] += 1
                else:
                    counts[0 if isinstance(result, Scene) else 1] += 1
            print(f"{name:12} {counts[0]:9,} {counts[1]:9,} {counts[2]:9,}", flush=True)
            totals = [a + b for a, b in zip(totals, counts, strict=True)]
    print(f"{'all':12} {totals[0]:9,} {totals[1]:9,} {totals[2]:9,}")
    print(f"{sum(totals):,} files in {time.monotonic() - begin:.0f} s")
    return 1 if totals[2] else 0


if __name__ == "__main__":
    sys.exit(main())
