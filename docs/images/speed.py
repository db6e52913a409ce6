"""Draws speed.svg, beside it, from the stored result of ``raystream bench``."""

from pathlib import Path

from raystream.bench.chart import draw_speeds
from raystream.bench.results import read_result

IMAGES = Path(__file__).resolve().parent
RESULT = IMAGES.parent / "performance" / "result.json"

if __name__ == "__main__":
    drawn = draw_speeds(read_result(RESULT))
    (IMAGES / "speed.svg").write_text(f"{drawn}\n", encoding="utf-8")
