"""Code blocks of a page: those to run, those not to run, and those without a label.

A page's blocks are read line by line, without docutils, so that pages can be checked where only
the tests' packages are installed. The rules:

- ``.. code-block:: python`` runs, all blocks of a page in one namespace, in order; so do the
  examples that begin with ``>>>``, which are compared as doctest does it.
- ``.. code-block:: text`` is what the block before it prints.
- ``.. code-block:: console`` has commands after ``$ ``. Their options are checked; after the
  comment ``.. runs`` they are run.
- A comment before a block says what is done with it: ``.. not run: reason``, ``.. runs``, or
  ``.. needs: package``: it is left out where the package is missing, and the page's test skips.
- The comment ``.. unseen:`` holds code that runs and is not shown.
- Anything else has no label: a literal block after ``::``, or one in another language.

In Markdown the fences are the blocks, and ``<!-- not run: reason -->`` is the comment.
"""

from __future__ import annotations

import re
import textwrap
from dataclasses import dataclass
from pathlib import Path

_CODE = re.compile(r"^( *)\.\. (?:code-block|sourcecode|code)::[ ]*(\S*)\s*$")
_LABEL = re.compile(r"^( *)\.\. (not run|runs|needs)(?::\s*(.*))?$")
_UNSEEN = re.compile(r"^( *)\.\. unseen:\s*$")
_LITERAL = re.compile(r"^(?! *\.\. ).*::\s*$")
_OPTION = re.compile(r"^\s*:[\w-]+:")
_FENCE = re.compile(r"^( *)```(\w*)\s*$")
_REMARK = re.compile(r"^ *<!-- (not run|runs)(?::\s*(.*?))? -->\s*$")


@dataclass(frozen=True)
class Block:
    """A block of a page."""

    line: int
    """Number of its first line of code, from 1."""
    language: str
    """``python``, ``doctest``, ``console``, ``text``, another one, or ``""``: it has none."""
    text: str
    """Without the indentation."""
    is_shown: bool = True
    runs: bool = False
    """Whether a comment asks for it to be run."""
    not_run: str | None = None
    """Why it is not run."""
    needs: str | None = None
    """The package without which it is not run."""


def blocks_of(page: Path) -> list[Block]:
    """Read a page, by the ending of its name."""
    text = page.read_text(encoding="utf-8")
    return markdown_blocks(text) if page.suffix == ".md" else rest_blocks(text)


def rest_blocks(text: str) -> list[Block]:
    """Find the blocks of a page of reStructuredText."""
    lines = text.splitlines()
    found: list[Block] = []
    label: dict[str, object] = {}
    at = 0
    while at < len(lines):
        line = lines[at]
        if match := _CODE.match(line):
            start, end = _body(lines, at + 1, len(match[1]), with_options=True)
            found.append(_block(lines, start, end, match[2], label))
        elif match := _UNSEEN.match(line):
            start, end = _body(lines, at + 1, len(match[1]))
            found.append(_block(lines, start, end, "python", {"is_shown": False}))
        elif match := _LABEL.match(line):
            start, end = _body(lines, at + 1, len(match[1]))
            words = " ".join([match[3] or "", *(one.strip() for one in lines[start:end])]).strip()
            label = _label(match[2], words)
            at = max(end, at + 1)
            continue
        elif line.lstrip().startswith(">>>"):
            start, end = at, _paragraph_end(lines, at)
            found.append(_block(lines, start, end, "doctest", label))
        elif _LITERAL.match(line):
            start, end = _body(lines, at + 1, len(line) - len(line.lstrip()))
            if start < end:
                found.append(_block(lines, start, end, "", label))
        else:
            at += 1
            continue
        label, at = {}, max(end, at + 1)
    return found


def markdown_blocks(text: str) -> list[Block]:
    """Find the fenced blocks of a page of Markdown."""
    lines = text.splitlines()
    found: list[Block] = []
    label: dict[str, object] = {}
    at = 0
    while at < len(lines):
        if match := _REMARK.match(lines[at]):
            label = _label(match[1], match[2] or "")
        elif match := _FENCE.match(lines[at]):
            start = end = at + 1
            while end < len(lines) and not lines[end].strip().startswith("```"):
                end += 1
            found.append(_block(lines, start, end, match[2], label))
            label, at = {}, end
        at += 1
    return found


def _label(word: str, reason: str) -> dict[str, object]:
    if word == "runs":
        return {"runs": True}
    return {"needs": reason} if word == "needs" else {"not_run": reason}


def _block(
    lines: list[str], start: int, end: int, language: str, label: dict[str, object]
) -> Block:
    text = textwrap.dedent("\n".join(lines[start:end])).strip("\n") + "\n"
    return Block(start + 1, language, text, **label)  # type: ignore[arg-type]


def _body(lines: list[str], at: int, indent: int, with_options: bool = False) -> tuple[int, int]:
    """Find the lines that are indented more than so, without empty ones around them."""
    while with_options and at < len(lines) and _OPTION.match(lines[at]):
        at += 1
    end = at
    while end < len(lines) and (not lines[end].strip() or _indent(lines[end]) > indent):
        end += 1
    while end > at and not lines[end - 1].strip():
        end -= 1
    while at < end and not lines[at].strip():
        at += 1
    return at, end


def _indent(line: str) -> int:
    return len(line) - len(line.lstrip())


def _paragraph_end(lines: list[str], at: int) -> int:
    while at < len(lines) and lines[at].strip():
        at += 1
    return at
