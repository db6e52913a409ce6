"""``.ci/install_lines``: which install lines are printed, and which of them it runs."""

from __future__ import annotations

import re
import sys
import tomllib
from pathlib import Path

import pytest

from ci_script import load

ROOT = Path(__file__).resolve().parents[1]

install_lines = load("install_lines")


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


def test_a_folder_that_git_does_not_know_is_one_line(tmp_path, monkeypatch):
    (tmp_path / "tree").mkdir()
    monkeypatch.setattr(install_lines, "ROOT", tmp_path)
    monkeypatch.setenv("GIT_CEILING_DIRECTORIES", str(tmp_path.parent))
    with pytest.raises(SystemExit, match="git cannot list the files to install: "):
        install_lines.copy_tree(tmp_path / "tree")
    monkeypatch.setenv("PATH", str(tmp_path))
    with pytest.raises(SystemExit, match="git is not installed"):
        install_lines.copy_tree(tmp_path / "tree")


def test_examples_import_what_the_docs_extra_installs_or_their_own_modules():
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    extras, waiting = project["optional-dependencies"], ["raystream[docs]"]
    installed = {re.match(r"[\w-]+", one)[0] for one in project["dependencies"]}
    while waiting:
        name, inner = re.match(r"([\w-]+)(?:\[([\w,-]+)\])?", waiting.pop()).groups()
        installed.add(name)
        for extra in inner.split(",") if name == "raystream" else ():
            waiting += extras[extra]
    smoke, examples = load("install_smoke.py"), ROOT / "examples"
    for example in examples.rglob("*.py"):
        folders = [folder for folder in example.parents if folder.is_relative_to(examples)]
        for module in smoke.imports_of(example):
            name = module.partition(".")[0]
            is_own = any(
                (folder / name).is_dir() or (folder / f"{name}.py").is_file() for folder in folders
            )
            is_installed = {"PIL": "pillow"}.get(name, name) in installed
            assert is_own or is_installed or name in sys.stdlib_module_names, (example.name, module)
