"""Run the notebooks and store what they show: ``python docs/notebooks/refresh.py [NAME ...]``.

What is stored names no machine: the kernel is called python3, and cells have no times.
"""

from __future__ import annotations

import sys
from pathlib import Path

import nbformat
from nbclient import NotebookClient
from nbformat import NotebookNode

FOLDER = Path(__file__).resolve().parent

#: What is kept of what is said about a cell: whether it runs, and what its picture shows.
KEPT = ("tags", "mystnb")

#: Seconds that a cell may take; the first ones compile.
CELL_SECONDS = 300


def run(path: Path, folder: Path) -> NotebookNode:
    """Execute a notebook in a folder; an error in a cell is raised."""
    notebook = nbformat.read(path, as_version=4)
    client = NotebookClient(
        notebook,
        timeout=CELL_SECONDS,
        kernel_name="python3",
        resources={"metadata": {"path": str(folder)}},
        record_timing=False,
        coalesce_streams=True,
    )
    client.execute()
    return notebook


def cleaned(notebook: NotebookNode) -> NotebookNode:
    """Drop what says where and when it ran."""
    notebook.metadata = NotebookNode(
        kernelspec={"display_name": "Python 3", "language": "python", "name": "python3"},
        language_info={"name": "python"},
    )
    for number, cell in enumerate(notebook.cells):
        cell.id = f"cell-{number}"
        cell.metadata = NotebookNode({k: v for k, v in cell.metadata.items() if k in KEPT})
    return notebook


def main(names: list[str]) -> None:
    """Refresh the notebooks of these names, or all."""
    for path in sorted(FOLDER.glob("*.ipynb")):
        if not names or path.stem in names:
            nbformat.write(cleaned(run(path, FOLDER)), path)
            print(f"{path.name}: {path.stat().st_size // 1000} kB")


if __name__ == "__main__":
    main(sys.argv[1:])
