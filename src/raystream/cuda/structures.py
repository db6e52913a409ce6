"""Structures in GPU memory, and the query kernels that traverse them."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from typing import Any, NamedTuple, Protocol, cast, runtime_checkable

from raystream.cuda.bvh.kernels import LAYOUTS, Traced, kernel_of, lay_out, traced_as
from raystream.cuda.nested import AddressMap, SharedAllocation
from raystream.cuda.options import check_names
from raystream.cuda.query_kernels import QueryKernels, make_kernels
from raystream.cuda.ray_order import reordered
from raystream.jit.cuda import CudaError, DeviceArray, Gpu, PersistentKernel, RangeKernel
from raystream.structures import STRUCTURES, Structure, form_of, structure_class

__all__ = [
    "BuiltOnDevice",
    "Resident",
    "kernel_for",
    "kernels_of",
    "place",
]

#: Classes of kernels, by `options.LAUNCHES`.
_LAUNCHERS = {"range": RangeKernel, "persistent": PersistentKernel}

_Launcher = Callable[[Callable[..., Any]], RangeKernel]


def kernels_of(
    made: Traced, kernel: str = "auto", launch: str = "range", order: str = "given"
) -> QueryKernels:
    """The query kernels of a structure.

    Parameters
    ----------
    made : str or type of Structure
        Name of the structure, or its class; see `bvh.kernels.traced_as`.
    kernel : str
        For a BVH, see `bvh.kernels.KERNELS`.
    launch, order : str
        See `options`. Kernels for sorted rays take the address of the order first, see
        `ray_order.reordered`.

    Raises
    ------
    CudaError
        If the structure has no kernels.
    ValueError
        If a kernel, launch or order is unknown.
    TypeError
        If a kernel is named for a structure other than a BVH.
    """
    if isinstance(made, str) and made not in STRUCTURES:
        known = ", ".join(map(repr, STRUCTURES))
        raise CudaError(f"device 'cuda': has the structures {known}, not {made!r}")
    check_names({"launch": launch, "order": order})
    return _made(made, kernel_of(made, kernel), launch, order)


@cache
def _made(made: Traced, kernel: str | None, launch: str, order: str) -> QueryKernels:
    held: Any = structure_class(made) if isinstance(made, str) else made
    plain = _LAUNCHERS[launch]
    launcher: _Launcher = plain
    if order == "sorted":
        launcher = lambda function: plain(reordered(function))  # noqa: E731
    if held.precision == "float64":
        # Here, not above: few tracers are in float64.
        from raystream.cuda.float64.kernels import make_float64_kernels

        return make_float64_kernels(held.searches, launcher)
    traverse, stack_bytes = held.traverse, held.stack_bytes
    if kernel is not None and isinstance(made, str):
        traverse, stack_bytes = form_of(made, LAYOUTS).search_of(kernel)
    return make_kernels(traverse, stack_bytes, launcher, held.make_searches)


class Resident(NamedTuple):
    """A structure in GPU memory.

    Attributes
    ----------
    tree : NamedTuple
        As `Structure.arrays`, with addresses on the device.
    arrays : tuple of DeviceArray
        The memory; keep it as long as the tree is used.
    nested : SharedAllocation or None
        And that of `Structure.nested`.
    """

    tree: Any
    arrays: tuple[DeviceArray, ...]
    nested: SharedAllocation | None = None


@runtime_checkable
class BuiltOnDevice(Protocol):
    """A structure that was built in GPU memory.

    Attributes
    ----------
    gpu : Gpu
    resident : Resident
    """

    gpu: Gpu
    resident: Resident


def _has_layouts(structure: Structure) -> bool:
    """Whether the structure has other layouts on the device."""
    return kernel_of(traced_as(structure), "auto") is not None


def kernel_for(structure: Structure, gpu: Gpu, kernel: str) -> str:
    """Resolve ``"auto"``: a BVH that was built on the device keeps its layout."""
    is_there = isinstance(structure, BuiltOnDevice) and structure.gpu.number == gpu.number
    return "wide" if kernel == "auto" and is_there and _has_layouts(structure) else kernel


def place(structure: Structure, gpu: Gpu, kernel: str = "auto") -> Resident:
    """Copy the arrays of a structure's traversal to a device, or return those built there.

    Parameters
    ----------
    structure : Structure
    gpu : Gpu
    kernel : str
        For a BVH, as in `kernels_of`.

    Raises
    ------
    CudaError
        If there is not enough memory; nothing has been copied then.
    """
    is_there = isinstance(structure, BuiltOnDevice) and structure.gpu.number == gpu.number
    if is_there and (kernel == "wide" or not _has_layouts(structure)):
        return cast("BuiltOnDevice", structure).resident
    tree, given = lay_out(structure, kernel)
    nested = structure.nested
    # Address 0 marks arrays that are absent.
    memory = {name: one for name, one in given.items() if getattr(tree, name, one.size)}
    held = SharedAllocation.known(gpu, nested.arrays) if nested.arrays else None
    wanted = sum(one.nbytes for one in memory.values())
    wanted += 0 if held else SharedAllocation.bytes_of(nested.arrays)
    free = gpu.free_byte_count()
    if wanted > free:
        raise CudaError(
            f"device 'cuda': the scene takes {wanted:,} bytes as {structure.name!r}, and "
            f"{gpu.name} has {free:,} free; trace a smaller one, or use device='cpu'"
        )
    arrays = {name: gpu.upload(f"{structure.name}, {name}", one) for name, one in memory.items()}
    addresses = {name: one.address for name, one in arrays.items()}
    if nested.fields:
        held = held or SharedAllocation(gpu, f"{structure.name}, objects", nested.arrays)
        places = *addresses.values(), *held.addresses
        moved = AddressMap((*memory.values(), *nested.arrays), places)
        for name in memory.keys() & nested.fields.keys():
            arrays[name].fill(moved.records(memory[name], nested.fields[name]))
        addresses |= moved.replaced(tree, nested.names)
    gpu.wait()  # other streams do not
    members = {name: at for name, at in addresses.items() if name in tree._fields}
    return Resident(tree._replace(**members), tuple(arrays.values()), held)
