"""Option groups: the options that Typer sees, and the values that commands get."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

import pytest
import typer

from raystream.cli import app
from raystream.cli.option_groups import expand_groups, options_given


@dataclass(frozen=True)
class Size:
    width: Annotated[int, typer.Option(min=1)] = 4
    height: int = 3


@dataclass(frozen=True, kw_only=True)
class Picture:
    name: Annotated[str, typer.Option()]
    size: Size
    is_large: Annotated[bool, typer.Option("--large")] = False


@pytest.fixture
def call():
    """Run a command with groups; returns its arguments."""
    got = []
    small = typer.Typer()

    @small.command()
    @expand_groups
    def command(first: Annotated[str, typer.Argument()], *, picture: Picture, last: int = 7):
        got.append((first, picture, last))

    def run(*words):
        typer.main.get_command(small).main(list(words), standalone_mode=False)
        return got.pop()

    return run


def test_groups_in_groups_are_assembled(call):
    words = ("a", "--name", "b", "--height", "9", "--large", "--last", "8")
    assert call(*words) == ("a", Picture(name="b", size=Size(4, 9), is_large=True), 8)
    assert call("a", "--name", "b") == ("a", Picture(name="b", size=Size()), 7)


@pytest.mark.parametrize(
    ("words", "fault"),
    [(["a"], "name"), (["a", "--name", "b", "--width", "0"], "greater than or equal to 1")],
)
def test_fields_are_checked_as_options(call, words, fault):
    with pytest.raises(typer.BadParameter.mro()[1], match=fault):
        call(*words)


def test_options_that_differ_from_their_defaults():
    assert options_given(Size()) == {}
    given = options_given(Picture(name="b", size=Size(height=5)))
    assert given == {"name": "b", "height": 5}


def test_options_are_in_the_order_of_the_signature():
    """Across groups: ``--cluster`` lies between options of the tracer and of the scene."""
    render = typer.main.get_command(app).commands["render"]
    names = [parameter.name for parameter in render.params]
    assert len(names) == len(set(names))
    at = names.index("gpu")
    assert names[at : at + 5] == ["gpu", "cluster", "threads", "time", "triangles"]
    assert names[0] == "scene"
