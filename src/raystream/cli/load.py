"""Load a scene by name and build its tracer, with timing."""

from __future__ import annotations

import time as clock
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from raystream.cli.bars import Bars
from raystream.cli.console import BadInputError, refuse
from raystream.cli.option_groups import options_given
from raystream.cli.options import SceneOptions
from raystream.cli.tracer_options import TracerArguments

if TYPE_CHECKING:
    from raystream.scene.scene import Scene
    from raystream.tracer import Tracer


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
        self.add(step, clock.perf_counter() - started - inside)

    def add(self, step: str, seconds: float) -> None:
        """Add seconds to a step, which count for no step around it."""
        self.seconds[step] = self.seconds.get(step, 0.0) + seconds

    def rounded(self) -> dict[str, float]:
        """Return the seconds rounded to microseconds, for JSON."""
        return {step: round(seconds, 6) for step, seconds in self.seconds.items()}

    def text(self) -> str:
        """Format the seconds for the console."""
        return ", ".join(f"{step} {seconds:.2f} s" for step, seconds in self.seconds.items())


def choose_threads(count: int | None) -> None:
    """Set the number of threads, or validate ``RAYSTREAM_THREADS``."""
    from raystream.jit.threads import set_thread_count, thread_count

    if count is not None:
        set_thread_count(count)
    with refuse(ValueError):
        thread_count()


def open_tracer(
    name: str,
    loading: SceneOptions,
    chosen: TracerArguments,
    bars: Bars,
    watch: Stopwatch,
    loaded: Callable[[Scene], None] | None = None,
) -> Tracer:
    """Load a scene and build its structure, or load a saved structure.

    Parameters
    ----------
    name : str
        A file, a built-in scene, a sample, or a saved structure (``.npz``).
    loading : SceneOptions
    chosen : TracerArguments
    bars : Bars
    watch : Stopwatch
        Records "load" and "build".
    loaded : callable, optional
        Called with the scene; for a model, before anything is computed from it.

    Raises
    ------
    FileFormatError
        If the scene does not exist or cannot be read.
    BadInputError
        If an option does not apply to the scene.
    """
    from raystream.tracer import Tracer

    if name.lower().endswith(".npz"):
        if options_given(loading):
            raise BadInputError(f"{name}: --time and --triangles do not apply to saved structures")
        tracer = _open_structure(name, chosen, bars, watch)
        if loaded is not None:
            loaded(tracer.scene)
        return tracer
    from raystream.scene.load import load

    # Without these arguments, a ValueError would be a bug in a reader.
    kinds = (ValueError,) if options_given(loading) or ":" in name else ()
    with watch.measure("load"), bars.step("loading"):
        with refuse(*kinds):
            scene = load(name, time=loading.time, triangles=loading.triangles)
        if loaded is not None:
            loaded(scene)
        _ = scene.triangles  # computed on first use; excluded from the build time
    with watch.measure("build"), bars.step("building") as progress, chosen.blamed():
        return Tracer(
            scene, chosen.structure or "bvh", chosen.device, progress=progress, **chosen.options
        )


def _open_structure(name: str, chosen: TracerArguments, bars: Bars, watch: Stopwatch) -> Tracer:
    from raystream.tracer import Tracer
    from raystream.tracer.devices import device_of

    machines = device_of(chosen.device).machines
    with chosen.blamed():
        machine = chosen.options.get("machine", machines.names[0])
        own = machines.own_options(machine, chosen.options)
    for option in chosen.options:
        if option not in ("machine", "counters", *own):
            raise BadInputError(
                f"{name}: the structure is already built, so option {option!r} does not "
                "apply; only options of the machine do"
            )
    with watch.measure("load"), bars.step("loading"), chosen.blamed():
        tracer = Tracer.load(name, device=chosen.device, **chosen.options)
    watch.seconds["build"] = 0.0
    if chosen.structure not in (None, tracer.structure.name):
        raise BadInputError(
            f"{name}: holds a {tracer.structure.name!r} structure, "
            f"not {chosen.structure!r}; omit --structure"
        )
    return tracer


def rays_per_second(count: int, seconds: float) -> float:
    """Return millions of rays per second, to four digits; 0 for no rays."""
    return float(f"{count / max(seconds, 1e-9) / 1e6:.4g}")


def triangle_figures(scene: Scene) -> dict[str, int]:
    """Numbers of triangles; and if there are instances, of these and of all their triangles."""
    figures = {"triangles": scene.triangle_count}
    if scene.placements is not None:
        figures["instances"] = len(scene.placements)
        triangles: Any = scene.triangles
        figures["instanced_triangles"] = int(triangles.first_ids[-1])
    return figures


def triangle_text(scene: Scene) -> str:
    """The numbers of `triangle_figures` in words."""
    figures = triangle_figures(scene)
    if "instances" not in figures:
        return f"{figures['triangles']:,} triangles"
    return (
        f"{figures['instanced_triangles']:,} triangles in {figures['instances']:,} instances of "
        f"{figures['triangles']:,}"
    )
