"""Load the scripts of ``.ci``, which have no suffix, as modules."""

from __future__ import annotations

import importlib.util
import sys
from importlib.machinery import SourceFileLoader
from pathlib import Path

import pytest

FOLDER = Path(__file__).resolve().parents[1] / ".ci"


def load(name):
    """Load a script; the tests of the module that asks are skipped where there is no CI."""
    path = FOLDER / name
    if not path.is_file():
        pytest.skip("CI is not in an installed package", allow_module_level=True)
    loader = SourceFileLoader(name, str(path))
    specification = importlib.util.spec_from_loader(name, loader)
    module = importlib.util.module_from_spec(specification)
    sys.modules[name] = module  # dataclasses look there
    sys.dont_write_bytecode, kept = True, sys.dont_write_bytecode
    try:
        loader.exec_module(module)
    finally:
        sys.dont_write_bytecode = kept
    return module
