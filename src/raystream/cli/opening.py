"""From a scene's name to a tracer, with the time that it took."""

from __future__ import annotations

import time as clock
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

from raystream.cli.bars import Bars
from raystream.cli.keywords import blame_options
from raystream.cli.messages import BadInputError, refuse

if TYPE_CHECKING:
    from raystream.tracer import Tracer

__all__ = ["Source", "Stopwatch", "choose_threads", "open_tracer", "rays_per_second"]


@dataclass
class Stopwatch:
    """Seconds that each step of a command took, by its name."""

    seconds: dict[str, float] = field(default_factory=dict)

    @contextmanager
    def measure(self, step: str) -> Iterator[None]:
        """Time a block, without the seconds of steps inside it."""
        started, others = clock.perf_counter(), sum(self.seconds.values())
        yield
        inside = sum(self.seconds.values()) - others
        self.seconds[step] = clock.perf_counter() - started - inside

    def rounded(self) -> dict[str, float]:
        """The seconds for JSON, to microseconds."""
        return {step: round(seconds, 6) for step, seconds in self.seconds.items()}

    def text(self) -> str:
        """The seconds for people."""
        return ", ".join(f"{step} {seconds:.2f} s" for step, seconds in self.seconds.items())


@dataclass(frozen=True)
class Source:
    """The scene that a command is asked for.

    Attributes
    ----------
    name : str
        A file, a built-in scene, a sample, or a saved structure (``.npz``).
    structure : str or None
        None leaves the choice to the command line: the saved one, else ``"bvh"``.
    device : str
    time : float
    triangles : int or None
    options : mapping
        Options of `Tracer`.
    """

    name: str
    structure: str | None = None
    device: str = "cpu"
    time: float = 0.0
    triangles: int | None = None
    options: Mapping[str, Any] = field(default_factory=lambda: MappingProxyType({}))


def choose_threads(count: int | None) -> None:
    """Set the number of threads, or check what ``RAYSTREAM_THREADS`` says."""
    from raystream.jit.threads import set_thread_count, thread_count

    if count is not None:
        set_thread_count(count)
    with refuse(ValueError):
        thread_count()


def open_tracer(source: Source, bars: Bars, watch: Stopwatch) -> Tracer:
    """Load a scene and build its structure, or load a structure.

    Parameters
    ----------
    source : Source
    bars : Bars
    watch : Stopwatch
        Gets "load" and "build".

    Raises
    ------
    FileFormatError
        If there is no such scene, or it cannot be used.
    BadInputError
        If an option does not suit the scene.
    """
    from raystream.tracer import Tracer

    if source.name.lower().endswith(".npz"):
        return _open_structure(source, bars, watch)
    from raystream.scene.load import load

    # Without these, a ValueError would be a reader's bug.
    asks = source.time != 0.0 or source.triangles is not None or ":" in source.name
    kinds = (ValueError,) if asks else ()
    with watch.measure("load"), bars.step("loading"):
        with refuse(*kinds):
            scene = load(source.name, time=source.time, triangles=source.triangles)
        _ = scene.triangles  # made when first asked for; the build is timed without
    with (
        watch.measure("build"),
        bars.step("building") as progress,
        blame_options(source.options),
    ):
        return Tracer(
            scene, source.structure or "bvh", source.device, progress=progress, **source.options
        )


def _open_structure(source: Source, bars: Bars, watch: Stopwatch) -> Tracer:
    from raystream.machines.devices import device_of
    from raystream.tracer import Tracer

    if source.time != 0.0 or source.triangles is not None:
        raise BadInputError(f"{source.name}: a saved structure has neither --time nor --triangles")
    machines = device_of(source.device).machines
    with blame_options(source.options):
        machine = source.options.get("machine", machines.names[0])
        own = machines.own_options(machine, source.options)
    for name in source.options:
        if name not in ("machine", "counters", *own):
            raise BadInputError(
                f"{source.name}: a saved structure is built already, and has no option {name!r}; "
                "it takes those of the machine"
            )
    with watch.measure("load"), bars.step("loading"), blame_options(source.options):
        tracer = Tracer.load(source.name, device=source.device, **source.options)
    watch.seconds["build"] = 0.0
    if source.structure not in (None, tracer.structure.name):
        raise BadInputError(
            f"{source.name}: holds a {tracer.structure.name!r} structure, "
            f"not {source.structure!r}; leave --structure out"
        )
    return tracer


def rays_per_second(count: int, seconds: float) -> float:
    """Millions of rays in a second, to four digits; 0 for no rays."""
    return float(f"{count / max(seconds, 1e-9) / 1e6:.4g}")
