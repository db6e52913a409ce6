"""Cheap fresh processes: forks of one that has imported Numba, but nothing of raystream."""

from __future__ import annotations

import contextlib
import io
import multiprocessing
import os
import runpy
import sys
import traceback
from collections.abc import Mapping, Sequence
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

_IS_POSIX = "forkserver" in multiprocessing.get_all_start_methods()


class Fork:
    """A program that runs in a separate process.

    Parameters
    ----------
    program : Path
        File in Python. It runs in its folder, from which it imports, too.
    paths : sequence of Path
        Folders from which it imports first.
    variables : mapping of str to str
        Environment variables. Numba has read its own before.
    """

    def __init__(
        self, program: Path, paths: Sequence[Path] = (), variables: Mapping[str, str] | None = None
    ) -> None:
        context: Any = multiprocessing.get_context("forkserver" if _IS_POSIX else "spawn")
        if _IS_POSIX:
            context.set_forkserver_preload(["numba"])
        self._reader, writer = context.Pipe(duplex=False)
        environment = {**os.environ, **(variables or {})}
        places = [str(path) for path in (*paths, program.parent)]
        self._process = context.Process(target=_run, args=(program, places, environment, writer))
        self._process.start()
        writer.close()

    def words(self, seconds: float = 300.0) -> list[str]:
        """Wait for its end, and return the words that it printed."""
        assert self._reader.poll(seconds), "it takes too long"
        error, out = self._reader.recv()
        self._process.join(seconds)
        assert not error, error
        assert self._process.exitcode == 0
        return out.split()


def run_fresh(
    program: Path, paths: Sequence[Path] = (), variables: Mapping[str, str] | None = None
) -> list[str]:
    """The words that a program prints in a separate process; see `Fork`."""
    return Fork(program, paths, variables).words()


def _run(
    program: Path, paths: Sequence[str], environment: Mapping[str, str], writer: Connection
) -> None:
    assert "raystream" not in sys.modules
    os.environ.clear()
    os.environ.update(environment)
    # Bytecode on disk is known by the second and the size of its source: a file that a test edits
    # twice in a second would run as it was before.
    sys.dont_write_bytecode = True
    os.chdir(program.parent)
    sys.path[:0] = paths
    out, error = io.StringIO(), ""
    try:
        with contextlib.redirect_stdout(out):
            runpy.run_path(str(program), run_name="__main__")
    except BaseException:
        error = traceback.format_exc()
    writer.send((error, out.getvalue()))
