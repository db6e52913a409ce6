"""Ctrl-C, wherever Python happens to be when it arrives."""

from __future__ import annotations

import _thread
import contextlib
import signal
import sys
import threading
import time
from collections.abc import Iterator

#: Seconds after which a lost interrupt is raised again: by then the callback has returned.
RETRY_SECONDS = 0.01


@contextlib.contextmanager
def keep_interrupts() -> Iterator[None]:
    """Raise a KeyboardInterrupt again that Python could only report as ignored.

    That happens where no caller can receive an exception: in ``__del__``, in callbacks of weak
    references, of the garbage collector and of ctypes. Dask runs enough of them for one Ctrl-C
    in ten to be lost there on a busy machine.
    """
    report = sys.unraisablehook

    def handle(unraisable: sys.UnraisableHookArgs) -> None:
        if issubclass(unraisable.exc_type, KeyboardInterrupt):
            # The bare call: a Thread takes locks, which this thread may hold just now.
            _thread.start_new_thread(_interrupt_soon, ())
        else:
            report(unraisable)

    sys.unraisablehook = handle
    try:
        yield
    finally:
        sys.unraisablehook = report


def _interrupt_soon() -> None:
    time.sleep(RETRY_SECONDS)
    main = threading.main_thread().ident
    if main is not None and hasattr(signal, "pthread_kill"):
        signal.pthread_kill(main, signal.SIGINT)  # ends a wait as well
    else:
        _thread.interrupt_main()


def end_quietly() -> None:
    """Prepare to end the process with its own exit code after a KeyboardInterrupt was handled.

    Where the interrupt passed through code compiled from a string (a dataclass being made, for
    example), ``python -m`` otherwise ends by the signal, whatever was passed to `sys.exit`: it
    looks at the last string that was run. And objects that were half made when the interrupt
    came may fail in ``__del__``, which is not worth a traceback.
    """
    exec("")
    sys.unraisablehook = lambda _: None
