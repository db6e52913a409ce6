"""The lab's stored reports: listed, with all of today's experiments of their devices."""

from __future__ import annotations

import json
import re

import pytest

from documentation.commands import REPOSITORY
from extras import need

need("raystream_lab")

from raystream_lab import EXPERIMENTS
from raystream_lab.devices import DEVICES
from raystream_lab.experiments import choose

STORED = REPOSITORY / "docs" / "lab"
PAGE = (REPOSITORY / "docs" / "lab.rst").read_text(encoding="utf-8")
FOLDERS = sorted(path.name for path in STORED.iterdir())


def test_every_report_is_listed_and_devices_without_one_are_named():
    assert re.findall(r"^   lab/(\w+)/index$", PAGE, re.MULTILINE) == FOLDERS
    never = PAGE.partition("never run with")[2].partition("\n\n")[0]
    for device in set(DEVICES) - set(FOLDERS):
        assert f"``--device {device}``" in never


@pytest.mark.parametrize("device", FOLDERS)
def test_a_report_is_of_all_experiments_of_its_device(device):
    report = json.loads((STORED / device / "report.json").read_text(encoding="utf-8"))
    assert report["about"] == json.loads((STORED / device / "about.json").read_text())
    assert report["about"]["device"] == device
    assert set(report["experiments"]) == {one.name for one in choose(["all"], (), device)}
    assert len(EXPERIMENTS) > len(report["experiments"]) > 5
