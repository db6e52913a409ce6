"""The cost of one kernel step: instructions of its code, and words read and written.

The figures of Purcell 2002, Table 1, and Foley 2005, Table 3, for our own kernels.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import NamedTuple

from raystream.machines.ray_streams import declared_as
from raystream.machines.steps import Steps, steps_of
from raystream.structures import Structure
from raystream_lab.kernels.instructions import InstructionCounts, count_instructions, count_loop
from raystream_lab.kernels.machine_code import count_machine_code
from raystream_lab.kernels.memory_accesses import Access, accesses
from raystream_lab.kernels.record_code import (
    RecordCode,
    compile_steps,
    first_hit_query,
    make_streams,
)

_STREAM = "%arg.stream_"
_WORD = 4


class Fetched(NamedTuple):
    """The reads of a kernel's code from one array of the structure or the query.

    Attributes
    ----------
    loads : int
        Loads in the code, over all branches.
    words : int
        Words of 4 bytes read by these.
    dependent_loads : int
        Loads whose address depends on an earlier read, including a ray's state.
    """

    loads: int
    words: int
    dependent_loads: int


@dataclass(frozen=True)
class KernelCost:
    """The cost of a kernel for one ray in one pass.

    Attributes
    ----------
    kernel : str
    code : InstructionCounts
        All instructions in the code of one step for one ray: load its state, compute, store. A
        program without branches runs all of them; with branches, a ray takes one path. Called
        functions are not included.
    loop : InstructionCounts or None
        The instructions of each further step in the same pass: the body of the loop over steps,
        which keeps a ray's state in registers (Purcell's branching architecture). None for kernels
        with a single step.
    machine : int
        Instructions of the processor for the same code.
    words_in, words_out : dict of str to int
        Words of 4 bytes of the records that a pass reads and writes for the ray, by stream, as
        `streams.Counters` counts them: whole records, without the state word that a pass reads for
        every ray and writes for this one.
    used_in, used_out : int
        Words of them that the code reads and writes; a field that it passes on is neither.
    fetched : dict of str to Fetched
        Reads from the structure by array, such as ``"tree.corners"``; ``"state"`` where a ray's
        state holds the address, ``"several"`` if the array is ambiguous. A word read on two paths
        counts twice: the versions of `fetch_only` read each word once.
    """

    kernel: str
    code: InstructionCounts
    loop: InstructionCounts | None
    machine: int
    words_in: Mapping[str, int]
    words_out: Mapping[str, int]
    used_in: int
    used_out: int
    fetched: Mapping[str, Fetched]

    @property
    def fetched_words(self) -> int:
        """Words loaded from the structure."""
        return sum(one.words for one in self.fetched.values())

    @property
    def dependent_loads(self) -> int:
        """Loads from the structure whose address depends on an earlier read."""
        return sum(one.dependent_loads for one in self.fetched.values())


def kernel_costs(structure: Structure) -> list[KernelCost]:
    """Count the cost of each kernel of a structure's traversal, in the order of `Steps.kernels`.

    Compiles each kernel, which takes a few seconds.

    Parameters
    ----------
    structure : Structure
        Its layout and traversal determine the code; its triangles do not matter.

    Raises
    ------
    ValueError
        If it has no steps.
    """
    steps = steps_of(structure)
    return [cost_of(steps, number) for number in range(len(steps.kernels))]


def cost_of(steps: Steps, number: int) -> KernelCost:
    """Count the cost of one kernel.

    Parameters
    ----------
    steps : Steps
    number : int
        Index of the kernel.
    """
    one = steps.kernels[number]
    record = compile_steps(steps, number)
    code = record.code
    loop = None
    if one.limit:
        loop = count_loop(compile_steps(steps, number, is_looping=True).code.instructions)
    words_in, words_out = words_of(steps, number)
    found = accesses(code.instructions)
    return KernelCost(
        one.name,
        count_instructions(code.instructions),
        loop,
        count_machine_code(code.assembly, code.name),
        words_in,
        words_out,
        _words_used(record, found, "load"),
        _words_used(record, found, "store"),
        words_fetched(record, found),
    )


def words_of(steps: Steps, number: int) -> tuple[dict[str, int], dict[str, int]]:
    """Words of the records that a kernel reads and writes per ray, without the state."""
    streams = make_streams(steps, 1)
    given = declared_as(steps, first_hit_query(), number, streams, streams)
    words = {name: stream.layout.word_count for name, stream in streams.items()}
    outputs = steps.kernels[number].outputs
    return {name: words[name] for name in given["inputs"]}, {name: words[name] for name in outputs}


def stream_words(record: RecordCode, found: Iterable[Access], opcode: str) -> dict[str, int]:
    """Words loaded from or stored to each stream."""
    words: dict[str, int] = {}
    for one in found:
        if one.opcode == opcode and one.root.startswith(_STREAM):
            name = _name_of(record, one.root)
            words[name] = words.get(name, 0) + -(-one.byte_count // _WORD)
    return words


def _words_used(record: RecordCode, found: Iterable[Access], opcode: str) -> int:
    words = stream_words(record, found, opcode)
    return sum(count for name, count in words.items() if name != "state")


def words_fetched(record: RecordCode, found: Iterable[Access]) -> dict[str, Fetched]:
    """Reads that are neither from a stream nor from local memory."""
    result: dict[str, Fetched] = {}
    for one in found:
        is_own = one.root.startswith(_STREAM) or one.root in ("local", "table")
        if one.opcode != "load" or is_own:
            continue
        name = _name_of(record, one.root)
        old = result.get(name, Fetched(0, 0, 0))
        result[name] = Fetched(
            old.loads + 1,
            old.words + -(-one.byte_count // _WORD),
            old.dependent_loads + one.is_dependent,
        )
    return result


def _name_of(record: RecordCode, root: str) -> str:
    """Map the compiler's name of an argument to ours; a stream's array has several."""
    if root in ("memory", "several"):
        return {"memory": "state"}.get(root, root)
    argument = root.removeprefix("%arg.")
    return record.names.get(argument) or record.names.get(argument.rpartition(".")[0], root)
