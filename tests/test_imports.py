"""Layering: the packages that each package may import, and the maximum length of a file."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from graphlib import CycleError, TopologicalSorter
from pathlib import Path

import pytest

SOURCE = Path(__file__).resolve().parents[1] / "src" / "raystream"
LAB = SOURCE.parents[1] / "lab" / "src" / "raystream_lab"

#: A layer may import itself and the layers before it.
LAYERS = (
    "notebook",
    "core",
    "jit",
    "kernels",
    "scene",
    "structures",
    "geometry",
    "streams",
    "programs",
    "machines",
    "tracer",
    "physics",
    "rendering",
    "cuda",
    "graphics",
    "stepper",
    "ray_files",
    "line_of_sight",
    "cluster",
    "web",
    "viewer",
    "torch",
    "jax",
    "bench",
    "adapters",
    "cli",
)

#: Modules outside the layers: they put the package together.
EXEMPT = ("__init__", "__main__", "_version")

#: Who may import these packages of others; anyone may import the rest.
RESERVED = {
    "numba": {"jit"},
    "llvmlite": {"jit"},
    "numba_cuda": {"jit"},
    "wgpu": {"graphics"},
    "torch": {"torch"},
    "jax": {"jax"},
}

#: The stream programming model knows nothing of rays: of the layers before it, only these.
STREAMS_MAY_IMPORT = ("raystream.core.errors", "raystream.jit")

MAX_LINES = 500


def imported_names(tree: ast.AST, package: str) -> Iterator[tuple[int, str]]:
    """Yield line and dotted name of every import, in functions and type-checking blocks too.

    ``from a import b`` gives ``a.b``, whether b is a module or a name in one.
    """
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            for alias in node.names:
                yield node.lineno, alias.name
        elif isinstance(node, ast.ImportFrom):
            base = node.module or ""
            if node.level:
                parents = package.split(".")
                parents = parents[: len(parents) - node.level + 1]
                base = ".".join([*parents, base] if base else parents)
            for alias in node.names:
                yield node.lineno, f"{base}.{alias.name}"


def import_fault(layer: str, name: str) -> str | None:
    """The reason why this layer may not import this dotted name, if any."""
    top, _, rest = name.partition(".")
    if top == "raystream_lab":
        return f"{layer} imports {name}: the lab is a distribution of its own"
    if top != "raystream":
        allowed = RESERVED.get(top)
        if allowed is not None and layer not in allowed:
            return f"{layer} imports {top}: only {', '.join(sorted(allowed))} may"
        return None
    target = rest.partition(".")[0]
    if target == "_version" or target == layer:
        return None
    if target not in LAYERS:
        return f"{layer} imports {name}: not a layer"
    if LAYERS.index(target) > LAYERS.index(layer):
        return f"{layer} imports {name}: {target} comes later in the list"
    if layer == "streams" and not f"{name}.".startswith(tuple(f"{n}." for n in STREAMS_MAY_IMPORT)):
        return f"streams imports {name}: it knows nothing of rays"
    return None


def find_violations(source: Path) -> list[str]:
    """Check every module of a package laid out as raystream."""
    violations = []
    for path in sorted(source.rglob("*.py")):
        parts = path.relative_to(source).with_suffix("").parts
        layer = parts[0]
        if layer in EXEMPT:
            continue
        place = path.relative_to(source).as_posix()
        if layer not in LAYERS:
            violations.append(f"{place}: {layer} is not a layer")
            continue
        tree = ast.parse(path.read_text(encoding="utf-8"), place)
        says = parts in ((layer,), (layer, "__init__"))
        if says and not ast.get_docstring(tree):
            violations.append(f"{place}:1: does not say what {layer} holds")
        package = ".".join(("raystream", *parts[:-1]))
        for line, name in imported_names(tree, package):
            fault = import_fault(layer, name)
            if fault:
                violations.append(f"{place}:{line}: {fault}")
    return violations


class _AtRunTime(ast.NodeTransformer):
    """Drops the imports that only type checkers see."""

    def visit_If(self, node: ast.If) -> ast.AST | list[ast.stmt]:
        if ast.unparse(node.test) == "TYPE_CHECKING":
            return node.orelse
        return self.generic_visit(node)


def find_circle(source: Path) -> list[str]:
    """Modules that import each other in a circle at run time, also in functions."""
    paths = {}
    for path in sorted(source.rglob("*.py")):
        parts = path.relative_to(source).with_suffix("").parts
        paths[".".join(("raystream", *(part for part in parts if part != "__init__")))] = path
    graph: dict[str, set[str]] = {name: set() for name in paths}
    for name, path in paths.items():
        tree = _AtRunTime().visit(ast.parse(path.read_text(encoding="utf-8")))
        package = name if path.name == "__init__.py" else name.rpartition(".")[0]
        for _, imported in imported_names(tree, package):
            target = imported if imported in paths else imported.rpartition(".")[0]
            if target in paths and target != name:
                graph[name].add(target)
    try:
        TopologicalSorter(graph).prepare()
    except CycleError as error:
        return list(error.args[1])
    return []


def test_no_files_import_each_other_in_a_circle() -> None:
    circle = find_circle(SOURCE)
    assert not circle, "\n".join(circle)


def test_layers_import_only_layers_before_them() -> None:
    violations = find_violations(SOURCE)
    assert not violations, "\n".join(violations)


def test_the_map_has_all_packages_in_order() -> None:
    page = (SOURCE.parents[1] / "docs" / "architecture.rst").read_text(encoding="utf-8")
    table = page.partition("The packages")[2].partition("The life of a ray")[0]
    assert re.findall(r"^   \* - ``(\w+)``$", table, re.MULTILINE) == list(LAYERS)


def test_no_file_is_longer_than_one_idea() -> None:
    counts = {
        path.relative_to(source).as_posix(): len(path.read_text(encoding="utf-8").splitlines())
        for source in (SOURCE, LAB)
        for path in sorted(source.rglob("*.py"))
    }
    assert counts, f"no modules in {SOURCE}"
    long = [f"{name}: {count} lines" for name, count in counts.items() if count > MAX_LINES]
    assert not long, f"longer than {MAX_LINES} lines:\n" + "\n".join(long)


# The checker itself.

DOCSTRING = '"""What it holds."""\n'


def plant(root: Path, place: str, text: str) -> Path:
    path = root / place
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text, encoding="utf-8")
    return root


@pytest.mark.parametrize(
    ("place", "statement", "fault"),
    [
        ("kernels/slab.py", "import raystream.scene", "scene comes later"),
        ("kernels/slab.py", "import raystream.scene.mesh as m", "scene comes later"),
        ("kernels/slab.py", "from raystream.scene import Mesh", "scene comes later"),
        ("kernels/slab.py", "from raystream import scene", "scene comes later"),
        ("kernels/slab.py", "from ..scene.mesh import Mesh", "scene comes later"),
        ("kernels/slab.py", "from .. import scene", "scene comes later"),
        ("kernels/slab.py", "def f():\n    from raystream.cli import main", "cli comes later"),
        ("kernels/slab.py", "if TYPE_CHECKING:\n    import raystream.cli", "cli comes later"),
        ("structures/bvh/layout.py", "from ...tracer import Tracer", "tracer comes later"),
        ("core/rays.py", "from raystream.jit import cpu", "jit comes later"),
        ("tracer.py", "from raystream.graphics import device", "graphics comes later"),
        ("kernels/slab.py", "import raystream", "not a layer"),
        ("kernels/slab.py", "from raystream import load", "not a layer"),
        ("kernels/slab.py", "import numba", "imports numba"),
        ("kernels/slab.py", "def f():\n    from numba.core import types", "imports numba"),
        ("cli/info.py", "def f():\n    import wgpu.enums", "imports wgpu"),
        ("streams/kernel.py", "from raystream.core.rays import Rays", "nothing of rays"),
        ("streams/kernel.py", "from raystream.scene import Scene", "nothing of rays"),
        ("shaders/slab.py", "", "shaders is not a layer"),
    ],
)
def test_planted_violation_is_found(tmp_path: Path, place: str, statement: str, fault: str) -> None:
    violations = find_violations(plant(tmp_path, place, f"{DOCSTRING}{statement}\n"))
    assert len(violations) == 1
    assert violations[0].startswith(place)
    assert fault in violations[0]


@pytest.mark.parametrize("place", ["core/__init__.py", "tracer.py"])
def test_room_without_docstring_is_found(tmp_path: Path, place: str) -> None:
    violations = find_violations(plant(tmp_path, place, "X = 1\n"))
    assert len(violations) == 1
    assert "does not say" in violations[0]


@pytest.mark.parametrize(
    ("place", "statement"),
    [
        ("kernels/slab.py", "from raystream.core.bounds import Bounds"),
        ("kernels/slab.py", "from raystream.kernels import triangle"),
        ("kernels/slab.py", "from . import triangle"),
        ("kernels/slab.py", "from raystream import core"),
        ("structures/store.py", "from raystream._version import __version__"),
        ("streams/kernel.py", "from raystream.jit.cpu import kernel"),
        ("streams/kernel.py", "from raystream.core.errors import RaystreamError"),
        ("jit/cpu.py", "import numba"),
        ("graphics/buffers.py", "def f():\n    import wgpu"),
        ("__init__.py", "from raystream.cli import main"),
        ("cli.py", "import numbers, numpy"),
    ],
)
def test_allowed_import_passes(tmp_path: Path, place: str, statement: str) -> None:
    assert find_violations(plant(tmp_path, place, f"{DOCSTRING}{statement}\n")) == []


@pytest.mark.parametrize(
    ("statement", "is_circle"),
    [
        ("import raystream.kernels.slab", True),
        ("from raystream.kernels import slab", True),
        ("from .slab import NAME", True),
        ("def f():\n    from raystream.kernels.slab import NAME", True),
        ("if TYPE_CHECKING:\n    from raystream.kernels.slab import NAME", False),
        ("from raystream.core import rays", False),
    ],
)
def test_planted_circle_is_found(tmp_path: Path, statement: str, is_circle: bool) -> None:
    plant(tmp_path, "core/rays.py", DOCSTRING)
    plant(tmp_path, "kernels/slab.py", f"{DOCSTRING}from raystream.kernels import ray\n")
    circle = find_circle(plant(tmp_path, "kernels/ray.py", f"{DOCSTRING}{statement}\n"))
    names = {"raystream.kernels.ray", "raystream.kernels.slab"}
    assert set(circle) == (names if is_circle else set())
