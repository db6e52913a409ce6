"""``.ci/install_lines``: which install lines are printed, and which of them it runs."""

from __future__ import annotations

import importlib.util
import re
import sys
import tomllib
from importlib.machinery import SourceFileLoader
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
SCRIPT = ROOT / ".ci" / "install_lines"
if not SCRIPT.is_file():
    pytest.skip("CI is not in an installed package", allow_module_level=True)


def load():
    loader = SourceFileLoader("install_lines", str(SCRIPT))
    module = importlib.util.module_from_spec(importlib.util.spec_from_loader(loader.name, loader))
    sys.dont_write_bytecode, kept = True, sys.dont_write_bytecode
    try:
        loader.exec_module(module)
    finally:
        sys.dont_write_bytecode = kept
    return module


install_lines = load()


def test_all_that_is_printed_is_found():
    printed = install_lines.printed_lines()
    assert "README.md" in printed[(".",)]
    assert "README.md" in printed["-e", ".[docs]", "-e", "./lab"]
    assert "CONTRIBUTING.md" in printed["-e", ".[dev]", "-e", "./lab"]
    assert "docs/ray_files.rst" in printed[(".[zarr]",)]
    assert "examples/simulation/jax_pose.py" in printed[(".[jax]",)]
    for page in install_lines.pages(ROOT):
        name = page.relative_to(ROOT).as_posix()
        is_found = any(name in places for places in printed.values())
        assert is_found == bool(re.search(r"pip\s+install\s+[^`\s]", page.read_text("utf-8"))), name


def test_extras_of_lines_exist():
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    named = {one for line in install_lines.printed_lines() for one in install_lines.extras_of(line)}
    assert {"docs", "view", "zarr"} <= named <= set(project["optional-dependencies"])
    assert set(install_lines.ELSEWHERE) <= named


@pytest.mark.parametrize(
    ("text", "line"),
    [
        ("Install it with `pip install raystream`, or not.", (".",)),
        ('needs ``pip\n    install\n    "raystream[a,b]"`` and more', (".[a,b]",)),
        (
            '```sh\nx/bin/pip install -e ".[a]" -e ./lab && x y\n```\n',
            ("-e", ".[a]", "-e", "./lab"),
        ),
        ("    $ pip install . ./lab   # in a copy\n    $ raystream lab\n", (".", "./lab")),
        ('print(f"{error}: pip install raystream[a]")', (".[a]",)),
        ("pip install --upgrade 'raystream-lab'", ("--upgrade", "raystream-lab")),
    ],
)
def test_a_line_ends_with_its_command(tmp_path, text, line):
    for name in ("CONTRIBUTING.md", "lab/README.md"):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_text("pip installs")
    (tmp_path / "README.md").write_text(text)
    assert install_lines.printed_lines(tmp_path) == {line: ["README.md"]}


def test_lines_that_are_left_out():
    reasons = {line: install_lines.left_out(line) for line in install_lines.printed_lines()}
    assert not any(reasons[line] for line in [(".",), (".[zarr]",), (".", "./lab")])
    assert reasons[(".[torch]",)].startswith("gigabytes")
    assert install_lines.left_out(["numpy"]) == "none of our distributions"
    assert install_lines.extras_of(["-e", "./lab[c]", "x[d]", ".[a,b]"]) == ["c", "a", "b"]
