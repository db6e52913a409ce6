"""The blocks found on a page, and the errors for wrong ones."""

from __future__ import annotations

import pytest

from documentation.blocks import Block, markdown_blocks, rest_blocks
from documentation.commands import check, commands_of
from documentation.running import run_page

PAGE = """\
Title
=====

.. code-block:: python
   :caption: one

   print(1 + 1)

   x = 3

.. code-block:: text

   2

- in a list, with

  .. code-block:: console

     $ raystream info cornell

.. not run: it would take
   an hour

.. code-block:: python

   wait()

.. unseen:

   assert x == 3

>>> x
3

PassSnapshot as it is::

    something

.. note::

   No block.
"""


def test_blocks_of_a_page():
    found = rest_blocks(PAGE)
    assert [(one.line, one.language) for one in found] == [
        (7, "python"), (13, "text"), (19, "console"), (26, "python"),
        (30, "python"), (32, "doctest"), (37, ""),
    ]  # fmt: skip
    assert found[0].text == "print(1 + 1)\n\nx = 3\n"
    assert found[3].not_run == "it would take an hour"
    assert [one.not_run for one in found[4:]] == [None] * 3
    assert [one.is_shown for one in found] == [True] * 4 + [False] + [True] * 2


def test_blocks_of_markdown():
    text = "a\n<!-- not run: slow -->\n```python\nf()\n```\n```console\n$ pip\n```\n```\nx\n```\n"
    assert markdown_blocks(text) == [
        Block(4, "python", "f()\n", not_run="slow"),
        Block(7, "console", "$ pip\n"),
        Block(10, "", "x\n"),
    ]


def test_a_right_page_runs(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    run_page("page", [one for one in rest_blocks(PAGE) if one.language])


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("::\n\n    x\n", "needs a label"),
        (".. code-block:: wgsl\n\n   x\n", "needs a label"),
        (".. code-block:: python\n\n   print(1)\n", "does not show"),
        (".. code-block:: python\n\n   print(1)\n\n>>> 2\n2\n", "does not show"),
        (".. code-block:: python\n\n   print(1)\n\n.. code-block:: text\n\n   2\n", "is printed"),
        (".. code-block:: text\n\n   2\n", "nothing before it prints"),
        (">>> 1\n2\n", "Expected"),
        (".. code-block:: console\n\n   $ raystream render x --nothing\n", "--nothing"),
        (".. code-block:: console\n\n   $ raystream brew\n", "no command"),
        ('.. code-block:: console\n\n   $ pip install "raystream[moon]"\n', "moon"),
        (".. code-block:: console\n\n   $ python benchmarks/none.py\n", "does not exist"),
        (".. code-block:: console\n\n   $ make\n", "unknown command"),
        (".. code-block:: console\n\n   raystream info cornell\n", "after '\\$ '"),
    ],
)
def test_a_wrong_page_fails(text, words):
    with pytest.raises((pytest.fail.Exception, AssertionError), match=words):
        run_page("page", rest_blocks(text))


def test_blocks_whose_package_is_missing_are_left_out(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.delenv("RAYSTREAM_TEST_EXTRAS", raising=False)
    page = """
.. needs: no_such_package

.. code-block:: python

   import no_such_package

.. code-block:: python

   open("first", "w").close()

.. needs: pytest

.. code-block:: python

   open("second", "w").close()
"""
    with pytest.raises(pytest.skip.Exception, match="page needs no_such_package: pip install"):
        run_page("page", rest_blocks(page))
    assert {path.name for path in tmp_path.iterdir()} == {"first", "second"}


def test_an_error_names_its_block():
    with pytest.raises(ZeroDivisionError) as caught:
        run_page("page.rst", [Block(7, "python", "1 / 0\n")])
    assert "page.rst, line 7" in caught.value.__notes__[0]


def test_commands_and_what_they_print():
    text = "$ raystream info a \\\n    --json\n{}\n$ pip install x\n"
    assert list(commands_of(text)) == [
        ("raystream info a --json", "{}"),
        ("pip install x", ""),
    ]
    check("X=1 raystream info cornell && pip install numpy")
