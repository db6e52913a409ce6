"""Kernels over streams give the same results on CUDA as on the CPU."""

from __future__ import annotations

from collections import namedtuple
from types import SimpleNamespace

import numpy as np
import pytest

from extras import need

need("numba_cuda")

from raystream.core.errors import LoopLimitError
from raystream.cuda.streams import StreamMemory
from raystream.jit.cuda import CAPABILITIES, is_simulated
from raystream.streams import INDEX, Counters, Kernel, Stream, While

PARTICLE = np.dtype([("place", np.float32, 3), ("kind", np.uint8), ("is_old", np.bool_)])

COUNT = 10

Table = namedtuple("Table", "weights, offset")


def particles(rng):
    values = np.zeros(COUNT, PARTICLE)
    values["place"] = rng.random((COUNT, 3))
    values["kind"] = np.arange(COUNT) % 3
    values["is_old"] = np.arange(COUNT) % 2 == 0
    return values


def move(particle, i, weights, cube, old, offset, table, speeds):
    """Everything that a kernel may have: records, indices, gather arrays, constants."""
    if i == 4:
        return None
    x, y, z = particle.place
    x += np.float32(weights[i, -1] + cube[1, i % 3, -2] + len(old) + speeds[1])
    y += np.float32(table.weights[particle.kind] * table.offset)
    z += old[(i + 1) % old.shape[0]].place[2]
    return (x, y, z), particle.kind + offset, not particle.is_old


def kernel_of(rng):
    """A kernel over some particles, which reads what it writes, and these."""
    stream = Stream(particles(rng), name="particles")
    weights = rng.random((COUNT, 4))
    made = Kernel(
        move,
        inputs={"particle": stream, "i": INDEX},
        outputs=stream,
        gathers={
            "old": stream,
            "weights": weights,
            "cube": rng.random((2, 3, 4)),
            "table": Table(np.array([1.0, 2.0, 3.0], np.float32), np.float32(0.5)),
        },
        constants={"offset": np.uint8(1), "speeds": (0.25, 0.5)},
    )
    return made, stream


def test_kernels_do_what_they_do_on_the_cpu(gpu):
    (ours, here), (theirs, there) = (kernel_of(np.random.default_rng(5)) for _ in range(2))
    memory = StreamMemory(gpu)
    made = memory.kernel(ours)
    for _ in range(2):
        assert made.execute() == theirs.execute() == COUNT - 1
    assert memory.read(here).array.tobytes() == there.array.tobytes()


def count_down(number, total):
    """Of numbers above 0; two outputs."""
    return (number - 1, total + number) if number > 0 else None


@pytest.mark.parametrize("where", [None, "odd", "few"])
def test_conditions_and_loops(gpu, where):
    def ask(run):
        number = Stream(np.arange(COUNT) % 4, name="number")
        total = Stream(np.zeros(COUNT, np.float32), name="total")
        mask = Stream(np.arange(COUNT) % 2 == 1, name="mask")
        conditions = {None: None, "odd": mask, "few": number < 3}
        made = Kernel(
            count_down,
            inputs={"number": number, "total": total},
            outputs=[number, total],
            where=conditions[where],
        )
        counters = Counters()
        return run(made, counters, (number, total))

    def on_cpu(made, counters, streams):
        few = np.arange(COUNT) > 6
        written = made.execute(counters=counters), made.execute(where=few), made.loop()
        return written, counters.passes, [one.array.tolist() for one in streams]

    def on_gpu(made, counters, streams):
        memory = StreamMemory(gpu)
        there = memory.kernel(made)
        few = np.arange(COUNT) > 6
        written = there.execute(counters=counters), there.execute(where=few), there.loop()
        return written, counters.passes, [memory.read(one).array.tolist() for one in streams]

    assert ask(on_gpu) == ask(on_cpu)


def test_kernels_are_steps_of_chains(gpu):
    number = Stream(np.arange(COUNT), name="number")
    total = Stream(np.zeros(COUNT), name="total")
    made = Kernel(count_down, inputs={"number": number, "total": total}, outputs=[number, total])
    memory = StreamMemory(gpu)
    there = memory.kernel(made)
    assert While(there).run().rounds == COUNT
    assert not memory.read(number).array.any()
    memory.write(Stream(np.arange(COUNT)))  # another one
    assert there.execute() == 0
    number.assign(np.arange(COUNT))
    memory.write(number)
    with pytest.raises(LoopLimitError):
        there.loop(limit=3)


def test_what_cannot_be_done_is_said(gpu):
    memory = StreamMemory(gpu)
    made, _ = kernel_of(np.random.default_rng(5))
    with pytest.raises(TypeError, match="does not count gather reads"):
        memory.kernel(made).execute(counters=Counters())
    with pytest.raises(TypeError, match="cannot be complex"):
        memory.write(Stream(np.zeros(3, np.complex64)))


@pytest.mark.skipif(is_simulated(), reason="the simulator has no compiler")
def test_kernels_compile_without_a_device():
    class Nowhere:
        """Returns addresses that are never read."""

        number = 0

        def upload(self, *_of):
            return SimpleNamespace(address=np.uint64(0))

        empty = upload

    made, _ = kernel_of(np.random.default_rng(5))
    kernel, arguments = StreamMemory(Nowhere()).kernel(made).prepared(None)
    ptx = kernel.compiled((np.uint64(0), *arguments), CAPABILITIES[0]).ptx
    assert "match.any.sync" in ptx
    assert "fma" not in ptx
