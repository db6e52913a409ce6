"""The table of features by kind of scene is the one that the declarations give."""

from documentation.kinds_table import COLUMNS, parts_of_page, written
from raystream.core.scene_kinds import FEATURES, REFUSALS


def test_the_page_has_the_table() -> None:
    again = "run python tests/documentation/kinds_table.py"
    assert parts_of_page()[1] == written(), again


def test_each_no_has_its_reason() -> None:
    for name, one in FEATURES.items():
        assert set(one.kinds) <= set(REFUSALS), name
        assert set(one.notes) <= set(one.kinds), name
        assert one.reason or not one.row or set(COLUMNS) <= set(one.kinds), name
