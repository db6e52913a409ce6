"""Notebooks run, print their stored output, and name no machine."""

from __future__ import annotations

import doctest
import importlib.util
import json

import pytest

from documentation.commands import REPOSITORY
from extras import need

FOLDER = REPOSITORY / "docs" / "notebooks"
NOTEBOOKS = sorted(FOLDER.glob("*.ipynb"))
IDS = [path.stem for path in NOTEBOOKS]


def printed(cell: dict) -> str:
    """The text that a cell writes to stdout."""
    texts = [one["text"] for one in cell.get("outputs", ()) if one.get("name") == "stdout"]
    return "".join(text if isinstance(text, str) else "".join(text) for text in texts)


@pytest.mark.parametrize("path", NOTEBOOKS, ids=IDS)
def test_stored_outputs(path):
    text = path.read_text(encoding="utf-8")
    notebook = json.loads(text)
    assert path.stat().st_size < 600_000
    assert set(notebook["metadata"]) == {"kernelspec", "language_info"}
    for place in ("/home/", "/tmp/", "/Users/", str(REPOSITORY)):
        assert place not in text
    counts = []
    for cell in notebook["cells"]:
        if cell["cell_type"] == "code":
            assert set(cell["metadata"]) <= {"tags", "mystnb"}
            if any("image/png" in one.get("data", ()) for one in cell["outputs"]):
                assert cell["metadata"]["mystnb"]["image"]["alt"]
            kinds = [one["output_type"] for one in cell["outputs"]]
            assert "error" not in kinds
            assert not any(one.get("name") == "stderr" for one in cell["outputs"])
            if "skip-execution" not in cell["metadata"].get("tags", ()):
                counts.append(cell["execution_count"])
    assert counts == list(range(1, len(counts) + 1)), "run docs/notebooks/refresh.py"


@pytest.mark.documentation
@pytest.mark.parametrize("path", NOTEBOOKS, ids=IDS)
def test_notebook_runs(path, tmp_path, monkeypatch):
    need("nbclient")
    monkeypatch.delenv("MPLBACKEND", raising=False)  # the kernel draws into the notebook
    specification = importlib.util.spec_from_file_location("refresh", FOLDER / "refresh.py")
    refresh = importlib.util.module_from_spec(specification)
    specification.loader.exec_module(refresh)
    ran = refresh.run(path, tmp_path)
    stored = json.loads(path.read_text(encoding="utf-8"))
    compare = doctest.OutputChecker().check_output
    for number, (now, then) in enumerate(zip(ran.cells, stored["cells"], strict=True)):
        flags = doctest.NORMALIZE_WHITESPACE
        assert compare(printed(then), printed(now), flags), (
            f"{path.name}, cell {number}: stored\n{printed(then)}\nprinted\n{printed(now)}"
        )
        drawn = [
            any("image/png" in one.get("data", ()) for one in cell.get("outputs", ()))
            for cell in (now, then)
        ]
        assert drawn[0] == drawn[1], f"{path.name}, cell {number}: a picture came or went"
