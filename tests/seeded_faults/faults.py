"""The faults of faults.toml: where each is, and the files of tests that may catch it."""

from __future__ import annotations

import hashlib
import importlib.util
import tomllib
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

from ci_script import load

ROOT = Path(__file__).resolve().parents[2]
FAULTS = Path(__file__).with_name("faults.toml")
SOURCES, LAB = "src/raystream", "lab/src/raystream_lab"

#: Hash of a file's code, without comments, docstrings and layout.
code_hash = load("nightly").code_hash

#: Files that compare tracers with each other or with an oracle, the likeliest to fail first.
AGREEMENT = (
    "tests/test_agreement.py",
    "tests/test_batches.py",
    "tests/test_surfaces.py",
    "tests/test_watertight.py",
    "tests/test_properties.py",
    "tests/test_update.py",
    "tests/test_cast.py",
    "tests/test_closest_point.py",
    "tests/test_float64.py",
)

#: Files whose code those tests do not run: they neither render, nor read files, nor use CUDA.
NOT_TRACED = (
    *("adapters/", "bench/", "cli/", "cluster/", "cuda/", "jax/", "lab/", "line_of_sight/"),
    *("notebook.py", "physics/", "ray_files/", "rendering/", "scene/io/", "scene/procedural/"),
    *("stepper/", "torch/", "viewer/", "web/"),
)


@dataclass(frozen=True)
class Fault:
    """An entry of faults.toml, where the fields are explained."""

    name: str
    what: str
    file: str
    old: str
    new: str
    tests: tuple[str, ...]
    needs: tuple[str, ...] = ()
    environment: Mapping[str, str] = field(default_factory=dict)
    hangs: bool = False

    @property
    def path(self) -> str:
        """The file, from the repository's root."""
        room, _, rest = self.file.partition("/")
        return f"{LAB}/{rest}" if room == "lab" else f"{SOURCES}/{self.file}"

    @property
    def room(self) -> str:
        """The package of raystream that it is in, or a top-level module; or ``lab``."""
        return self.file.partition("/")[0].removesuffix(".py")

    @property
    def missing(self) -> list[str]:
        """Modules that are needed and not installed."""
        return [name for name in self.needs if importlib.util.find_spec(name) is None]

    def digest(self, root: Path) -> str:
        """Hash of the entry, except for its description, and of the code of its file."""
        entry = repr(replace(self, what=""))
        code = code_hash(self.path, (root / self.path).read_bytes())
        return hashlib.sha256(f"{entry} {code}".encode()).hexdigest()[:16]

    def seeded(self, text: str) -> str:
        """The file's text with the fault.

        Raises
        ------
        ValueError
            If the place is not there, or there several times.
        """
        count = text.count(self.old)
        if count != 1:
            raise ValueError(f"{self.name}: its text is {count} times in {self.path}, not once")
        return text.replace(self.old, self.new)

    def room_files(self, root: Path) -> list[str]:
        """The files of tests that are named with it, those of its module first in each folder."""
        module = Path(self.file).stem
        files: dict[str, None] = {}
        for test in self.tests:
            path = root / test.partition("::")[0]
            found = sorted(path.rglob("test_*.py")) if path.is_dir() else [path]
            found.sort(key=lambda file: module not in file.stem)
            files.update(dict.fromkeys(file.relative_to(root).as_posix() for file in found))
        return list(files)

    def agreement_files(self, root: Path) -> list[str]:
        """The files of `AGREEMENT` that may catch it and are not among those of its room."""
        if self.file.startswith(NOT_TRACED):
            return []
        room = self.room_files(root)
        return [file for file in AGREEMENT if (root / file).exists() and file not in room]


def read_faults(path: Path = FAULTS) -> list[Fault]:
    """Read the faults, in the order of the file."""
    entries = tomllib.loads(path.read_text(encoding="utf-8"))["faults"]
    tuples = ("tests", "needs")
    return [
        Fault(**{key: tuple(value) if key in tuples else value for key, value in entry.items()})
        for entry in entries
    ]


def chosen_faults(names: Sequence[str], faults: Iterable[Fault]) -> list[Fault]:
    """The faults of these names or rooms; all without any."""
    faults = list(faults)
    for name in names:
        if not any(name in (fault.name, fault.room) for fault in faults):
            raise SystemExit(f"no fault and no room {name!r}; see --list")
    return [f for f in faults if not names or f.name in names or f.room in names]
