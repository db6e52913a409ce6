"""Runner: what experiments share, which is settings, scenes, structures, measurements."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager
from pathlib import Path
from typing import Any

from raystream.jit.threads import Progress
from raystream.lab.results import Result
from raystream.lab.store import Store
from raystream.lab.views import View, view
from raystream.tracer import Tracer

__all__ = ["Runner", "Watch"]

#: Called with what begins; its context lasts as long, and gives a callback for progress, or None.
Watch = Callable[[str], AbstractContextManager[Progress | None]]


class Runner:
    """Where experiments run.

    Parameters
    ----------
    folder : Path
        For pictures.
    store : Store
    size : int, optional
        Width and height of pictures, instead of each paper's own.
    quick : bool
        Smaller pictures, scenes and sweeps, to see that everything works.
    watch : Watch, optional
        Told what is measured.

    Attributes
    ----------
    folder, quick
        As given.
    progress : callable or None
        Of the measurement that is being made: give it to long queries.
    """

    def __init__(
        self,
        folder: Path,
        store: Store,
        *,
        size: int | None = None,
        quick: bool = False,
        watch: Watch | None = None,
    ) -> None:
        self.folder = folder
        self.quick = quick
        self.progress: Progress | None = None
        self._store = store
        self._size = size
        self._watch = watch or _nobody
        self._experiment = ""
        self._used: set[str] = set()
        self._views: dict[str, View] = {}
        self._tracers: dict[str, Tracer] = {}

    def run(self, name: str, experiment: Callable[[Runner], Result]) -> Result:
        """Run an experiment; its measurements get its name.

        Scenes and structures of the one before are forgotten.
        """
        self._experiment = name
        self._used.clear()
        self._views.clear()
        self._tracers.clear()
        return experiment(self)

    def size(self, usual: int) -> int:
        """Width and height of square pictures: the paper's, unless the user wants another.

        Parameters
        ----------
        usual : int
            The paper's.
        """
        if self._size is not None:
            return self._size
        return max(usual // 8, 64) if self.quick else usual

    def measure(self, name: str, function: Callable[[], Any], *, shared: bool = False) -> Any:
        """Measure something, unless it is known already.

        Parameters
        ----------
        name : str
            What it is; unique within an experiment, parameters included.
        function : callable
            Returns numbers, texts, lists and dicts of them.
        shared : bool
            Whether the other experiments of the paper ask for it by this name, too.

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
            self._store.keep(key, value, time.perf_counter() - started)
        self._used.add(key)
        return self._store.values[key]

    def view(self, name: str) -> View:
        """A scene with a camera, by the name that tables give it; see `views`.

        Raises
        ------
        RaystreamError
            If it needs a model that is not here.
        """
        if name not in self._views:
            self._views[name] = view(name, quick=self.quick)
        return self._views[name]

    def tracer(self, view: View, structure: str, **options: Any) -> Tracer:
        """A tracer for a view's scene; the latest one of each scene is kept.

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
            self._tracers[key] = Tracer(view.scene, structure, progress=self.progress, **options)
        return self._tracers[key]

    @property
    def seconds(self) -> float:
        """How long the measurements took that the latest experiment asked for, once."""
        return sum(self._store.seconds[key] for key in self._used)


@contextlib.contextmanager
def _nobody(title: str) -> Iterator[None]:  # noqa: ARG001 - as every Watch
    yield None
