"""Structures in GPU memory, and the query kernels that traverse them."""

from __future__ import annotations

from functools import cache
from typing import Any

from raystream.cuda.builders.device_resident import DeviceResident, Resident
from raystream.cuda.bvh.kernels import LaidOut, Traced, lay_out, layout_of, traced_as
from raystream.cuda.nested import AddressMap, SharedAllocation
from raystream.cuda.query_kernels import make_kernels
from raystream.jit.cuda import CudaError, Gpu
from raystream.kernels.queries import RayAnswers
from raystream.structures import STRUCTURES, Structure, structure_class
from raystream.structures.base import Nested


def kernels_of(made: Traced, *, is_own: bool = False) -> RayAnswers:
    """The query kernels of a structure.

    Parameters
    ----------
    made : str or type of Structure
        Name of the structure, or its class; see `bvh.kernels.traced_as`.
    is_own : bool
        Whether it has its own layout, which is the CPU's, instead of binary nodes.

    Raises
    ------
    CudaError
        If the structure has no kernels.
    """
    if isinstance(made, str) and made not in STRUCTURES:
        known = ", ".join(map(repr, STRUCTURES))
        raise CudaError(f"device 'cuda': supports the structures {known}, not {made!r}")
    return _made(made, is_own or layout_of(made) is None)


@cache
def _made(made: Traced, is_own: bool) -> RayAnswers:
    held: Any = structure_class(made) if isinstance(made, str) else made
    traced = held if is_own else layout_of(made)
    return make_kernels(traced.traverse, traced.stack_bytes, held.make_searches)


def place(structure: Structure, gpu: Gpu, *, is_own: bool = False) -> Resident:
    """Copy the arrays of a structure's traversal to a device, or return those built there.

    Parameters
    ----------
    structure : Structure
    gpu : Gpu
    is_own : bool
        As in `kernels_of`.

    Raises
    ------
    CudaError
        If there is not enough memory; nothing has been copied then.
    """
    is_own = is_own or layout_of(traced_as(structure)) is None
    if isinstance(structure, DeviceResident) and structure.gpu.number == gpu.number:
        return structure.resident if is_own else structure.laid_out
    laid = lay_out(structure, is_own=is_own)
    return _copied(structure, gpu, laid, structure.nested, is_own)


def place_points(structure: Any, gpu: Gpu, resident: Resident) -> Resident:
    """What searches of points read: the same, but among instances; see `place`."""
    if structure.triangles.instances is None:
        return resident
    laid, nested = lay_out(structure), structure.nested
    arrays = {"nodes": laid.arrays["nodes"], "leaves": structure.placed}
    laid = laid._replace(tree=structure.point_view, arrays=arrays)
    nested = Nested(nested.arrays, {"leaves": nested.fields["objects"]})
    return _copied(structure, gpu, laid, nested, layout_of(traced_as(structure)) is None)


def _copied(
    structure: Structure, gpu: Gpu, laid: LaidOut, nested: Nested, is_own: bool
) -> Resident:
    """Copies of arrays, and the addresses in them; see `place`."""
    tree, given, make_nested = laid
    # Address 0 marks arrays that are absent.
    memory = {name: one for name, one in given.items() if getattr(tree, name, one.size)}
    name = f"{structure.name}, objects{'' if is_own else ', binary nodes'}"
    held = SharedAllocation.known(gpu, name, nested.arrays) if nested.arrays else None
    copies = () if held else make_nested()
    wanted = sum(one.nbytes for one in memory.values()) + SharedAllocation.bytes_of(copies)
    free = gpu.free_byte_count()
    if wanted > free:
        raise CudaError(
            f"device 'cuda': the scene takes {wanted:,} bytes as {structure.name!r}, but "
            f"{gpu.name} has {free:,} free; trace a smaller scene, or use device='cpu'"
        )
    arrays = {name: gpu.upload(f"{structure.name}, {name}", one) for name, one in memory.items()}
    addresses = {name: one.address for name, one in arrays.items()}
    if nested.fields:
        held = held or SharedAllocation(gpu, name, nested.arrays, copies)
        places = *addresses.values(), *held.addresses
        moved = AddressMap((*memory.values(), *nested.arrays), places)
        for name in memory.keys() & nested.fields.keys():
            arrays[name].fill(moved.records(memory[name], nested.fields[name]))
        addresses |= moved.replaced(tree, nested.names)
    gpu.wait()  # other streams do not
    members = {name: at for name, at in addresses.items() if name in tree._fields}
    return Resident(tree._replace(**members), tuple(arrays.values()), held)
