"""ContenderProcess: a contender in a process of its own, which stands still between requests."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import tempfile
import threading
from collections.abc import Collection
from typing import IO, Any

from raystream.bench.contenders import Entry, peer_of
from raystream.bench.contenders.base import Query

#: Seconds after which a process that does not answer is ended.
MAX_SECONDS = 900.0

#: Characters of a process's last words in a message.
_LAST_WORDS = 200


class ContenderError(Exception):
    """A contender failed; the message says how."""


class ContenderProcess:
    """A contender in a process of its own; see `worker`.

    Between requests the process is stopped (SIGSTOP, where there is such a signal): thread pools
    spin for milliseconds after their work, on the cores that the next contender needs.

    Parameters
    ----------
    entry : Entry
    threads : int
    queries : collection of str
        Those that are tried at once; a first call takes longer.

    Attributes
    ----------
    about : dict
        ``version``, ``notes``, ``modes``, ``queries``, ``watertight``, and the ``seconds`` of the
        import, a small build and the queries of some rays or points.

    Raises
    ------
    ContenderError
        If it is unavailable or cannot build a small scene.
    """

    def __init__(
        self, entry: Entry, threads: int, queries: Collection[Query] = ("first", "any", "multi")
    ) -> None:
        # A process group of its own keeps a Ctrl-C in the terminal from it. If this process is
        # killed, Linux ends the worker, which asks for that; elsewhere the system may leave it
        # stopped. Its path is ours, however we came by it.
        self._log: IO[bytes] = tempfile.TemporaryFile()  # noqa: SIM115 - closed by close()
        path = os.pathsep.join(one for one in sys.path if one)
        self._process = subprocess.Popen(
            [sys.executable, "-m", "raystream.bench.worker"],
            env={**os.environ, "PYTHONPATH": path},
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=self._log,
            process_group=0 if os.name == "posix" else None,
            text=True,
            encoding="utf-8",
        )
        peer = peer_of(entry)
        adapter = [peer.adapter, peer.packages, peer.install_hint, dict(peer.options)]
        try:
            own = {"options": entry.options, "threads": threads, "queries": list(queries)}
            self.about = self.ask("open", adapter=adapter, **own)
        except BaseException:
            self.close()
            raise

    @property
    def is_alive(self) -> bool:
        """Whether the process can take requests."""
        return self._process.poll() is None

    def ask(self, do: str, **arguments: Any) -> dict[str, Any]:
        """Wake the process, let it carry out a request, and stop it again.

        Raises
        ------
        ContenderError
            If the contender raised an exception; or the process ended, was killed, or did not
            answer for `MAX_SECONDS`, and takes no more requests.
        """
        process = self._process
        assert process.stdin is not None
        assert process.stdout is not None
        self._signal("SIGCONT")
        late = threading.Event()

        def end() -> None:
            late.set()
            process.kill()

        watch = threading.Timer(MAX_SECONDS, end)
        watch.daemon = True
        watch.start()
        try:
            process.stdin.write(json.dumps({"do": do, **arguments}) + "\n")
            process.stdin.flush()
            line = process.stdout.readline()
        except BrokenPipeError:
            line = ""
        finally:
            watch.cancel()
        if not line.endswith("\n"):  # nothing, or the beginning of an answer
            code = process.wait()
            reason = f"no answer for {MAX_SECONDS:.0f} s" if late.is_set() else how_it_ended(code)
            raise ContenderError(reason + self._last_words())
        self._signal("SIGSTOP")
        answer: dict[str, Any] = json.loads(line)
        if "error" in answer:
            raise ContenderError(answer["error"])
        return answer

    def close(self) -> None:
        """End the process."""
        self._process.kill()
        for pipe in (self._process.stdin, self._process.stdout):
            if pipe is not None:
                try:
                    pipe.close()
                except OSError:  # an unsent request
                    continue
        self._process.wait()
        self._log.close()

    def _signal(self, name: str) -> None:
        number = getattr(signal, name, None)
        if number is not None:
            self._process.send_signal(number)

    def _last_words(self) -> str:
        """The last line on the standard error."""
        self._log.seek(0)
        lines = self._log.read().decode("utf-8", "replace").split("\n")
        words = [" ".join(line.split()) for line in lines if line.strip()]
        return f": {words[-1][:_LAST_WORDS]}" if words else ""


def how_it_ended(code: int) -> str:
    """How a process ended, from its exit status: that of `subprocess` and `multiprocessing`."""
    if code >= 0:
        return f"its process ended with status {code}"
    try:
        name = signal.Signals(-code).name
    except ValueError:
        name = f"signal {-code}"
    hint = " (out of memory?)" if name == "SIGKILL" else ""
    return f"its process was ended by {name}{hint}"
