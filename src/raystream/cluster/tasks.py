"""Tasks: calls that workers make, whose results come in order, however many workers are lost."""

from __future__ import annotations

import itertools
import time
import uuid
import warnings
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import CancelledError
from typing import TYPE_CHECKING, Any

from distributed import KilledWorker, wait

from raystream.cluster.errors import ClusterError
from raystream.core.errors import RaystreamWarning

if TYPE_CHECKING:
    from distributed import Client, Future

__all__ = ["OrderedTasks"]

#: Times that a call is made anew after Dask gave it up: as many as it took workers with it, each
#: counted `allowed-failures` (3) and one times. What kills that many is not bad luck.
MOST_TRIES = 10

#: Seconds between two looks at a task, and until a cluster without workers is reported.
PAUSE, SILENCE = 1.0, 10.0

#: Kept apart from those of everyone else.
_PREFIX = "raystream-"

Call = tuple[Any, ...]


class OrderedTasks:
    """Makes calls on workers and hands out their results in the order of the calls.

    Parameters
    ----------
    client : distributed.Client
    function : callable
        Of a module; its arguments and results travel by Dask's own serialization.
    calls : iterable of tuple
        Arguments; taken as they are needed.
    window : int
        Most calls under way or done, and not handed out: what waits for its turn waits on the
        workers, and takes no memory here.
    name : str
        What Dask's dashboard calls them.
    """

    def __init__(
        self,
        client: Client,
        function: Callable[..., Any],
        calls: Iterable[Call],
        window: int,
        name: str,
    ) -> None:
        self._client = client
        self._function = function
        self._calls = iter(calls)
        self._name = f"{_PREFIX}{name}-{uuid.uuid4().hex[:12]}"
        self._numbers = itertools.count()
        self._window = window
        self._waiting: deque[tuple[Call, Future]] = deque()

    def __iter__(self) -> Iterator[Any]:
        return self

    def __next__(self) -> Any:
        """The result of the next call.

        Raises
        ------
        ClusterError
            If the scheduler is gone, or a call ends its workers again and again.
        Exception
            What the call raised.
        """
        self._fill()
        if not self._waiting:
            raise StopIteration
        call, future = self._waiting[0]
        result = self._result(call, future)
        self._waiting.popleft()
        self._fill()
        return result

    def close(self) -> None:
        """Cancel what is under way; what a worker has begun, it ends for nobody."""
        futures = [future for _, future in self._waiting]
        self._waiting.clear()
        self._calls = iter(())
        if futures and self._client.status == "running":
            self._client.cancel(futures, force=True)

    def _fill(self) -> None:
        while len(self._waiting) < self._window:
            call = next(self._calls, None)
            if call is None:
                return
            self._waiting.append((call, self._submit(call)))

    def _submit(self, call: Call, priority: int = 0) -> Future:
        key = f"{self._name}-{next(self._numbers)}"
        return self._client.submit(self._function, *call, key=key, pure=False, priority=priority)

    def _result(self, call: Call, future: Future) -> Any:
        for _ in range(MOST_TRIES):
            self._wait(future)
            try:
                result = future.result()
            except (KilledWorker, CancelledError):
                self._check_connection()
            else:
                future.release()
                return result
            future = self._submit(call, priority=1)
            self._waiting[0] = call, future
        raise ClusterError(
            "the same piece of work kills worker after worker: they may lack memory; give them "
            "more, or fewer threads"
        )

    def _wait(self, future: Future) -> None:
        """Wait until there is a result or an error, and listen to Ctrl-C."""
        looked = time.monotonic()
        is_told = False
        while not future.done():
            try:
                with self._client.as_current():
                    wait([future], timeout=PAUSE)
            except TimeoutError:
                pass
            except CancelledError:
                return
            now = time.monotonic()
            if now - looked >= SILENCE and not future.done():
                looked = now
                self._check_connection()
                if not is_told and not self._has_workers():
                    is_told = True
                    warnings.warn(
                        "the cluster has no workers any more; waiting for some to come",
                        RaystreamWarning,
                        stacklevel=2,
                    )

    def _has_workers(self) -> bool:
        try:
            return bool(self._client.nthreads())
        except (OSError, ValueError) as error:
            raise _gone() from error

    def _check_connection(self) -> None:
        if self._client.status != "running":
            raise _gone()


def _gone() -> ClusterError:
    return ClusterError("the connection to the cluster's scheduler is lost")
