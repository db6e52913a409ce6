"""A key of the sources that can change what the lab counts on the CPU."""

from __future__ import annotations

import ast
import hashlib
from collections.abc import Iterable, Iterator
from functools import cache
from importlib.util import find_spec
from pathlib import Path

#: Parts of raystream, relative to the package, on which counts depend: rays, scenes, structures,
#: machines and renderers. Not devices, files, the command line and the viewer.
_ENGINE = (
    "core/query.py",
    "core/rays.py",
    "kernels",
    "machines",
    "rendering",
    "scene",
    "streams",
    "structures",
    "tracer",
)

#: Of these, what only reads or writes files, or shows finished images.
_ENGINE_OUT = (
    "rendering/atrous.py",
    "rendering/atrous_filter.py",
    "rendering/compare.py",
    "rendering/denoise.py",
    "rendering/exr.py",
    "rendering/false_colors.py",
    "rendering/guide_layers.py",
    "rendering/heatmap.py",
    "rendering/oidn.py",
    "rendering/png.py",
    "rendering/regional_gain.py",
    "rendering/rgbe.py",
    "rendering/rgbe_rows.py",
    "rendering/scale_bar.py",
    "rendering/srgb_encoding.py",
    "rendering/tone.py",
    "rendering/video.py",
    "scene/io",
)

#: Parts of the lab that run experiments and lay out their results, or are for other devices.
_LAB_OUT = (
    "agreement.py",
    "christen/loops_on_device.py",
    "christen/on_graphics.py",
    "command.py",
    "devices.py",
    "foley/counts_on_device.py",
    "foley/kernels_on_graphics.py",
    "foley/times_on_device.py",
    "purcell/on_device.py",
    "purcell/statistics_on_device.py",
    "rayforce/build_on_device.py",
    "report",
    "runner.py",
    "source_key.py",
    "store.py",
)


@cache
def source_key() -> str:
    """Key of the sources that can change measured counts, as 16 hexadecimal digits.

    Comments, docstrings and layout do not change it.
    """
    return key_of(counting_files())


def counting_files() -> dict[str, Path]:
    """The files that are part of the key, by package and relative path, in order."""
    return dict(sorted({**_files("raystream", _ENGINE, _ENGINE_OUT), **_lab_files()}.items()))


def _lab_files() -> dict[str, Path]:
    return _files("raystream_lab", (".",), _LAB_OUT)


def _files(package: str, parts: Iterable[str], out: Iterable[str]) -> dict[str, Path]:
    spec = find_spec(package)
    assert spec is not None
    assert spec.origin is not None
    home = Path(spec.origin).parent
    left_out = [home / one for one in out]
    found = {}
    for part in parts:
        place = home / part
        for path in [place] if place.is_file() else sorted(place.rglob("*")):
            is_source = path.suffix == ".py" or path.name == "published.json"
            if is_source and not any(path.is_relative_to(one) for one in left_out):
                found[f"{package}/{path.relative_to(home).as_posix()}"] = path
    return found


def key_of(files: dict[str, Path]) -> str:
    """Key of some files by their names and their code.

    Parameters
    ----------
    files : dict of str to Path
        By name, in order. Of ``.py`` files the code counts, of others every byte.
    """
    digest = hashlib.sha256()
    for name, path in files.items():
        content = path.read_bytes()
        if path.suffix == ".py":
            content = "\n".join(_parts(ast.parse(content))).encode()
        digest.update(f"{name} {len(content)}\n".encode())
        digest.update(content)
    return digest.hexdigest()[:16]


def _parts(node: ast.AST) -> Iterator[str]:
    """The code of a tree, without positions, docstrings, and fields that are empty.

    New versions of Python add fields, which are empty in code of an older one.
    """
    yield type(node).__name__
    for name, value in ast.iter_fields(node):
        if value is None or value == []:
            continue
        yield f".{name}"
        if isinstance(value, list):
            is_body = name == "body" and isinstance(node, _WITH_DOCSTRING)
            for inner in value[1:] if is_body and _is_text(value[0]) else value:
                yield from _parts(inner) if isinstance(inner, ast.AST) else [repr(inner)]
            yield ";"
        elif isinstance(value, ast.AST):
            yield from _parts(value)
        else:
            yield repr(value)


_WITH_DOCSTRING = (ast.Module, ast.ClassDef, ast.FunctionDef, ast.AsyncFunctionDef)


def _is_text(statement: ast.AST) -> bool:
    return (
        isinstance(statement, ast.Expr)
        and isinstance(statement.value, ast.Constant)
        and isinstance(statement.value.value, str)
    )
