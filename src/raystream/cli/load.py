"""Load a scene by name and build its tracer, with timing."""

from __future__ import annotations

import time as clock
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

from raystream.cli.bars import Bars
from raystream.cli.console import BadInputError, refuse
from raystream.cli.tracer_options import blame_options

if TYPE_CHECKING:
    from raystream.tracer import Tracer

__all__ = ["Source", "Stopwatch", "choose_threads", "open_tracer", "rays_per_second"]


@dataclass
class Stopwatch:
    """Seconds spent in each step of a command, by step name."""

    seconds: dict[str, float] = field(default_factory=dict)

    @contextmanager
    def measure(self, step: str) -> Iterator[None]:
        """Time a block, excluding steps nested in it."""
        started, others = clock.perf_counter(), sum(self.seconds.values())
        yield
        inside = sum(self.seconds.values()) - others
        self.seconds[step] = clock.perf_counter() - started - inside

    def rounded(self) -> dict[str, float]:
        """Return the seconds rounded to microseconds, for JSON."""
        return {step: round(seconds, 6) for step, seconds in self.seconds.items()}

    def text(self) -> str:
        """Format the seconds for the console."""
        return ", ".join(f"{step} {seconds:.2f} s" for step, seconds in self.seconds.items())


@dataclass(frozen=True)
class Source:
    """The scene that a command works on.

    Attributes
    ----------
    name : str
        A file, a built-in scene, a sample, or a saved structure (``.npz``).
    structure : str or None
        None: that of a saved structure, else ``"bvh"``.
    device : str
    time : float
    triangles : int or None
    options : mapping
        `Tracer` options.
    """

    name: str
    structure: str | None = None
    device: str = "cpu"
    time: float = 0.0
    triangles: int | None = None
    options: Mapping[str, Any] = field(default_factory=lambda: MappingProxyType({}))


def choose_threads(count: int | None) -> None:
    """Set the number of threads, or validate ``RAYSTREAM_THREADS``."""
    from raystream.jit.threads import set_thread_count, thread_count

    if count is not None:
        set_thread_count(count)
    with refuse(ValueError):
        thread_count()


def open_tracer(source: Source, bars: Bars, watch: Stopwatch) -> Tracer:
    """Load a scene and build its structure, or load a saved structure.

    Parameters
    ----------
    source : Source
    bars : Bars
    watch : Stopwatch
        Records "load" and "build".

    Raises
    ------
    FileFormatError
        If the scene does not exist or cannot be read.
    BadInputError
        If an option does not apply to the scene.
    """
    from raystream.tracer import Tracer

    if source.name.lower().endswith(".npz"):
        return _open_structure(source, bars, watch)
    from raystream.scene.load import load

    # Without these arguments, a ValueError would be a bug in a reader.
    asks = source.time != 0.0 or source.triangles is not None or ":" in source.name
    kinds = (ValueError,) if asks else ()
    with watch.measure("load"), bars.step("loading"):
        with refuse(*kinds):
            scene = load(source.name, time=source.time, triangles=source.triangles)
        _ = scene.triangles  # computed on first use; excluded from the build time
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
        raise BadInputError(
            f"{source.name}: --time and --triangles do not apply to saved structures"
        )
    machines = device_of(source.device).machines
    with blame_options(source.options):
        machine = source.options.get("machine", machines.names[0])
        own = machines.own_options(machine, source.options)
    for name in source.options:
        if name not in ("machine", "counters", *own):
            raise BadInputError(
                f"{source.name}: the structure is already built, so option {name!r} does not "
                "apply; only options of the machine do"
            )
    with watch.measure("load"), bars.step("loading"), blame_options(source.options):
        tracer = Tracer.load(source.name, device=source.device, **source.options)
    watch.seconds["build"] = 0.0
    if source.structure not in (None, tracer.structure.name):
        raise BadInputError(
            f"{source.name}: holds a {tracer.structure.name!r} structure, "
            f"not {source.structure!r}; omit --structure"
        )
    return tracer


def rays_per_second(count: int, seconds: float) -> float:
    """Return millions of rays per second, to four digits; 0 for no rays."""
    return float(f"{count / max(seconds, 1e-9) / 1e6:.4g}")
