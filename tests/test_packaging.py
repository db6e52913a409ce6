"""Files that repeat what pyproject.toml says: versions, dependencies, authors."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path

import pytest

import raystream

ROOT = Path(__file__).resolve().parents[1]
if not (ROOT / "packaging").is_dir():
    pytest.skip("packaging is not in an installed package", allow_module_level=True)
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]


def read(name):
    return (ROOT / name).read_text(encoding="utf-8")


def without_spaces(lines):
    return sorted(line.replace(" ", "") for line in lines)


@pytest.mark.parametrize(
    ("name", "pattern"),
    [
        ("CHANGELOG.md", r"^## \[(\d[\d.]*)\] - \S"),  # the newest
        ("CITATION.cff", r"^version: (.*)$"),
        ("packaging/conda/meta.yaml", r'set version = "(.*)"'),
        ("packaging/Containerfile", r"-t raystream:(\S*) "),
    ],
)
def test_versions_agree(name, pattern):
    assert re.search(pattern, read(name), re.MULTILINE)[1] == raystream.__version__


def test_the_citation_has_the_project_as_author():
    (author,) = PROJECT["authors"]
    citation = read("CITATION.cff")
    assert f"authors:\n  - name: {author['name']}\n" in citation
    assert f"license: {PROJECT['license']}\n" in citation


def test_the_conda_recipe_has_the_dependencies():
    recipe = read("packaging/conda/meta.yaml")
    run = re.search(r"^  run:\n((?:    - .*\n)+)", recipe, re.MULTILINE)[1]
    packages = [f"python{PROJECT['requires-python']}", *PROJECT["dependencies"]]
    assert without_spaces(run.replace("    - ", "").splitlines()) == without_spaces(packages)
    assert f"summary: {PROJECT['description']}\n" in recipe
    for name, function in PROJECT["scripts"].items():
        assert f"- {name} = {function}\n" in recipe


def test_the_container_installs_extras_of_the_project():
    extras = re.search(r'"/source\[(.*)\]"', read("packaging/Containerfile"))[1].split(",")
    assert extras == ["graphics", "view"]
    assert set(extras) <= set(PROJECT["optional-dependencies"])
