"""Counts of code with known counts: written by hand, or compiled from one line."""

from __future__ import annotations

import numpy as np
import pytest

from extras import need

need("raystream_lab")

from raystream.jit.inspect import compile_code, read_functions
from raystream.jit.simd import load
from raystream_lab.kernels.control_flow import ControlFlow
from raystream_lab.kernels.instructions import (
    InstructionCounts,
    count_instructions,
    count_loop,
)
from raystream_lab.kernels.machine_code import count_machine_code
from raystream_lab.kernels.memory_accesses import Access, accesses, byte_count

#: A record's index leads to a reference, and that to a number: two dependent loads.
CHAIN = """
define i32 @f(ptr %retptr, ptr %arg.stream_0.4, i64 %arg.i, i64 %arg.references, i64 %arg.t) {
  %a = getelementptr float, ptr %arg.stream_0.4, i64 %arg.i
  %b = load i32, ptr %a
  %c = zext i32 %b to i64
  %d = shl i64 %c, 2
  %e = add i64 %arg.references, %d
  %f = inttoptr i64 %e to ptr
  %g = load i32, ptr %f
  %h = zext i32 %g to i64
  %i = add i64 %arg.t, %h
  %j = inttoptr i64 %i to ptr
  %k = load <4 x float>, ptr %j
  %l = fadd <4 x float> %k, %k
  %m = inttoptr i64 %arg.t to ptr
  %n = load float, ptr %m
  store <4 x float> %l, ptr %f
  store float %n, ptr %a
  store i64 0, ptr %retptr
  ret i32 0
}
"""

#: A jump chooses the address to load from; the loaded value goes through local memory.
CHOICE = """
declare void @llvm.assume(i1)
define i32 @f(ptr %arg.stream_0.4, i64 %arg.near, i64 %arg.far) {
  %local = alloca i64
  %a = load float, ptr %arg.stream_0.4
  %known = fcmp une float %a, 1.0
  call void @llvm.assume(i1 %known)
  %b = fcmp ogt float %a, 0.0
  br i1 %b, label %one, label %two
one:
  br label %two
two:
  %c = phi i64 [ 16, %0 ], [ 32, %one ]
  %d = add i64 %arg.near, %c
  %e = inttoptr i64 %d to ptr
  %f = load i64, ptr %e
  store i64 %f, ptr %local
  %g = load i64, ptr %local
  %h = add i64 %g, %arg.far
  %i = inttoptr i64 %h to ptr
  %j = load i8, ptr %i
  %k = inttoptr i64 %f to ptr
  store i8 %j, ptr %k
  ret i32 0
}
"""

#: A loop in a loop, and one beside; the addresses of the inner one go up by themselves.
LOOPS = """
define i32 @f(i64 %arg.at, i64 %arg.count) {
entry:
  br label %outer
outer:
  %i = phi i64 [ 0, %entry ], [ %i2, %outer_end ]
  br label %inner
inner:
  %j = phi i64 [ 0, %outer ], [ %j2, %inner ]
  %p = add i64 %arg.at, %j
  %q = inttoptr i64 %p to ptr
  %x = load i64, ptr %q
  %j2 = add i64 %j, 8
  %more = icmp ult i64 %x, %j2
  br i1 %more, label %inner, label %outer_end
outer_end:
  %i2 = add i64 %i, 1
  %again = icmp ult i64 %i2, %arg.count
  br i1 %again, label %outer, label %beside
beside:
  %k = phi i64 [ 0, %outer_end ], [ %k2, %beside ]
  %k2 = add i64 %k, 1
  %last = icmp ult i64 %k2, %arg.count
  br i1 %last, label %beside, label %done
done:
  ret i32 0
}
"""


def code_of(text):
    return read_functions(text)["f"]


def test_a_chain_of_loads():
    assert accesses(code_of(CHAIN)) == [
        Access("load", "%arg.stream_0.4", 4, False),
        Access("load", "%arg.references", 4, True),
        Access("load", "%arg.t", 16, True),
        Access("load", "%arg.t", 4, False),
        Access("store", "%arg.references", 16, True),
        Access("store", "%arg.stream_0.4", 4, False),
    ]


def test_instructions_by_class():
    """Returns of values, and statements without instructions, are not counted."""
    assert count_instructions(code_of(CHAIN)) == InstructionCounts(
        floating=1, integer=3, conversions=2, addresses=1, loads=4, stores=2
    )
    assert count_instructions(code_of(CHAIN)).total == 13


def test_an_address_that_a_jump_chooses():
    found = accesses(code_of(CHOICE))
    assert found == [
        Access("load", "%arg.stream_0.4", 4, False),
        Access("load", "%arg.near", 8, True),
        Access("store", "local", 8, False),
        Access("load", "local", 8, False),
        Access("load", "several", 1, True),
        Access("store", "memory", 1, True),
    ]


def test_assumptions_are_not_counted():
    counts = count_instructions(code_of(CHOICE))
    assert (counts.comparisons, counts.calls, counts.branches) == (1, 0, 1)


def test_loops():
    instructions = code_of(LOOPS)
    assert ControlFlow(instructions).loops() == [{1, 2, 3}, {4}]
    assert count_loop(instructions) == InstructionCounts(
        integer=3, comparisons=2, loads=1, branches=2
    )
    assert accesses(instructions) == [Access("load", "%arg.at", 8, False)]
    assert count_loop(code_of(CHAIN)) is None


def test_dominators():
    blocks = ControlFlow(code_of(LOOPS))
    count = len(blocks.ends)
    above = [{one for one in range(count) if blocks.dominates(one, k)} for k in range(count)]
    assert above == [set(range(k + 1)) for k in range(count)]
    assert blocks.dominates(1, 5)
    assert not blocks.dominates(5, 1)


@pytest.mark.parametrize(
    ("shown", "size"), [("i1", 1), ("i64", 8), ("float", 4), ("<8 x i32>", 32), ("ptr", 8)]
)
def test_sizes(shown, size):
    assert byte_count(shown) == size


def test_aggregates_have_no_size():
    with pytest.raises(ValueError, match="not a numeric type"):
        byte_count("{ i64, float }")


def chase(at):
    return load(np.float32, at + np.uint64(load(np.uint32, at)))


def test_compiled_python():
    """The same counts each time, of a function whose loads are known."""
    first, second = (compile_code(chase, [np.uint64(0)]) for _ in range(2))
    assert [(one.root, one.is_dependent) for one in accesses(first.instructions)] == [
        ("%arg.at", False),
        ("%arg.at", True),
    ]
    counts = count_instructions(first.instructions)
    assert (counts.loads, counts.stores, counts.calls, counts.floating) == (2, 0, 0, 0)
    assert counts == count_instructions(second.instructions)
    machine = count_machine_code(first.assembly, first.name)
    assert machine == count_machine_code(second.assembly, second.name)
    assert machine > 2


ASSEMBLY = """\
\t.text
g:
\tnop
.Lfunc_end0:
f:
\t.cfi_startproc
\tvmovss\t(%rdi), %xmm0
.LBB1_1:
\tvaddss\t%xmm0, %xmm0, %xmm0  # a remark
\tvpaddd\t%xmm1, %xmm0, %xmm1
\tvucomiss\t%xmm0, %xmm1
\tja\t.LBB1_1
\tjmp\t.LBB1_2
.LBB1_2:
\tpopcntl\t%eax, %eax
\tpopq\t%rbx
\tvshufps\t$0, %xmm0, %xmm0, %xmm0
\tretq
.Lfunc_end1:
h:
\tnop
"""


def test_machine_code():
    assert count_machine_code(ASSEMBLY, "f") == 10


def test_a_missing_function():
    with pytest.raises(ValueError, match="no function 'k'"):
        count_machine_code(ASSEMBLY, "k")
