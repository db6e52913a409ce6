"""Commands of other distributions: found by entry points, or said to be missing."""

from __future__ import annotations

from importlib.metadata import EntryPoint

import pytest
import typer
from typer.testing import CliRunner

from raystream.cli.console import BadInputError
from raystream.cli.plugins import GROUP, add_commands


def run(found, *arguments):
    app = typer.Typer()

    @app.callback()
    def nothing() -> None:
        """Make the commands a group."""

    add_commands(app, found)
    return CliRunner().invoke(app, arguments)


def hello(name: str) -> None:
    """Greet."""
    typer.echo(f"hello {name}")


@pytest.fixture
def greeting(monkeypatch):
    monkeypatch.setattr("raystream.cli.plugins.hello", hello, raising=False)
    return EntryPoint("hello", "raystream.cli.plugins:hello", GROUP)


def test_a_command_of_another_distribution_runs(greeting):
    assert run([greeting], "hello", "you").output == "hello you\n"


def test_the_lab_says_how_to_install_it(greeting):
    result = run([greeting], "lab", "all", "--quick", "--only", "passes")
    assert isinstance(result.exception, BadInputError)
    assert "lab: is not installed: pip install ./lab" in str(result.exception)
    assert "raystream-lab" in run([greeting], "lab", "--help").output


def test_a_command_that_cannot_be_loaded_leaves_the_others(greeting):
    broken = EntryPoint("lab", "no_such_module:lab", GROUP)
    result = run([broken, greeting], "lab")
    assert "no_such_module" in str(result.exception)
    assert run([broken, greeting], "hello", "you").exit_code == 0
