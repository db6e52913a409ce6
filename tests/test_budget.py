"""``.ci/budget`` on a small made-up tree: growth fails, and so does a raise without a reason."""

from __future__ import annotations

import json
import re
import subprocess

import pytest

from ci_script import load

pytestmark = pytest.mark.ci

budget = load("budget")

#: The tree, with the budget of each file's lines.
FILES = {
    "src/raystream/__init__.py": ('"""Doc."""\n__all__ = ["a", "b"]\n', "src.raystream"),
    "src/raystream/room/deep/code.py": ("def f(a):\n    return a\n", "src.room"),
    "src/raystream/shaders/code.wgsl": ("fn f() {\n}\n", "src.shaders"),
    "src/raystream/page/code.js": ("f();\n", "src.page"),
    "src/raystream/page/code.css": ("p { color: red; }\n", "src.page"),
    "src/raystream/page/code.html": ("<p></p>\n", "src.page"),
    "lab/src/raystream_lab/run.py": ("a = 1\n", "lab.raystream_lab"),
    "lab/src/raystream_lab/room/code.py": ("a = 1\n", "lab.room"),
    "tests/oracle.py": ("a = 1\n", "tests.tests"),
    "tests/room/test_code.py": ("a = 1\n", "tests.room"),
}

#: What may be added to a file of each kind.
FREE = {
    "py": "\n# one\n\n    # two\n",
    "wgsl": "// one\n\n/* two\nlines */\n  // three\n",
    "js": "// one\n\n/**\n * two\n */\n",
    "css": "/* one\n  a { } */\n\n",
    "html": "<!-- one\n<p>\n-->\n\n",
}

#: A line of code for each kind, which looks like a comment in part.
LINE = {
    "py": "b = '# no comment'  # one\n",
    "wgsl": "const b = 1; // one\n",
    "js": "const b = `\\`// ${'/*'}`;  // one\n",
    "css": "a::after { content: '/*'; } /* one */\n",
    "html": "<b></b> <!-- one -->\n",
}

WIDE = "def f(a, b, c, /, d, e, *, f, g, h, i, j=0, **more): return a\n"


@pytest.fixture
def tree(tmp_path, monkeypatch):
    """A commit of the tree with a budget of exactly what is there."""
    monkeypatch.setattr(budget, "ROOT", tmp_path)
    for path, (content, _) in FILES.items():
        write(tmp_path / path, content)
    (tmp_path / ".ci").mkdir()
    tally(tmp_path, 5, 3)
    git(tmp_path, "init", "--quiet", "--initial-branch=main")
    commit(tmp_path)
    assert budget.main(["--lower", "--suite", str(tmp_path / "tally.json")]) == 0
    commit(tmp_path)
    return tmp_path


def write(path, content):
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(content, encoding="utf-8")


def append(path, content):
    write(path, path.read_text("utf-8") + content)


def tally(tree, cases, kernels):
    write(tree / "tally.json", json.dumps({"cases": cases, "kernels": kernels}))


def git(tree, *arguments):
    identity = ["-c", "user.name=A", "-c", "user.email=a@example.com"]
    subprocess.run(["git", *identity, *arguments], cwd=tree, check=True, capture_output=True)


def commit(tree):
    git(tree, "add", "--all")
    git(tree, "commit", "--quiet", "--allow-empty", "--message=change")


def set_budget(tree, name, value):
    """Write another value for an entry."""
    key = name.rpartition(".")[2]
    path = tree / ".ci/budget.toml"
    text, count = re.subn(rf"(?m)^{key} = .*$", f"{key} = {value}", path.read_text("utf-8"))
    assert count == 1
    write(path, text)


@pytest.fixture
def check(tree, capsys):
    """Run the check; its exit status, and what it complains about."""

    def check(*arguments):
        capsys.readouterr()
        status = budget.main([*arguments, "--suite", str(tree / "tally.json")])
        found = re.findall(r"(?m)^([\w.]+): (.*)$", capsys.readouterr().out)
        assert status == bool(found)
        return found

    return check


# ---- What is counted.


def test_the_first_budget_is_what_is_there(tree, check):
    assert check() == []
    lines = {"raystream": 1, "room": 2, "shaders": 2, "page": 3}
    limits = budget.read_limits((tree / ".ci/budget.toml").read_text("utf-8"))
    assert {name: limit.at_most for name, limit in limits.items()} == {
        "interface.top_level_names": 2,
        "interface.wide_functions": 0,
        "lines.lab.raystream_lab": 1,
        "lines.lab.room": 1,
        **{f"lines.src.{room}": count for room, count in lines.items()},
        "lines.tests.room": 1,
        "lines.tests.tests": 1,
        "suite.everyday_cases": 5,
        "suite.everyday_kernels": 3,
    }


@pytest.mark.parametrize("path", FILES)
def test_a_line_more_fails(tree, check, path):
    content, name = FILES[path]
    append(tree / path, LINE[path.rpartition(".")[2]])
    now = sum(one.count("\n") for one, other in FILES.values() if other == name)
    now += 1 - content.count('"""\n')
    assert check() == [(f"lines.{name}", f"{now} is over the budget of {now - 1}")]
    write(tree / path, content)
    assert check() == []


@pytest.mark.parametrize("path", FILES)
def test_comments_and_blank_lines_are_free(tree, check, path):
    append(tree / path, FREE[path.rpartition(".")[2]])
    assert check() == []


def test_docstrings_are_free_and_other_strings_are_not(tree, check):
    path = tree / "src/raystream/room/deep/code.py"
    write(path, '"""Of the\n\nmodule."""\ndef f(a):\n    """Of a\n    function."""\n    return a\n')
    assert check() == []
    write(path, 'class A:\n    "Doc."\n    a = 1  # one\n\n\n# two\n')
    assert check() == []
    write(path, 'def f(a): """Doc,\n    of two lines."""; return "é"\n')
    assert check() == []
    write(path, 'a = """\n# text\n\n"""\n')
    assert check() == [("lines.src.room", "3 is over the budget of 2")]


def test_other_files_are_free(tree, check):
    write(tree / "src/raystream/room/published.json", "{}\n")
    write(tree / "docs/code.py", "a = 1\n")
    write(tree / ".gitignore", "ignored.py\n")
    write(tree / "src/raystream/room/ignored.py", "a = 1\n")
    assert check() == []


def test_a_new_room_needs_a_budget_and_that_a_reason(tree, check):
    write(tree / "src/raystream/new/code.py", "a = 1\n")
    assert check() == [("lines.src.new", "1 without a budget: add one, with a reason")]
    path, text = tree / ".ci/budget.toml", (tree / ".ci/budget.toml").read_text("utf-8")
    write(path, text.replace("[lines.src]\n", "[lines.src]\nnew = 1\n"))
    silent = "added by the working tree without a new reason beside it"
    assert check() == [("lines.src.new", silent)]
    entry = 'new = { at_most = 1, reason = "new" }'
    write(path, text.replace("[lines.src]\n", f"[lines.src]\n{entry}\n"))
    assert check() == []


def test_a_name_more_fails(tree, check):
    write(tree / "src/raystream/__init__.py", '__all__ = ["a", "b", "c"]\n')
    assert check() == [("interface.top_level_names", "3 is over the budget of 2")]


@pytest.mark.parametrize("package", ["src/raystream/room/deep", "lab/src/raystream_lab/room"])
def test_a_wide_function_more_fails(tree, check, package):
    path = tree / package / "code.py"
    write(path, WIDE)
    assert check() == [("interface.wide_functions", "1 is over the budget of 0")]
    write(path, WIDE.replace(", j=0", ", *rest").replace("*, ", ""))
    assert check() == []


def test_functions_of_tests_may_be_wide(tree, check):
    write(tree / "tests/oracle.py", WIDE)
    assert check() == []


@pytest.mark.parametrize(
    ("cases", "kernels", "expected"),
    [
        (5, 3, []),
        (4, 0, []),
        (6, 3, [("suite.everyday_cases", "6 is over the budget of 5")]),
        (5, 4, [("suite.everyday_kernels", "4 is over the budget of 3")]),
    ],
)
def test_everyday_cases_and_kernels_are_counted_by_pytest(tree, check, cases, kernels, expected):
    tally(tree, cases, kernels)
    assert check() == expected


def test_without_a_tally_they_are_not_counted(tree, capsys):
    assert budget.main(["--all"]) == 0
    shown = capsys.readouterr().out
    assert re.search(r"(?m)^suite.everyday_cases +5 +not counted$", shown)
    with pytest.raises(SystemExit, match=r"no tally of the everyday tests"):
        budget.main(["--suite", str(tree / "missing.json")])


# ---- Raises, and their reasons.


@pytest.mark.parametrize("is_committed", [False, True])
def test_a_raise_needs_a_reason(tree, check, is_committed):
    append(tree / "tests/oracle.py", "b = 2\n")
    set_budget(tree, "lines.tests.tests", 2)
    if is_committed:
        commit(tree)
    [(name, complaint)] = check()
    assert name == "lines.tests.tests"
    assert re.match(r"raised from 1 to 2 by .* without a new reason beside it", complaint)
    set_budget(tree, "lines.tests.tests", '{ at_most = 2, reason = "more" }')
    assert check() == []  # also as a later commit
    commit(tree)
    commit(tree)
    assert check() == []


def test_a_raise_that_is_taken_back_needs_none(tree, check):
    set_budget(tree, "lines.tests.tests", 2)
    commit(tree)
    assert len(check()) == 1
    set_budget(tree, "lines.tests.tests", 1)
    assert check() == []


def test_a_reason_excuses_one_raise(tree, check):
    set_budget(tree, "lines.tests.tests", '{ at_most = 2, reason = "more" }')
    commit(tree)
    set_budget(tree, "lines.tests.tests", '{ at_most = 3, reason = "more" }')
    commit(tree)
    [(name, complaint)] = check()
    assert (name, complaint[:18]) == ("lines.tests.tests", "raised from 2 to 3")
    set_budget(tree, "lines.tests.tests", '{ at_most = 3, reason = "still more" }')
    assert check() == []


def test_a_merge_may_take_what_either_branch_has_and_not_more(tree, check):
    git(tree, "checkout", "--quiet", "-b", "branch")
    set_budget(tree, "lines.tests.tests", '{ at_most = 2, reason = "two" }')
    commit(tree)
    git(tree, "checkout", "--quiet", "main")
    set_budget(tree, "lines.src.page", '{ at_most = 4, reason = "four" }')
    commit(tree)
    git(tree, "merge", "--quiet", "--no-edit", "--strategy-option=ours", "branch")
    set_budget(tree, "lines.tests.tests", '{ at_most = 2, reason = "two" }')
    git(tree, "commit", "--quiet", "--all", "--amend", "--no-edit")
    assert check() == []
    set_budget(tree, "lines.tests.tests", '{ at_most = 9, reason = "two" }')
    git(tree, "commit", "--quiet", "--all", "--amend", "--no-edit")
    assert [name for name, _ in check()] == ["lines.tests.tests"]


def test_falling_is_free(tree, check, capsys):
    (tree / "tests/oracle.py").unlink()
    commit(tree)
    assert check() == []
    budget.main([])
    assert "1 can be lowered: .ci/budget --lower" in capsys.readouterr().out
    set_budget(tree, "lines.tests.tests", 0)
    assert check() == []


def test_a_copy_without_git_is_compared_with_its_budget(tree, check, capsys):
    (tree / ".git").rename(tree / "history")
    set_budget(tree, "lines.tests.tests", 9)
    assert check() == []
    append(tree / "tests/room/test_code.py", "b = 2\n")
    assert [name for name, _ in check()] == ["lines.tests.room"]
    budget.main([])
    assert "no git: reasons for raises are not checked" in capsys.readouterr().out


@pytest.mark.parametrize(
    "value", ['"1"', "true", "{ at_most = 1 }", '{ at_most = 1, reason = "a", more = 1 }', "[1]"]
)
def test_a_budget_is_a_number_perhaps_with_a_reason(tree, value):
    set_budget(tree, "lines.tests.tests", value)
    with pytest.raises(SystemExit, match=r"lines.tests.tests: expected a number or \{ at_most"):
        budget.main([])


def test_unknown_budgets_are_refused(tree, check):
    append(tree / ".ci/budget.toml", "\n[more]\nlines = { at_most = 1, reason = 'why' }\n")
    assert check() == [("more.lines", "there is no such number")]


# ---- Lowering, and the table.


def test_lower_writes_what_has_fallen_and_keeps_the_rest(tree, check):
    path = tree / ".ci/budget.toml"
    text = path.read_text("utf-8")
    set_budget(tree, "lines.src.shaders", '{ at_most = 4, reason = "at_most = 4" } # fine')
    set_budget(tree, "lines.src.page", '{ at_most = 5, reason = "wide" }')
    commit(tree)
    append(tree / "src/raystream/shaders/code.wgsl", "fn g() {}\n")
    (tree / "lab/src/raystream_lab/run.py").unlink()
    assert check("--lower") == []
    expected = text.replace("raystream_lab = 1\n", "")
    kept = 'shaders = { at_most = 3, reason = "at_most = 4" } # fine\n'
    assert path.read_text("utf-8") == expected.replace("shaders = 2\n", kept)
    append(tree / "src/raystream/room/deep/code.py", "b = 2\n")
    before = path.read_text("utf-8")
    assert [name for name, _ in check("--lower")] == ["lines.src.room"]
    assert path.read_text("utf-8") == before


def test_without_a_budget_it_fails(tree):
    (tree / ".ci/budget.toml").unlink()
    with pytest.raises(SystemExit, match=r"no .ci/budget.toml: .ci/budget --lower writes it"):
        budget.main([])


def test_the_table_has_the_difference_to_a_commit(tree, capsys):
    append(tree / "tests/oracle.py", "b = 2\n")
    commit(tree)
    append(tree / "tests/oracle.py", "c = 2\n")
    (tree / "src/raystream/page/code.js").unlink()
    (tree / "src/raystream/shaders/code.wgsl").unlink()
    git(tree, "tag", "last")
    assert budget.main([]) == 1
    rows = [line.split() for line in capsys.readouterr().out.splitlines()]
    assert rows[:5] == [
        ["budget", "now", "to", "HEAD"],
        ["lines.src.page", "3", "2", "-1", "can", "be", "lowered"],
        ["lines.src.shaders", "2", "0", "-2", "can", "be", "lowered"],
        ["lines.tests.tests", "1", "3", "+1", "over"],
        ["lines,", "all", "12", "11", "-2"],
    ]
    assert budget.main(["HEAD~1"]) == 1
    rows = [line.split() for line in capsys.readouterr().out.splitlines()]
    assert ["lines.tests.tests", "1", "3", "+2", "over"] in rows
    with pytest.raises(SystemExit, match="ls-tree"):
        budget.main(["gone"])
