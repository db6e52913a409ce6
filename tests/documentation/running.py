"""Run the blocks of a page, and compare their output with the page."""

from __future__ import annotations

import contextlib
import doctest
import io
import linecache
import shlex
from pathlib import Path
from typing import Any

import pytest

from documentation.blocks import Block
from documentation.commands import check, commands_of
from extras import missing_of, need
from raystream.cli import main

_FLAGS = doctest.ELLIPSIS | doctest.NORMALIZE_WHITESPACE


def run_page(name: str, blocks: list[Block]) -> None:
    """Run all blocks in one namespace; fail at the first one that is wrong, naming its line.

    Where packages that blocks need are missing, the others run, and the test skips.
    """
    missing = set(missing_of(*{block.needs for block in blocks if block.needs}))
    blocks = [block for block in blocks if block.needs not in missing]
    namespace: dict[str, Any] = {"__name__": "__main__"}
    printed: str | None = None
    for block in blocks:
        place = f"{name}, line {block.line}"
        if block.language == "text" and block.not_run is None:
            if printed is None:
                pytest.fail(f"{place}: nothing before it prints this; label it 'not run: reason'")
            _compare(place, block.text, printed)
            printed = None
            continue
        if printed and printed.strip():
            pytest.fail(f"{place}: the block before prints what the page does not show:\n{printed}")
        printed = _run(place, block, namespace) if block.not_run is None else None
    if printed and printed.strip():
        pytest.fail(f"{name}: the last block prints what the page does not show:\n{printed}")
    need(*missing, whose=name)


def _run(place: str, block: Block, namespace: dict[str, Any]) -> str | None:
    """Run a block; returns its output, or None if that has been compared."""
    if block.language == "python":
        return _run_python(place, block.text, namespace)
    if block.language == "doctest":
        _run_examples(place, block, namespace)
    elif block.language == "console":
        for command, shown in commands_of(block.text):
            try:
                check(command)
            except Exception as error:  # typer's usage errors among them
                pytest.fail(f"{place}: {command}: {type(error).__name__}: {error}")
            if block.runs:
                _compare(f"{place}: {command}", shown, _run_command(place, command))
    else:
        pytest.fail(f"{place}: a block {block.language or 'of no language'!r} needs a label")
    return None


def _run_python(place: str, text: str, namespace: dict[str, Any]) -> str:
    """Execute; the source is where tracebacks and compilers look for it."""
    file = f"<{place}>"
    linecache.cache[file] = (len(text), None, text.splitlines(keepends=True), file)
    out = io.StringIO()
    with contextlib.redirect_stdout(out):
        try:
            exec(compile(text, file, "exec"), namespace)
        except Exception as error:
            error.add_note(f"in the block at {place}")
            raise
    return out.getvalue()


def _run_examples(place: str, block: Block, namespace: dict[str, Any]) -> None:
    examples = doctest.DocTestParser().get_examples(block.text)
    test = doctest.DocTest(examples, namespace, place, place, block.line - 1, None)
    test.globs = namespace  # DocTest copies it; the next block needs its names
    out = io.StringIO()
    result = doctest.DocTestRunner(optionflags=_FLAGS).run(test, out=out.write, clear_globs=False)
    if result.failed:
        pytest.fail(f"{place}:\n{out.getvalue()}")


def _run_command(place: str, command: str) -> str:
    words = shlex.split(command)
    assert words[0] == "raystream", f"{place}: only raystream's commands are run, not {command}"
    out = io.StringIO()
    with contextlib.redirect_stdout(out), pytest.raises(SystemExit) as ended:
        main(words[1:])
    assert ended.value.code == 0, f"{place}: {command}: exit code {ended.value.code}"
    return out.getvalue()


def _compare(place: str, shown: str, printed: str) -> None:
    if not doctest.OutputChecker().check_output(shown.strip(), printed.strip(), _FLAGS):
        pytest.fail(f"{place}: the page shows\n{shown}\nbut this is printed\n{printed}")


def reasons(pages: dict[Path, list[Block]]) -> list[str]:
    """List the blocks that are not run, each with its reason."""
    return [
        f"{page.name}:{block.line} {block.language}: {block.not_run}"
        for page, blocks in pages.items()
        for block in blocks
        if block.not_run is not None
    ]
