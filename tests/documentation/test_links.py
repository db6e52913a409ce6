"""Links in README and CONTRIBUTING lead to existing files."""

from __future__ import annotations

import re

import pytest

from documentation.commands import REPOSITORY


@pytest.mark.parametrize("name", ["README.md", "CONTRIBUTING.md"])
def test_links_lead_somewhere(name):
    text = (REPOSITORY / name).read_text(encoding="utf-8")
    links = [link for link in re.findall(r'(?:\]\(|src=")([^)"#]+)', text) if "://" not in link]
    missing = [link for link in links if not (REPOSITORY / link).exists()]
    assert not missing, f"{name} links to {missing}"
    assert links or name == "CONTRIBUTING.md"
