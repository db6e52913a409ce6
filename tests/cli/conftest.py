"""Running the command line, and tiny scenes for it."""

from __future__ import annotations

import json
import os
import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import raystream
from conftest import leave_out_first_use
from raystream.cli import main
from raystream.cli.layers import LayerSelection
from raystream.jit.threads import set_thread_count

SQUARE = """\
mtllib square.mtl
o square
v 0 0 0
v 1 0 0
v 1 1 0
v 0 1 0
usemtl red
f 1 2 3
f 1 3 4
"""
RED = "newmtl red\nKd 0.8 0.1 0.1\n"


@dataclass(frozen=True)
class Run:
    """Result of a run of the command line."""

    code: int
    out: str
    err: str

    @property
    def figures(self) -> dict[str, Any]:
        """Stdout as strict JSON."""
        return json.loads(self.out, parse_constant=pytest.fail)

    @property
    def complaint(self) -> str:
        """The one line of a refusal."""
        assert self.code == 2
        assert self.out == ""
        assert self.err.count("\n") == 1
        assert self.err.startswith("raystream: ")
        return self.err.removeprefix("raystream: ").rstrip("\n")


@pytest.fixture
def run(capsys, tmp_path, monkeypatch) -> Callable[..., Run]:
    """Run the command line in this process, in a separate folder."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.delenv("RAYSTREAM_DEBUG", raising=False)
    monkeypatch.setattr(sys, "unraisablehook", sys.unraisablehook)  # put back after Ctrl-C
    leave_out_first_use(monkeypatch)
    # It depends on what is installed.
    monkeypatch.setattr(LayerSelection, "report_denoiser", lambda _: None)

    def call(*arguments: object) -> Run:
        capsys.readouterr()
        with pytest.raises(SystemExit) as end:
            main([str(argument) for argument in arguments])
        out, err = capsys.readouterr()
        return Run(end.value.code, out, err)

    yield call
    set_thread_count(None)


@pytest.fixture(scope="session")
def environment() -> dict[str, str]:
    """Environment of a separate process that finds raystream where this one did."""
    source = str(Path(raystream.__file__).resolve().parents[1])
    path = os.pathsep.join(filter(None, [source, os.environ.get("PYTHONPATH")]))
    return {**os.environ, "PYTHONPATH": path, "RAYSTREAM_DEBUG": ""}


@pytest.fixture
def square(tmp_path) -> Path:
    """The unit square in the plane z = 0: two triangles that share the diagonal."""
    (tmp_path / "square.mtl").write_text(RED)
    path = tmp_path / "square.obj"
    path.write_text(SQUARE)
    return path


@pytest.fixture
def rays(tmp_path) -> Path:
    """Four rays down on the square: two hit, one misses, one is invalid; as a 2 x 2 grid."""
    path = tmp_path / "rays.npz"
    origins = np.array([[[0.75, 0.25, 1], [0.25, 0.75, 2]], [[5, 5, 1], [0.5, 0.5, 1]]])
    directions = np.broadcast_to([0.0, 0.0, -1.0], origins.shape).copy()
    directions[1, 1] = 0.0
    np.savez(path, origins=origins, directions=directions)
    return path
