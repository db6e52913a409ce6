"""First use of a command on a machine: compile its kernels on several cores."""

from __future__ import annotations

import contextlib
import threading
import time as clock
from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

from raystream.cli.console import write_note
from raystream.cli.load import Stopwatch
from raystream.cli.tracer_options import TracerArguments
from raystream.core.cache_folder import is_writable, kernel_folder
from raystream.jit.compile_events import listening
from raystream.jit.threads import thread_count

if TYPE_CHECKING:
    from raystream.scene.scene import Scene

#: Seconds of compilation before a note is printed.
DELAY = 1.0

#: Maximum helper processes: a command's kernels do not keep more busy.
MAX_HELPERS = 3


@contextlib.contextmanager
def compiling(
    task: str, chosen: TracerArguments, stopwatch: Stopwatch
) -> Iterator[KernelCompilation]:
    """During the block, report compilation that takes more than a second.

    When the first kernel is missing, all kernels of the task are compiled, on as many cores as
    there are threads.

    Parameters
    ----------
    task : str
        One of `jit.warm.TASKS`, or a part of one.
    chosen : TracerArguments
        Kernels of other structures and devices than the default are compiled when first needed.
    stopwatch : Stopwatch
        Records a step "compile", if anything is compiled.

    Yields
    ------
    KernelCompilation
        Its `task` may be replaced by a more exact one before the first kernel is needed.
    """
    is_listed = chosen.structure in (None, "bvh") and chosen.device == "cpu"
    listener = KernelCompilation(task, is_listed, stopwatch)
    try:
        with listening(listener):
            yield listener
    finally:
        listener.stop()


def render_task(mode: str, scene: Scene, has_sky: bool = False) -> str:
    """The task whose kernels an image of a scene needs; `has_sky`: with an image of the sky."""
    is_plain = not (
        has_sky
        or any(m.textures or m.roughness is not None for m in scene.materials)
        or any(getattr(light, "image", None) is not None for light in scene.lights)
    )
    return f"render-{mode}" if is_plain else f"render-{mode}:full"


class KernelCompilation:
    """Reports slow compilation; see `jit.compile_events.CompileListener`."""

    def __init__(self, task: str, is_listed: bool, stopwatch: Stopwatch) -> None:
        self.task = task
        self._is_listed = is_listed
        self._stopwatch = stopwatch
        self._helpers: list[Any] = []
        self._lock = threading.Lock()
        self._has_begun = False
        self._started: dict[str, float] = {}  # by the thread that the stopwatch measures
        self._seconds = 0.0
        self._has_told = False

    def begin(self, kernel: str) -> None:
        """Compile the task's other kernels, when the first one is missing."""
        with self._lock:
            is_first, self._has_begun = not self._has_begun, True
        if is_first and self._is_listed:
            self._compile_all(self.task, kernel)
        if threading.current_thread() is threading.main_thread():
            self._started[kernel] = clock.perf_counter()

    def end(self, kernel: str, seconds: float) -> None:
        """Print a note once compilation has taken a second, and take it off the step's time."""
        started = self._started.pop(kernel, None)
        if started is not None:
            self._stopwatch.add("compile", clock.perf_counter() - started)
        with self._lock:
            self._seconds += seconds
            is_time = self._seconds > DELAY
        if is_time:
            self._tell("kernels")

    def stop(self) -> None:
        """Stop the helper processes: the command needs nothing more."""
        if self._helpers:
            from raystream.jit.warm import stop_helpers

            stop_helpers(self._helpers)

    def _compile_all(self, task: str, kernel: str) -> None:
        """Compile a task's kernels except one, which the caller is about to compile."""
        from raystream.jit import warm

        left = warm.missing(warm.entries_of(task))
        if sum(entry.seconds for entry in left) > DELAY:
            self._tell(f"{len(left)} kernel{'s' if len(left) > 1 else ''}")
        count = min(thread_count() - 1, MAX_HELPERS, len(left) - 1)
        if not is_writable(kernel_folder()):
            count = 0  # this process would not get their kernels
        with contextlib.suppress(OSError):  # no more processes: compile in this one alone
            self._helpers = warm.start_helpers(task, count)
        with self._stopwatch.measure("compile"):
            warm.compile_kernels([entry for entry in left if entry.kernel != kernel])

    def _tell(self, what: str) -> None:
        with self._lock:
            is_news, self._has_told = not self._has_told, True
        if is_news:
            place = kernel_folder()
            kept = "cached" if is_writable(place) else "cannot be cached"
            write_note(f"compiling {what} on first use; {kept} in {place}")
