"""WGSL text: the functions and structures that a kernel's source declares, by name and line."""

from __future__ import annotations

import re
from collections.abc import Iterator
from typing import NamedTuple

_COMMENT = re.compile(r"//|/\*|\*/|\n")
_FUNCTION = re.compile(r"\bfn\s+(\w+)\s*\(")
_STRUCTURE = re.compile(r"\bstruct\s+(\w+)\s*\{")
_MEMBER = re.compile(r"\s*(\w+)\s*:\s*(.+?)\s*", re.DOTALL)
_RETURNED = re.compile(r"\s*->\s*([^{@]*)\{")

#: Long names of vectors, by the letter of their short ones.
_LETTERS = {"f32": "f", "i32": "i", "u32": "u"}
_LONG = re.compile(r"vec([234])<(f32|i32|u32),?>")

#: Most characters of a source and of a statement without spaces, deepest nesting of brackets.
#: On a stack of 8 MB the compiler fails at about 10,000 characters, and a nesting of 2,000.
MAX_LENGTH, MAX_STATEMENT, MAX_NESTING = 100_000, 4_000, 100

#: Most of what can refer to the one before: it fails at about 6,000.
MAX_CHAINED = 1_000
_CHAINED = re.compile(r"\b(?:else|fn|struct|alias|const|override)\b")

_OPEN, _CLOSE = "(<[{", ")>]}"


class Member(NamedTuple):
    """A parameter of a function, or a member of a structure.

    Attributes
    ----------
    name, type : str
        Vectors have their short names, such as ``vec4f``.
    """

    name: str
    type: str


class Function(NamedTuple):
    """A function.

    Attributes
    ----------
    name : str
    line : int
        From 1.
    parameters : tuple of Member
    returned : str
        Its type; empty if it returns nothing.
    """

    name: str
    line: int
    parameters: tuple[Member, ...]
    returned: str


class Structure(NamedTuple):
    """A structure.

    Attributes
    ----------
    name : str
    members : tuple of Member
    """

    name: str
    members: tuple[Member, ...]


class WgslText:
    """A source in WGSL, read as far as kernels need it; the compiler checks the rest.

    Parameters
    ----------
    text : str

    Attributes
    ----------
    text : str
    bare : str
        The same with spaces instead of comments.
    """

    def __init__(self, text: str) -> None:
        self.text = text
        self.bare = _without_comments(text)

    def line_of(self, place: int) -> int:
        """The line of a character, from 1."""
        return self.text.count("\n", 0, place) + 1

    def too_large(self) -> tuple[int, str] | None:
        """The line, and what of the source is larger than allowed, if anything.

        The compiler is recursive: sources with more end the process, by a full stack.
        """
        if len(self.text) > MAX_LENGTH:
            return 1, f"the source has more than {MAX_LENGTH:,} characters"
        chained = list(_CHAINED.finditer(self.bare))
        if len(chained) > MAX_CHAINED:
            words = f"more than {MAX_CHAINED:,} declarations and branches"
            return self.line_of(chained[MAX_CHAINED].start()), f"the source has {words}"
        depth = start = 0
        for match in re.finditer(r"[()\[\]{};]|$", self.bare):
            depth += (match[0] in "([{") - (match[0] in ")]}") if match[0] else 0
            if depth > MAX_NESTING:
                return self.line_of(match.start()), f"brackets are nested over {MAX_NESTING} deep"
            if match[0] in "{};":  # and at the end
                statement = "".join(self.bare[start : match.start()].split())
                if len(statement) > MAX_STATEMENT:
                    what = f"a statement has more than {MAX_STATEMENT:,} characters"
                    return self.line_of(match.start()), what
                start = match.end()
        return None

    def first(self, pattern: str) -> re.Match[str] | None:
        """The first match of a pattern outside comments."""
        return re.search(pattern, self.bare)

    def has_word(self, word: str) -> bool:
        """Whether a word occurs outside comments."""
        return self.first(rf"\b{re.escape(word)}\b") is not None

    def functions(self) -> list[Function]:
        """All functions that are declared."""
        found = []
        for match in _FUNCTION.finditer(self.bare):
            end = _end_of(self.bare, match.end())
            returned = _RETURNED.match(self.bare, end)
            found.append(
                Function(
                    match[1],
                    self.line_of(match.start()),
                    tuple(_members(self.bare[match.end() : end - 1])),
                    _short(returned[1]) if returned else "",
                )
            )
        return found

    def structure(self, name: str) -> Structure | None:
        """A structure by its name."""
        for match in _STRUCTURE.finditer(self.bare):
            if match[1] == name:
                end = _end_of(self.bare, match.end())
                return Structure(name, tuple(_members(self.bare[match.end() : end - 1])))
        return None

    def with_word(self, word: str, other: str) -> str:
        """The text with another word in place of one, outside comments."""
        parts, end = [], 0
        for match in re.finditer(rf"\b{re.escape(word)}\b", self.bare):
            parts += [self.text[end : match.start()], other]
            end = match.end()
        return "".join([*parts, self.text[end:]])


def _without_comments(text: str) -> str:
    parts, end, depth, is_line = [], 0, 0, False
    for match in _COMMENT.finditer(text):
        between = text[end : match.start()]
        parts.append(" " * len(between) if depth or is_line else between)
        end = match.end()
        token = match[0]
        if token == "\n":
            is_line = False
            parts.append(token)
            continue
        was_inside = bool(depth) or is_line
        if not is_line and token != "//":
            depth = max(0, depth + (1 if token == "/*" else -1))
        elif not depth:
            is_line = True
        is_code = not was_inside and token == "*/"
        parts.append(token if is_code else " " * len(token))
    rest = text[end:]
    return "".join([*parts, " " * len(rest) if depth or is_line else rest])


def _end_of(text: str, start: int) -> int:
    """The place after the bracket that closes the one before `start`."""
    depth = 1
    for place in range(start, len(text)):
        if text[place] in "([{":
            depth += 1
        elif text[place] in ")]}":
            depth -= 1
            if not depth:
                return place + 1
    return len(text) + 1


def _members(text: str) -> Iterator[Member]:
    """Names and types of a list that is separated by commas; without those it cannot read."""
    depth, start = 0, 0
    for place, letter in enumerate(text + ","):
        if letter == "," and not depth:
            match = _MEMBER.fullmatch(text[start:place])
            if match:
                yield Member(match[1], _short(match[2]))
            start = place + 1
        elif letter in _OPEN:
            depth += 1
        elif letter in _CLOSE:
            depth -= 1


def _short(name: str) -> str:
    """A type without spaces; vectors by their short names."""
    joined = re.sub(r"\s+", "", name)
    return _LONG.sub(lambda match: f"vec{match[1]}{_LETTERS[match[2]]}", joined)
