"""The context of experiments: settings, scenes, structures and measurements."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager
from functools import cached_property
from pathlib import Path
from typing import Any

from raystream.jit.threads import Progress
from raystream.tracer import Tracer
from raystream_lab.devices import MACHINES, DeviceFacts, open_facts
from raystream_lab.results import Result
from raystream_lab.store import Store
from raystream_lab.views import View, view

#: Divisor of the width and height of images on a device that is simulated by software.
_SOFTWARE_SHARE = 4

#: Called with the title of a measurement; returns a context that gives a progress callback, or
#: None.
Watch = Callable[[str], AbstractContextManager[Progress | None]]


class Runner:
    """Runs experiments and stores their measurements.

    Parameters
    ----------
    folder : Path
        Folder of the images.
    store : Store
    size : int, optional
        Width and height of images [default: those of each paper].
    quick : bool
        Smaller images, scenes and sweeps, as a smoke test.
    watch : Watch, optional
        Notified of each measurement.
    device : str
        One of `devices.DEVICES`: what traces the rays of experiments that run on several.

    Attributes
    ----------
    folder, quick, device
        As given.
    progress : callable or None
        Progress callback of the current measurement; pass it to long queries.
    """

    def __init__(
        self,
        folder: Path,
        store: Store,
        *,
        size: int | None = None,
        quick: bool = False,
        watch: Watch | None = None,
        device: str = "cpu",
    ) -> None:
        self.folder = folder
        self.quick = quick
        self.device = device
        self.progress: Progress | None = None
        self._store = store
        self._size = size
        self._watch = watch or _no_progress
        self._experiment = ""
        self._used: set[str] = set()
        self._views: dict[str, View] = {}
        self._tracers: dict[str, Tracer] = {}

    def run(self, name: str, experiment: Callable[[Runner], Result]) -> Result:
        """Run an experiment under its name.

        Releases the scenes and structures of the previous one.
        """
        self._experiment = name
        self._used.clear()
        self._views.clear()
        self._tracers.clear()
        return experiment(self)

    def size(self, usual: int) -> int:
        """Width and height of square images: the user's size, or the paper's.

        Parameters
        ----------
        usual : int
            The paper's.
        """
        if self._size is not None:
            return self._size
        return max(usual // 8, 64) if self.quick else usual

    def device_size(self, usual: int) -> int:
        """The same for images that the device traces: a quarter where that is software.

        Raises
        ------
        RaystreamError
            If the device is not available.
        """
        if self._size is None and not self.quick and self.facts.is_software:
            return max(usual // _SOFTWARE_SHARE, 64)
        return self.size(usual)

    @cached_property
    def facts(self) -> DeviceFacts:
        """The device, opened.

        Raises
        ------
        RaystreamError
            If it is not available.
        """
        return open_facts(self.device)

    @property
    def fast_machine(self) -> str:
        """The device's machine that traces a ray from start to end in one run."""
        return self.machines[0]

    @property
    def machines(self) -> tuple[str, ...]:
        """The device's machines, `fast_machine` first; see `devices.MACHINES`."""
        return MACHINES[self.device]

    def measure(self, name: str, function: Callable[[], Any], *, shared: bool = False) -> Any:
        """Run a measurement, unless its result is already stored.

        Parameters
        ----------
        name : str
            Unique within an experiment, including parameters.
        function : callable
            Returns a JSON value.
        shared : bool
            Share the result with the paper's other experiments under this name.

        Returns
        -------
        JSON value
        """
        owner = self._experiment.partition("-")[0] if shared else self._experiment
        key = f"{owner}: {name}"
        if key not in self._store.values:
            started = time.perf_counter()
            with self._watch(key) as self.progress:
                value = function()
            self.progress = None
            self._store.save(key, value, time.perf_counter() - started)
        self._used.add(key)
        return self._store.values[key]

    def view(self, name: str) -> View:
        """A scene with a camera, by its name in tables; see `views`.

        Raises
        ------
        RaystreamError
            If it needs a model that is not available.
        """
        if name not in self._views:
            self._views[name] = view(name, quick=self.quick)
        return self._views[name]

    def tracer(self, view: View, structure: str, **options: Any) -> Tracer:
        """A tracer for a view's scene, on the device; the last one is cached.

        Parameters
        ----------
        view : View
        structure : str
        **options
            As for `Tracer`.
        """
        key = f"{view.scene_name} {structure} {sorted(options.items())}"
        if key not in self._tracers:
            self._tracers.clear()
            self._tracers[key] = Tracer(
                view.scene, structure, self.device, progress=self.progress, **options
            )
        return self._tracers[key]

    @property
    def seconds(self) -> float:
        """Seconds that the measurements of the last experiment took."""
        return sum(self._store.seconds[key] for key in self._used)


@contextlib.contextmanager
def _no_progress(title: str) -> Iterator[None]:  # noqa: ARG001 - as every Watch
    yield None
