"""The examples of the page on kernels in WGSL print what it says."""

from __future__ import annotations

import doctest
from pathlib import Path

import pytest

from documentation.blocks import rest_blocks
from raystream.graphics.adapters import OpenDevice

PAGE = Path(__file__).resolve().parents[2] / "docs" / "shader_kernels.rst"
if not PAGE.is_file():
    pytest.skip("the pages are not in an installed package", allow_module_level=True)


def test_the_pages_examples(opened: OpenDevice):
    blocks = rest_blocks(PAGE.read_text(encoding="utf-8"))
    examples = [one for one in blocks if one.language == "doctest"]
    assert len(examples) == 5
    assert all(one.not_run == "needs a graphics adapter" for one in examples)
    text = "\n\n".join(one.text for one in examples)
    test = doctest.DocTestParser().get_doctest(text, {}, "shader_kernels", str(PAGE), 0)
    output: list[str] = []
    runner = doctest.DocTestRunner()
    runner.run(test, out=output.append)
    assert not output, "".join(output)
    assert runner.tries > 20
