"""The modules that pytest collects tests and examples from."""

from __future__ import annotations

import subprocess
import sys

from conftest import child_environment

CONFTEST = """
from docstrings import Docstrings

def pytest_configure(config):
    config.pluginmanager.register(Docstrings())
"""


def test_what_is_collected(tmp_path):
    """Tests, or an error, from test modules; examples, if any, from others."""
    files = {
        "conftest": CONFTEST,
        # When collecting examples, pytest ignored the error and found half a module with no tests.
        "test_broken": "from os import no_such_name\n\ndef test():\n    pass\n",
        "test_whole": "def test():\n    pass\n",
        "add": '"""Add.\n\n>>> 1 + 1\n2\n"""\n',
        "other": "raise RuntimeError('imported')\n",
    }
    for name, content in files.items():
        (tmp_path / f"{name}.py").write_text(content)
    options = ("--doctest-modules", "--doctest-ignore-import-errors", "--import-mode=importlib")
    done = subprocess.run(
        [sys.executable, "-m", "pytest", "--collect-only", "-q", *options, str(tmp_path)],
        cwd=tmp_path,
        env=child_environment(PYTEST_ADDOPTS=""),
        capture_output=True,
        text=True,
        timeout=120,
    )
    assert done.returncode == 2
    lines = done.stdout.splitlines()
    found = [line for line in lines if "::" in line or line.startswith("ERROR ")]
    assert found == ["add.py::add", "test_whole.py::test", "ERROR test_broken.py"]
