"""DeviceScheduler: counts rays by state on the device, and chooses the next kernel there.

In Purcell 2002, section 3.2, the host waits for the counts of each pass. Here dozens of passes are
encoded before any has run: each has the draws of every kernel, with indirect arguments that a
compute shader writes, so that only those of one kernel draw.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from raystream.graphics.adapters import OpenDevice
from raystream.graphics.buffers import Buffer, uniform, whole
from raystream.graphics.errors import GraphicsError
from raystream.graphics.pipelines import Program, bind, compute_pipeline
from raystream.graphics.shader_source import shader_source
from raystream.graphics.streams.kernel import FragmentKernel
from raystream.graphics.streams.textures import StencilTexture, StreamShape
from raystream.graphics.structures.base import numbers
from raystream.machines.records import RayState
from raystream.machines.schedulers import SCHEDULERS

_LAYOUT = ("uint", "scatter", "uniform", "gather")

#: Words of Schedule: arguments of eight draws, 16 counts, then latest, pass_count, active_count,
#: stuck_count.
_COUNTS_AT, _LATEST_AT, _HEAD_WORDS = 32, 48, 52

#: Most kernels, see schedule.wgsl.
_MOST_KERNELS = 8

_GROUP_SIZE = 16
_NO_KERNEL = 2**32 - 1


class ScheduledPasses(NamedTuple):
    """Passes that ran since the record began.

    Attributes
    ----------
    passes : list of (int, int)
        The number of a kernel, and the rays that it ran on.
    active_count : int
        Active rays before the last of them.
    stuck_count : int
        Rays that wait for more room, see `RayState.NO_ROOM`.
    """

    passes: list[tuple[int, int]]
    active_count: int
    stuck_count: int


class DeviceScheduler:
    """Chooses kernels on the device.

    Parameters
    ----------
    opened : OpenDevice
    kernels : sequence of FragmentKernel
    scheduler : str
        A name of `machines.schedulers.SCHEDULERS`.
    share : float
        For ``"threshold"``.
    most_passes : int
        Passes between two calls of `read`.
    spawns : bool
        Whether shading spawns rays, see `machines.schedulers.Queues`.

    Attributes
    ----------
    arguments : GPUBuffer
        Indirect arguments of the kernels' draws.
    """

    def __init__(
        self,
        opened: OpenDevice,
        kernels: Sequence[FragmentKernel],
        scheduler: str,
        share: float,
        most_passes: int,
        spawns: bool = False,
    ) -> None:
        if len(kernels) > _MOST_KERNELS:
            raise GraphicsError(f"multipass: {len(kernels)} kernels, but room for {_MOST_KERNELS}")
        self._opened = opened
        self._share = share
        self._spawns = spawns
        self._scheduler = SCHEDULERS.index(scheduler)
        self._states: list[int] = [int(one.state) for one in kernels]
        tests = sum(
            1 << number for number, one in enumerate(kernels) if one.state == RayState.INTERSECTING
        )
        states = self._states + [0] * (_MOST_KERNELS - len(kernels))
        self._kernels = uniform(opened, numbers(len(kernels), tests, 0, 0, *states))
        self._least = Buffer(opened, "thresholds")
        self._most_passes = most_passes
        self.arguments = _schedule_buffer(opened, 4 * (_HEAD_WORDS + 2 * most_passes))
        self._group: Any = None
        self._groups = (0, 0)

    def begin(self, count: int, shape: StreamShape, stencil: StencilTexture) -> None:
        """Prepare for a chunk of rays."""
        # In float64, as schedulers on the host compare, so that both choose the same kernels.
        least = np.ceil(self._share * np.arange(count + 1, dtype=np.float64)).astype(np.uint32)
        self._least.reserve(least.nbytes)
        self._least.write(least)
        head = np.zeros(_HEAD_WORDS, np.uint32)
        head[_LATEST_AT] = _NO_KERNEL
        self._opened.device.queue.write_buffer(self.arguments, 0, head)
        resources = [
            stencil.states,
            whole(self.arguments),
            whole(self._kernels),
            self._least.binding,
        ]
        self._group = bind(self._opened, _LAYOUT, resources, is_compute=True)
        self._groups = -(-shape.width // _GROUP_SIZE), -(-shape.height // _GROUP_SIZE)

    def encode(self, encoder: Any, kernels: Sequence[int]) -> None:
        """Encode counting and choosing; kernels other than these do not run yet."""
        encoded = sum(1 << number for number in kernels)
        run = encoder.begin_compute_pass()
        run.set_bind_group(0, self._group)
        run.set_pipeline(self._pipeline("count_states", 0))
        run.dispatch_workgroups(*self._groups)
        run.set_pipeline(self._pipeline("decide", encoded))
        run.dispatch_workgroups(1)
        run.end()

    def clear_record(self, encoder: Any) -> None:
        """Clear the record of passes."""
        encoder.clear_buffer(self.arguments, 4 * (_LATEST_AT + 1), 4)

    def read(self, most: int) -> ScheduledPasses:
        """Read the record, of at most `most` passes."""
        size = 4 * (_HEAD_WORDS + 2 * min(most, self._most_passes))
        memory = self._opened.device.queue.read_buffer(self.arguments, 0, size)
        words: NDArray[np.uint32] = np.frombuffer(memory, np.uint32)
        pass_count, active_count, stuck_count = words[_LATEST_AT + 1 : _LATEST_AT + 4].tolist()
        ran = words[_HEAD_WORDS:].reshape(-1, 2)[:pass_count].tolist()
        return ScheduledPasses(
            [(kernel, count) for kernel, count in ran], active_count, stuck_count
        )

    def _pipeline(self, entry: str, encoded: int) -> Any:
        name = "multipass/schedule.wgsl"
        constants = {
            "SCHEDULER": float(self._scheduler),
            "SPAWNS": float(self._spawns),
            "ENCODED": float(encoded),
        }
        program = Program(shader_source(name), entry, [_LAYOUT], constants)
        return compute_pipeline(self._opened, name, program)


def _schedule_buffer(opened: OpenDevice, byte_count: int) -> Any:
    import wgpu

    usage = wgpu.BufferUsage
    return opened.device.create_buffer(
        size=byte_count,
        usage=usage.STORAGE | usage.INDIRECT | usage.COPY_SRC | usage.COPY_DST,
    )
