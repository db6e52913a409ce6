"""What one step of a kernel costs: instructions of its code, and words that it reads and writes.

The counts of Purcell 2002, Table 1, and Foley 2005, Table 3, for our own kernels.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import NamedTuple

from raystream.lab.kernels.instructions import InstructionCounts, count_instructions, count_loop
from raystream.lab.kernels.machine_code import count_machine_code
from raystream.lab.kernels.memory_accesses import Access, accesses
from raystream.lab.kernels.record_code import (
    RecordCode,
    compile_steps,
    first_hit_query,
    make_streams,
)
from raystream.machines.ray_streams import declared_as
from raystream.machines.steps import Steps, steps_of
from raystream.structures import Structure

__all__ = [
    "Fetched",
    "KernelCost",
    "cost_of",
    "kernel_costs",
    "stream_words",
    "words_fetched",
    "words_of",
]

_STREAM = "%arg.stream_"
_WORD = 4


class Fetched(NamedTuple):
    """What a kernel's code reads of one array of the structure, or of the query.

    Attributes
    ----------
    loads : int
        Loads in the code. Not all need be on one way through it.
    words : int
        Words of 4 bytes that these read.
    dependent_loads : int
        Those whose address follows from what was read before, a ray's state included.
    """

    loads: int
    words: int
    dependent_loads: int


@dataclass(frozen=True)
class KernelCost:
    """What a kernel costs for one ray in one pass.

    Attributes
    ----------
    structure, kernel : str
    code : InstructionCounts
        All instructions in the code of one step for one ray: load what is kept of it, compute,
        store. A program without branches runs all of them; this one has branches, and a ray
        takes one way through them. What functions do that it calls is not in it.
    loop : InstructionCounts or None
        Of these, those that each further step in the same pass needs: the body of the loop
        over steps, which keeps a ray's state in registers (Purcell's branching architecture).
        None for kernels that do one step.
    machine : int
        Instructions of the processor for the same code.
    words_in, words_out : dict of str to int
        Words of 4 bytes of the records that a pass reads from and writes to streams for the ray,
        by the stream, as `streams.Counters` counts them: whole records. Without the state,
        of which a pass reads a word for every ray and writes one for this.
    fetched : dict of str to Fetched
        What it reads of the structure, by the array, such as ``"tree.corners"``;
        ``"state"`` where a ray's state holds the address, ``"several"`` where it may be one
        array or another. A word that two ways through the code read is here twice: the
        fetch-only versions of `fetch_only` read each once.
    """

    structure: str
    kernel: str
    code: InstructionCounts
    loop: InstructionCounts | None
    machine: int
    words_in: Mapping[str, int]
    words_out: Mapping[str, int]
    fetched: Mapping[str, Fetched]

    @property
    def fetched_words(self) -> int:
        """Words in the loads of the structure."""
        return sum(one.words for one in self.fetched.values())

    @property
    def dependent_loads(self) -> int:
        """Loads of the structure whose address follows from what was read."""
        return sum(one.dependent_loads for one in self.fetched.values())


def kernel_costs(structure: Structure) -> list[KernelCost]:
    """Count what each kernel of a structure's traversal costs, in the order of a ray's way.

    Compiles each of them, for a few seconds.

    Parameters
    ----------
    structure : Structure
        Its layout and way of searching decide what is compiled. Its triangles do not matter.

    Raises
    ------
    ValueError
        If it is not given as steps.
    """
    steps = steps_of(structure)
    return [cost_of(structure.name, steps, number) for number in range(len(steps.kernels))]


def cost_of(name: str, steps: Steps, number: int) -> KernelCost:
    """Count what a kernel costs.

    Parameters
    ----------
    name : str
        The structure's.
    steps : Steps
    number : int
        Which of its kernels.
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
        name,
        one.name,
        count_instructions(code.instructions),
        loop,
        count_machine_code(code.assembly, code.name),
        words_in,
        words_out,
        words_fetched(record, found),
    )


def words_of(steps: Steps, number: int) -> tuple[dict[str, int], dict[str, int]]:
    """Words of the records that a kernel reads and writes for a ray; the state not counted."""
    streams = make_streams(steps, 1)
    given = declared_as(steps, first_hit_query(), number, streams, streams)
    words = {name: stream.layout.word_count for name, stream in streams.items()}
    outputs = steps.kernels[number].outputs
    return {name: words[name] for name in given["inputs"]}, {name: words[name] for name in outputs}


def stream_words(record: RecordCode, found: Iterable[Access], opcode: str) -> dict[str, int]:
    """Words that code loads from or stores to each stream."""
    words: dict[str, int] = {}
    for one in found:
        if one.opcode == opcode and one.root.startswith(_STREAM):
            name = _name_of(record, one.root)
            words[name] = words.get(name, 0) + -(-one.byte_count // _WORD)
    return words


def words_fetched(record: RecordCode, found: Iterable[Access]) -> dict[str, Fetched]:
    """What code reads that is neither of a stream nor its own."""
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
    """What the compiler's name of an argument stands for; a stream's array has several."""
    if root in ("memory", "several"):
        return {"memory": "state"}.get(root, root)
    argument = root.removeprefix("%arg.")
    return record.names.get(argument) or record.names.get(argument.rpartition(".")[0], root)
