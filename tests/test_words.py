"""Words and phrases that we do not use: the text says it as a graphics engineer would."""

from __future__ import annotations

import io
import re
import tokenize
from functools import cache
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent
SOURCES = (ROOT / "src" / "raystream", ROOT / "lab" / "src" / "raystream_lab", ROOT / "examples")

#: What not to write, and what to write instead.
PHRASES = {
    r"anew": "again, rebuild, start over",
    r"(?:some|any|no)body|no one": "the actor: the user, a client, another process",
    r"who(?:so)?ever": "the actor: clients that, code that",
    r"br(?:oken|eak|eaks|eaking|oke) off": "interrupted, cancel",
    r"(?:go|goes|going|gone|went) on": "continue, resume",
    r"by way of": "through, with",
    r"one's own": "your own, custom",
    r"so many|so few": "the number; at most, this many",
    r"what there is": "the noun: the available devices",
    r"(?<!there\s)(?:is|are|was) none": "is not one; unsupported",
    r"(?:is|are) to be had": "is available",
    r"has no say": "has no effect",
    r"in turns": "in turn",
    r"for ever": "forever",
    r"at a prompt": "on the command line",
    r"let(?:s|ting)? go of": "release",
    r"tells? of": "describes, lists",
    r"(?:rays|frames|images|samples|messages) a second": "per second",
    r"(?:bytes|words|steps) an? (?:ray|pixel|triangle|plane|sample|lane)": "per",
    r"(?:the )?usual one": "the default",
    r"without end": "unlimited, infinite",
    r"look(?:s|ing)? about": "look around",
    r"pictures?": "image",
    r"films": "animations; a film accumulates light",
    r"hence|thus|thereby|whereby|thereof": "so, therefore",
    r"in order to": "to",
    r"of course|obviously|simply|basically": "leave it out",
    r"(?:leverage|utili[sz]e)[sd]?": "use",
}

#: Names, not prose: code in quotes or backquotes, files, paths, and references to pages.
NAMES = re.compile(
    r"``.*?``|:\w+:`[^`]*`|`[^`]*`|[\w/.-]*[/._][\w/.-]*\w|\"[\w-]+\"|'[\w-]+'", re.DOTALL
)

#: What begins a line of a comment.
MARKERS = re.compile(r"(?m)^[ \t]*(?:#:?|\*|//)(?=\s)")


@cache
def forbidden() -> re.Pattern[str]:
    phrases = "|".join(PHRASES).replace(" ", r"\s+")
    return re.compile(rf"\b(?:{phrases})\b", re.IGNORECASE)


def found_in(text: str) -> list[tuple[int, str]]:
    """Lines and forbidden phrases of a text; phrases may run over the end of a line."""
    prose = NAMES.sub(lambda name: "`" + "\n" * name[0].count("\n"), MARKERS.sub("", text))
    return [
        (prose.count("\n", 0, match.start()) + 1, " ".join(match[0].split()))
        for match in forbidden().finditer(prose)
        if not match[0].endswith("None")
    ]


#: Most words of a sentence on a page.
SENTENCE_WORDS = 45

#: Where a sentence ends: also at a colon or semicolon, and where an item of a list begins.
SENTENCE_END = re.compile(r"(?<=[.!?])\s+(?=[^a-z])|[;:]\s|\n\s*(?=(?:[-*]|\d\.)\s)")

#: What begins a block that is no paragraph: markup, a table, code.
NO_PARAGRAPH = re.compile(r"\s*(?:\.\.|[=+|]{2}|:\w|>>>|\$|#|\|)|(?:.*\n)?[-=~^]{4}| {3,}")


def faults_of_sentences(text: str) -> list[tuple[int, str]]:
    """Lines of paragraphs, and the sentences that are too long and words that stand twice."""
    found = []
    for match in re.finditer(r"(?m)(?:^[^\n]*\S[^\n]*\n?)+", text):
        if NO_PARAGRAPH.match(match[0]):
            continue
        prose = re.sub(r"\([^()]*\)", "", NAMES.sub("Name", match[0]))
        line = text.count("\n", 0, match.start()) + 1
        found += [(line, word[0]) for word in re.finditer(r"\b([a-z]{2,})\s+\1\b", prose)]
        for sentence in SENTENCE_END.split(prose):
            words = sentence.split()
            if len(words) > SENTENCE_WORDS:
                found.append((line, f"{len(words)} words: {' '.join(words[:12])} ..."))
    return found


def prose_of(path: Path) -> str:
    """The text of a file, line for line; of Python its strings and comments alone."""
    text = path.read_text(encoding="utf-8")
    if path.suffix == ".rst":
        return re.sub(r"(?m)^(?:>>>|\.\.\.) .*$|^ {3,}[\w.]+ ?[=(].*$", "", text)
    if path.suffix == ".md":
        return re.sub(r"(?s)```.*?```", lambda block: "\n" * block[0].count("\n"), text)
    if path.suffix != ".py":
        return text
    lines = [""] * (text.count("\n") + 2)
    kinds = {tokenize.STRING, tokenize.COMMENT, getattr(tokenize, "FSTRING_MIDDLE", -1)}
    for token in tokenize.generate_tokens(io.StringIO(text).readline):
        if token.type in kinds:
            content = token.string
            if token.type == tokenize.STRING and re.fullmatch(r"\w*(['\"])[\w/.-]*\1", content):
                continue  # a name
            for number, line in enumerate(content.split("\n")):
                lines[token.start[0] - 1 + number] += " " + line.strip("\"'")
    return "\n".join(lines)


def files() -> list[Path]:
    """All files with prose of ours."""
    found = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *(ROOT / "docs").rglob("*.rst")]
    for kind in ("*.py", "*.js", "*.html", "*.rst"):
        found += [path for source in SOURCES for path in source.rglob(kind)]
    built = (ROOT / "docs" / "_build", ROOT / "docs" / "examples")
    return sorted(path for path in found if not any(path.is_relative_to(one) for one in built))


def complaints(path: Path) -> list[str]:
    name = path.relative_to(ROOT).as_posix()
    return [f"{name}:{line}: {phrase!r}" for line, phrase in found_in(prose_of(path))]


def test_the_text_uses_the_words_of_the_field():
    found = [line for path in files() for line in complaints(path)]
    assert not found, "\n".join(["see PHRASES for what to write instead:", *found])


def test_sentences_of_pages_are_short_and_without_repeated_words():
    pages = [path for path in files() if path.suffix in {".rst", ".md"}]
    found = [
        f"{path.relative_to(ROOT).as_posix()}:{line}: {what}"
        for path in pages
        if path.parent.name != "decisions"  # records
        for line, what in faults_of_sentences(prose_of(path))
    ]
    assert not found, "\n".join(found)


def test_long_sentences_are_found():
    words = "b c " * (SENTENCE_WORDS // 2)
    assert not faults_of_sentences(f"A {words.strip()}. A {words.strip()}: a {words.strip()}.\n")
    assert [line for line, _ in faults_of_sentences(f"Short.\n\nOne {words}more.\n")] == [3]
    assert faults_of_sentences("One of the\nthe trees.\n") == [(1, "the\nthe")]
    assert not faults_of_sentences(f".. note:: a {words} {words}\n")


@pytest.mark.parametrize(
    "text",
    [
        "The tree is built anew.",
        "Nobody reads it.",
        "A query that was broken\noff.",
        "#: Rays that go\n#: on.",
        "It draws pictures.",
    ],
)
def test_phrases_are_found(text):
    assert len(found_in(text)) == 1


@pytest.mark.parametrize(
    "text", ["see `pictures`, or tutorial/pictures.rst", 'the id "picture"', "``--films``"]
)
def test_names_are_left_alone(text):
    assert not found_in(text)


def test_only_strings_and_comments_of_code_count(tmp_path):
    path = tmp_path / "code.py"
    path.write_text('picture = "a name"  # one line\nanew = 1\n\n"""Built\nanew."""\n')
    assert found_in(prose_of(path)) == [(5, "anew")]
