"""Devices and machines as typed options of `Tracer`."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Any, Literal

from raystream.core.options import Options, Range

#: Names of schedulers, the default first.
SCHEDULERS = ("threshold", "naive", "most-work", "double")

_AtLeastOne = Annotated[int | None, Range(1)]


@dataclass(frozen=True, kw_only=True)
class DeviceOptions(Options):
    """A device and its options; `raystream.register_device` adds devices."""


@dataclass(frozen=True, kw_only=True)
class MachineOptions(Options):
    """A machine: how a structure is traversed."""


@dataclass(frozen=True, kw_only=True)
class Cpu(DeviceOptions):
    """The CPU's cores, without options; see `raystream.set_thread_count`."""

    name = "cpu"


@dataclass(frozen=True, kw_only=True)
class Cuda(DeviceOptions):
    """An NVIDIA GPU (``pip install raystream[cuda]``).

    Parameters
    ----------
    gpu : int
        Its CUDA device number.
    build : {"host", "device"}
        Where structures are built.
    rays_at_once : int, optional
        Maximum number of rays traced together.

    Raises
    ------
    ValueError
        If an option is out of range.
    TypeError
        If a number is not an integer.
    """

    name = "cuda"
    gpu: Annotated[int, Range(0)] = 0
    build: Literal["host", "device"] = "host"
    rays_at_once: _AtLeastOne = None


@dataclass(frozen=True, kw_only=True)
class Graphics(DeviceOptions):
    """A GPU through Vulkan, Metal or Direct3D 12 (``pip install raystream[graphics]``).

    Parameters
    ----------
    adapter : str, optional
        Part of the adapter's name [default: ``RAYSTREAM_ADAPTER``, else the best one].
    loop : {"device", "queries"}
        With the multipass machine, what chooses the next kernel: the device, or the host with
        occlusion queries.
    max_passes : int, optional
        With the multipass machine, the maximum number of passes of a query.
    memory : {"buffers", "textures"}
        With the multipass machine, where shaders read the scene: in storage buffers, or in
        textures, as the papers' programs did.
    rays_at_once : int, optional
        Maximum number of rays traced together.

    Raises
    ------
    ValueError
        If a number is below 1.
    TypeError
        If it is not an integer.
    """

    name = "graphics"
    adapter: str | None = None
    loop: Literal["device", "queries"] = "device"
    max_passes: _AtLeastOne = None
    memory: Literal["buffers", "textures"] = "buffers"
    rays_at_once: _AtLeastOne = None


@dataclass(frozen=True, kw_only=True)
class Branching(MachineOptions):
    """Each thread traces one ray from start to end; without options."""

    name = "branching"


@dataclass(frozen=True, kw_only=True)
class Compute(MachineOptions):
    """Each invocation of a compute shader traces one ray from start to end: `Graphics` only."""

    name = "compute"


@dataclass(frozen=True, kw_only=True)
class Multipass(MachineOptions):
    """All rays advance step by step, in passes (Purcell 2002, section 2.2); not on `Cuda`.

    Parameters
    ----------
    scheduler : {"threshold", "naive", "most-work", "double"} or Scheduler
        How the kernel of the next pass is chosen; see `raystream.machines.Scheduler`.
    threshold : float
        For ``"threshold"``: fraction of the active rays, 0 to 1, that must wait for an
        intersection before one runs.
    traversal_steps, intersections : int
        Steps from cell to cell or node to node, and triangles (in trees: blocks of up to four)
        that a ray tests, per pass.
    compaction : bool
        Shade rays whose search has ended, and remove them from the streams, whenever they make up
        half of the rays there. Not supported by `Graphics`.

    Raises
    ------
    ValueError
        If an option is out of range.
    TypeError
        If a value is not a number, or not an integer where one is needed.
    """

    name = "multipass"
    scheduler: Any = "threshold"
    threshold: Annotated[float, Range(0, 1)] = 0.2
    traversal_steps: Annotated[int, Range(1)] = 1
    intersections: Annotated[int, Range(1)] = 1
    compaction: bool = False

    def __post_init__(self) -> None:
        super().__post_init__()
        if not isinstance(self.scheduler, str):
            if not callable(getattr(self.scheduler, "choose", None)):
                raise TypeError(
                    f"scheduler: expected a name or a Scheduler, got {self.scheduler!r:.60}"
                )
        elif self.scheduler == "optimal":
            raise ValueError(
                "scheduler: 'optimal' is a bound, not a schedule: see counters.passes.optimal_count"
            )
        elif self.scheduler not in SCHEDULERS:
            known = ", ".join(map(repr, SCHEDULERS))
            raise ValueError(f"scheduler: expected one of {known}, got {self.scheduler!r}")


#: Machines by name.
MACHINES: dict[str, type[MachineOptions]] = {
    one.name: one for one in (Branching, Multipass, Compute)
}
