"""Tasks: calls on workers whose results arrive in order, even if workers are lost."""

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

#: Attempts after Dask gave a task up. Dask does so once it lost `allowed-failures` (3) plus one
#: workers to the task; more attempts than this cannot be bad luck.
MAX_ATTEMPTS = 10

#: Seconds between polls of a task, and before a cluster without workers is reported.
POLL_SECONDS, WARN_SECONDS = 1.0, 10.0

#: Distinguishes our task keys from those of other users.
_PREFIX = "raystream-"

Call = tuple[Any, ...]


class OrderedTasks:
    """Runs calls on workers and returns their results in the order of the calls.

    Parameters
    ----------
    client : distributed.Client
    function : callable
        A module-level function; arguments and results use Dask's own serialization.
    calls : iterable of tuple
        Arguments; consumed lazily.
    window : int
        Maximum calls running or done but not returned. Results wait on the workers and take
        no memory in this process.
    name : str
        Name shown on Dask's dashboard.
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
        """Return the result of the next call.

        Raises
        ------
        ClusterError
            If the scheduler is gone, or a call kills its workers repeatedly.
        Exception
            Whatever the call raised.
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
        """Cancel outstanding calls; calls already running finish, and are discarded."""
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
        for _ in range(MAX_ATTEMPTS):
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
            "one task kills worker after worker: workers may lack memory; give them "
            "more, or fewer threads"
        )

    def _wait(self, future: Future) -> None:
        """Wait for a result or an error, staying responsive to Ctrl-C."""
        looked = time.monotonic()
        is_told = False
        while not future.done():
            try:
                with self._client.as_current():
                    wait([future], timeout=POLL_SECONDS)
            except TimeoutError:
                pass
            except CancelledError:
                return
            now = time.monotonic()
            if now - looked >= WARN_SECONDS and not future.done():
                looked = now
                self._check_connection()
                if not is_told and not self._has_workers():
                    is_told = True
                    warnings.warn(
                        "the cluster has no workers left; waiting for new ones",
                        RaystreamWarning,
                        stacklevel=2,
                    )

    def _has_workers(self) -> bool:
        try:
            return bool(self._client.nthreads())
        except (OSError, ValueError) as error:
            raise _connection_lost() from error

    def _check_connection(self) -> None:
        if self._client.status != "running":
            raise _connection_lost()


def _connection_lost() -> ClusterError:
    return ClusterError("the connection to the cluster's scheduler is lost")
