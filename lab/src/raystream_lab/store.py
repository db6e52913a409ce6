"""Measurements on disk, saved one by one so that an interrupted run can resume."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from raystream.core.atomic_write import atomic_write
from raystream.core.errors import FileFormatError

FILE_NAME = "measurements.json"

#: Version of the file layout.
_LAYOUT = 1

#: Files of measurements have some hundred kilobytes; a larger file is something else.
_MAX_BYTES = 1 << 28


class Store:
    """Measurements by name, in a file that is rewritten atomically after each one.

    Parameters
    ----------
    path : Path
    settings : mapping
        Settings of all measurements; those made with others are rejected.
    source : str
        Key of the sources that measure, see `source_key`.

    Attributes
    ----------
    values : dict of str to JSON values
    seconds : dict of str to float
        Time taken by each.
    foreign_count : int
        Number of measurements read that another version of the sources made.
    """

    def __init__(self, path: Path, settings: Mapping[str, Any], source: str) -> None:
        self.path = path
        self.values: dict[str, Any] = {}
        self.foreign_count = 0
        self._settings = json.loads(json.dumps(dict(settings)))
        self._source = source
        self._sources: dict[str, str] = {}
        self.seconds: dict[str, float] = {}

    def read(self) -> None:
        """Load the measurements of an existing file.

        Raises
        ------
        FileFormatError
            If it is not a file of measurements, or was made with other settings.
        """
        try:
            if self.path.stat().st_size > _MAX_BYTES:
                raise FileFormatError(self.path, "too large for measurements; remove it")
            content = json.loads(self.path.read_text(encoding="utf-8"))
        except FileNotFoundError:
            return
        except (ValueError, RecursionError) as error:
            reason = "contains no measurements; remove it, or run without --resume"
            raise FileFormatError(self.path, reason) from error
        if not _is_ours(content):
            raise FileFormatError(
                self.path, "contains no measurements; remove it, or run without --resume"
            )
        if content["settings"] != self._settings:
            raise FileFormatError(
                self.path,
                f"was measured with {_listed(content['settings'])}, not with "
                f"{_listed(self._settings)}; use the same options, another folder, or run "
                "without --resume",
            )
        for name, entry in content["measurements"].items():
            self.values[name] = entry["value"]
            self.seconds[name] = entry["seconds"]
            self._sources[name] = entry["source"]
        self.foreign_count = sum(one != self._source for one in self._sources.values())

    def save(self, name: str, value: Any, seconds: float = 0.0) -> None:
        """Save a measurement and its time, in memory and in the file."""
        self.values[name] = value
        self.seconds[name] = seconds
        self._sources[name] = self._source
        content = {
            "layout": _LAYOUT,
            "settings": self._settings,
            "measurements": {
                one: {"source": self._sources[one], "seconds": self.seconds[one], "value": kept}
                for one, kept in self.values.items()
            },
        }
        with atomic_write(self.path) as part:
            part.write_text(json.dumps(content, allow_nan=False), encoding="utf-8")


def _is_ours(content: Any) -> bool:
    return (
        isinstance(content, dict)
        and content.get("layout") == _LAYOUT
        and isinstance(content.get("settings"), dict)
        and isinstance(content.get("measurements"), dict)
        and all(
            isinstance(entry, dict)
            and "value" in entry
            and isinstance(entry.get("source"), str)
            and isinstance(entry.get("seconds"), int | float)
            for entry in content["measurements"].values()
        )
    )


def _listed(settings: Mapping[str, Any]) -> str:
    return ", ".join(f"{name} {value}" for name, value in settings.items())
