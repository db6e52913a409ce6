"""The cost model against hand-computed sums."""

from __future__ import annotations

import pytest

from extras import need

need("raystream_lab")

from raystream_lab.cost_model import Counts, cost, prices, unrolled


def test_an_image_is_priced_by_hand() -> None:
    # 100 rays, 80 in the box, 500 steps, 300 tests, 60 hits, 7 passes; Table 1 of the paper.
    counts = Counts(100, 80, 500, 300, 60, 7)
    found = cost(counts, prices("multipass"))
    assert found.instructions == {
        "generate eye ray": 2800,
        "set up": 80 * 38,
        "step": 500 * 20,
        "intersect": 300 * 41,
        "color": 60 * 36,
    }
    assert found.state["step"] == 500 * 4 * (14 + 9)
    assert found.data == {
        "generate eye ray": 0,
        "set up": 0,
        "step": 500 * 4,
        "intersect": 300 * 40,
        "color": 60 * 84,
    }
    assert found.stencil["passes"] == 700
    assert found.stencil["step"] == 500
    assert found.all_bytes == pytest.approx(sum(found.bytes_by_kernel.values()))


def test_branching_has_no_stencil_and_no_state_between_steps() -> None:
    found = cost(Counts(100, 100, 500, 300, 60), prices("branching"))
    assert sum(found.stencil.values()) == 0
    assert found.state["step"] == found.state["intersect"] == 0
    assert found.all_instructions == 100 * (26 + 22) + 500 * 12 + 300 * 36 + 60 * 25


def test_unrolled_kernels_pay_for_state_once() -> None:
    once, four = prices("multipass")["step"], unrolled("step", 4)
    assert unrolled("step", 1) == once
    assert (four.read, four.written) == (once.read, once.written)
    assert four.memory == 4 * once.memory
    assert four.instructions == once.instructions + 3 * prices("branching")["step"].instructions
