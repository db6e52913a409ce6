"""Structures in a GPU's memory, and the kernels that search them."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from typing import Any, NamedTuple, Protocol, cast, runtime_checkable

from raystream.cuda.bvh.kernels import LAYOUTS, kernel_of, lay_out
from raystream.cuda.options import check_names
from raystream.cuda.query_kernels import QueryKernels, make_kernels
from raystream.cuda.ray_order import in_order
from raystream.jit.cuda import CudaError, DeviceArray, Gpu, PersistentKernel, RangeKernel
from raystream.structures import STRUCTURES, Structure, form_of, structure_class

__all__ = [
    "BuiltOnDevice",
    "Resident",
    "kernel_for",
    "kernels_of",
    "place",
]

#: What launches kernels, by `options.LAUNCHES`.
_LAUNCHERS = {"range": RangeKernel, "persistent": PersistentKernel}

_Launcher = Callable[[Callable[..., Any]], RangeKernel]


def kernels_of(
    name: str, kernel: str = "auto", launch: str = "range", order: str = "given"
) -> QueryKernels:
    """The kernels of a structure.

    Parameters
    ----------
    name : str
        The structure's.
    kernel : str
        Of a BVH, see `bvh.kernels.KERNELS`.
    launch, order : str
        See `options`. Kernels for sorted rays take the address of their order first, see
        `ray_order.in_order`.

    Raises
    ------
    CudaError
        If there are none.
    ValueError
        If there is no kernel, launch or order of that name.
    TypeError
        If a kernel is asked for, and the structure is no BVH.
    """
    if name not in STRUCTURES:
        known = ", ".join(map(repr, STRUCTURES))
        raise CudaError(f"device 'cuda': has the structures {known}, not {name!r}")
    check_names({"launch": launch, "order": order})
    return _made(name, kernel_of(name, kernel), launch, order)


@cache
def _made(name: str, kernel: str | None, launch: str, order: str) -> QueryKernels:
    made, plain = structure_class(name), _LAUNCHERS[launch]
    traverse, stack_bytes = made.traverse, made.stack_bytes
    if kernel is not None:
        traverse, stack_bytes = form_of(name, LAYOUTS).search_of(kernel)
    launcher: _Launcher = plain
    if order == "sorted":
        launcher = lambda function: plain(in_order(function))  # noqa: E731
    return make_kernels(traverse, stack_bytes, launcher, has_duplicates=made.can_have_duplicates)


class Resident(NamedTuple):
    """A structure in a GPU's memory.

    Attributes
    ----------
    tree : NamedTuple
        As `Structure.arrays`, with addresses on the device.
    arrays : tuple of DeviceArray
        What is there: to be kept as long as the tree is used.
    """

    tree: Any
    arrays: tuple[DeviceArray, ...]


@runtime_checkable
class BuiltOnDevice(Protocol):
    """A structure that is in a device's memory already.

    Attributes
    ----------
    gpu : Gpu
    resident : Resident
    """

    gpu: Gpu
    resident: Resident


def _has_layouts(structure: Structure) -> bool:
    """Whether the device has layouts of its own for a structure."""
    return form_of(structure.name, LAYOUTS) is not None


def kernel_for(structure: Structure, gpu: Gpu, kernel: str) -> str:
    """The kernel that ``"auto"`` stands for where a BVH was built on the device: its own layout."""
    is_there = isinstance(structure, BuiltOnDevice) and structure.gpu.number == gpu.number
    return "wide" if kernel == "auto" and is_there and _has_layouts(structure) else kernel


def place(structure: Structure, gpu: Gpu, kernel: str = "auto") -> Resident:
    """Copy what a structure's traversal reads to a device, or find what was built there.

    Parameters
    ----------
    structure : Structure
    gpu : Gpu
    kernel : str
        Of a BVH, as for `kernels_of`.

    Raises
    ------
    CudaError
        If there is no memory for all of it: then nothing was copied.
    """
    is_there = isinstance(structure, BuiltOnDevice) and structure.gpu.number == gpu.number
    if is_there and (kernel == "wide" or not _has_layouts(structure)):
        return cast("BuiltOnDevice", structure).resident
    tree, given = lay_out(structure, kernel)
    # Nothing is at address 0.
    memory = {name: one for name, one in given.items() if getattr(tree, name)}
    wanted, free = sum(one.nbytes for one in memory.values()), gpu.free_byte_count()
    if wanted > free:
        raise CudaError(
            f"device 'cuda': the scene takes {wanted:,} bytes as {structure.name!r}, and "
            f"{gpu.name} has {free:,} free; trace a smaller one, or use device='cpu'"
        )
    arrays = {name: gpu.upload(f"{structure.name}, {name}", one) for name, one in memory.items()}
    gpu.wait()  # for whom other streams do not
    addresses = {name: one.address for name, one in arrays.items()}
    return Resident(tree._replace(**addresses), tuple(arrays.values()))
