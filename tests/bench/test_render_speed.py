"""The benchmark of path tracers, with renderers that end their processes."""

from __future__ import annotations

import os

import numpy as np
import pytest

from bench.test_scripts import FOLDER


class Ending:
    """Ends its process at once, or after one part."""

    def __init__(self, scene, parts):  # noqa: ARG002
        self.parts = parts
        self._take_part()

    def render(self, samples, seed):
        self._take_part()
        return np.full((1, 1, 3), samples + seed, np.float32)

    def _take_part(self):
        if not self.parts:
            os._exit(3)
        self.parts -= 1


@pytest.mark.parametrize("parts", [0, 2])
def test_the_end_of_a_renderer_ends_the_benchmark(monkeypatch, parts):
    monkeypatch.syspath_prepend(FOLDER)  # for its processes too
    import render_speed

    server = render_speed.Server(Ending, "cornell", parts)
    if parts:
        pixels, seconds = server.render(5, 1)
        assert (pixels == 6.0).all()
        assert seconds >= 0.0
    with pytest.raises(SystemExit, match=r"^Ending: its process ended with status 3$"):
        server.render(5, 2)


def test_a_renderer_ends_with_its_pipe(monkeypatch, capfd):
    monkeypatch.syspath_prepend(FOLDER)
    import render_speed

    server = render_speed.Server(Ending, "cornell", 1)
    server.close()
    assert server.process.exitcode == 0
    assert capfd.readouterr().err == ""
