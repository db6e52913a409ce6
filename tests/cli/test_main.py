"""All commands: exit codes, one line on stderr, quick help, completion."""

from __future__ import annotations

import inspect
import os
import subprocess
import sys
import warnings
from collections.abc import Callable
from pathlib import Path

import pytest
import typer

import raystream
from raystream.cli import app, options
from raystream.cli.brightness import LIT
from raystream.cli.camera_options import PROJECTIONS
from raystream.cli.sampling import NOISY
from raystream.core.choices import MACHINES, SCHEDULERS
from raystream.core.errors import FileFormatError, RaystreamWarning
from raystream.structures import STRUCTURES

ROOT = Path(__file__).resolve().parents[2]
HEAVY = ("numba", "llvmlite", "trimesh", "PIL", "pooch", "OpenEXR")


@pytest.fixture
def start(environment) -> Callable[..., subprocess.CompletedProcess[str]]:
    """Run ``python -m raystream`` in a separate process."""

    def call(*arguments: str, program=("-m", "raystream"), variables=None, **options):
        return subprocess.run(
            [sys.executable, *program, *arguments],
            env={**environment, **(variables or {})},
            stdin=subprocess.DEVNULL,
            stderr=subprocess.PIPE,
            text=True,
            timeout=120,
            **({"stdout": subprocess.PIPE} | options),
        )

    return call


def test_version(run):
    assert run("--version").out == f"raystream {raystream.__version__}\n"


def test_without_arguments_help_is_shown(run):
    result = run()
    assert result.code == 0
    assert result.err == ""
    assert all(command in result.out for command in ("render", "info", "query"))


@pytest.mark.ci
@pytest.mark.parametrize("command", [[], ["render"], ["info"], ["query"], ["compare"]])
def test_help_is_quick(start, command):
    code = (
        "import atexit, sys\n"
        "from raystream.cli import main\n"
        "show = lambda: print(*{name.partition('.')[0] for name in sys.modules}, file=sys.stderr)\n"
        "atexit.register(show)\n"
        "main()\n"
    )
    result = start(*command, "--help", program=("-c", code))
    assert result.returncode == 0
    assert "Usage" in result.stdout
    imported = set(result.stderr.split())
    assert "raystream" in imported
    assert not imported & set(HEAVY)


def test_help_of_render_shows_colons_and_numbers(run, monkeypatch):
    monkeypatch.setenv("COLUMNS", "200")
    assert "0:100, 0:100:5, 7, -1, or : for all." in " ".join(run("render", "--help").out.split())


COMMANDS = typer.main.get_command(app)


@pytest.mark.parametrize("name", [None, *COMMANDS.commands])
def test_help_has_the_letters_that_were_written(run, name):
    """No emoji in place of codes such as ``:100:``, and nothing lost that looks like markup."""
    command = COMMANDS if name is None else COMMANDS.commands[name]
    shown = run(*([] if name is None else [name]), "--help").out
    written = [command.help, *(getattr(option, "help", None) for option in command.params)]
    if name is None:
        written = [*written, *COMMANDS.commands]
    assert shown.isascii()
    for text in filter(None, written):
        assert "".join(text.split()) in "".join(shown.split())


def test_help_of_render_fits_on_two_screens(run, monkeypatch):
    monkeypatch.setenv("COLUMNS", "100")
    assert len(run("render", "--help").out.splitlines()) <= 100


def test_an_example_shows_each_option_of_render():
    pages = [ROOT / "README.md", *(ROOT / "docs").rglob("*.rst")]
    lines = [line for page in pages for line in page.read_text(encoding="utf-8").splitlines()]
    shown = {word for line in lines if "raystream render" in line for word in line.split()}
    options = [one for one in COMMANDS.commands["render"].params if one.param_type_name == "option"]
    names = {frozenset([*one.opts, *one.secondary_opts]): one.secondary_opts for one in options}
    missing = [sorted(every) for every, off in names.items() if not every & shown or {*off} - shown]
    assert missing == [["--help", "-h"]] or missing == []


def test_summaries_of_commands_are_whole(run):
    assert "..." not in run("--help").out.partition("Commands:")[2]


@pytest.mark.parametrize(
    ("arguments", "named"),
    [
        (["--bogus"], "--bogus"),
        (["rendr"], "rendr"),
        (["render", "--bogus"], "--bogus"),
        (["render", "cornell", "more"], "more"),
        (["info"], "SCENE"),
        (["query", "cornell"], "RAYS"),
        (["compare", "a.png"], "REFERENCE"),
        (["query", "cornell", "rays.npz"], "--output"),
    ],
)
def test_arguments_that_are_none_are_refused(run, arguments, named):
    assert named in run(*arguments).complaint


SCENE_COMMANDS = [["render"], ["info"]]

BAD_MODELS = {
    "missing.obj": None,
    "empty.obj": b"",
    "truncated.ply": b"ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\n",
    "huge.ply": b"ply\nformat binary_little_endian 1.0\nelement vertex 4000000000\n"
    b"property float x\nproperty float y\nproperty float z\nend_header\n",
    "binary.off": bytes(range(256)),
    "list.gltf": b"[1, 2, 3]",
    "damaged.obj.gz": b"\x1f\x8b\x08\x00 and then something else",
    "unknown.xyz": b"1 2 3",
    "damaged.npz": b"PK\x03\x04 no archive",
}


@pytest.mark.parametrize("name", BAD_MODELS)
@pytest.mark.parametrize("command", SCENE_COMMANDS, ids=" ".join)
def test_bad_model_is_refused_in_one_line(run, tmp_path, command, name):
    if BAD_MODELS[name] is not None:
        (tmp_path / name).write_bytes(BAD_MODELS[name])
    complaint = run(*command, name).complaint
    assert complaint.startswith(f"{name}: ")
    assert not list(tmp_path.glob("*.png"))


@pytest.mark.parametrize(
    ("arguments", "named"),
    [
        (["nosuch"], "nosuch"),
        (["cornell", "--triangles", "0"], "--triangles"),
        (["cornell", "--triangles", "3"], "triangles"),
        (["cornell", "--time", "1"], "time"),
        (["cornell", "--time", "nan"], "--time"),
        (["cornell:many"], "cornell:many"),
        (["cornell:3"], "triangles"),
        (["square.obj", "--triangles", "100"], "triangles"),
        (["cornell", "--structure", "octree"], "--structure"),
        (["cornell", "--device", "abacus"], "--device"),
        (["cornell", "--threads", "0"], "--threads"),
        (["cornell", "--threads", "two"], "--threads"),
    ],
)
@pytest.mark.parametrize("command", SCENE_COMMANDS, ids=" ".join)
def test_bad_option_is_refused_in_one_line(run, square, command, arguments, named):
    assert named in run(*command, *arguments).complaint


def test_bad_number_of_threads_in_the_environment(run, monkeypatch):
    monkeypatch.setenv("RAYSTREAM_THREADS", "many")
    assert "RAYSTREAM_THREADS" in run("info", "cornell").complaint


def test_complaint_keeps_to_one_line_whatever_a_name_holds(run):
    assert "?[31m" in run("info", "two\nlines\x1b[31m.obj").complaint


def test_usable_part_is_used_with_one_line_of_warning(run, tmp_path):
    (tmp_path / "bad.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nv nan 0 0\nf 1 2 3\nf 1 2 4\n")
    result = run("info", "bad.obj", "--json")
    assert result.code == 0
    assert result.figures["nonfinite_triangles"] == 1
    assert result.err.startswith("warning: bad.obj: ")
    assert result.err.count("\n") == 1


def test_warnings_of_others_are_left_alone(run, monkeypatch, square):
    def load(*_, **__):
        warnings.warn("of another kind", UserWarning, stacklevel=1)

    monkeypatch.setattr("raystream.scene.load.load", load)
    with pytest.raises(UserWarning, match="of another kind"):  # pytest makes errors of them
        run("info", "square.obj")


@pytest.mark.parametrize("error", [ValueError, TypeError, OSError, KeyError])
def test_bug_is_not_taken_for_bad_input(monkeypatch, square, run, error):
    def load(*_, **__):
        raise error("a bug")

    monkeypatch.setattr("raystream.scene.load.load", load)
    with pytest.raises(error, match="a bug"):
        run("info", "square.obj")


@pytest.mark.parametrize(
    ("error", "complaint"),
    [
        (MemoryError("5 GB are needed"), "out of memory: 5 GB are needed"),
        (MemoryError(), "out of memory"),
        (FileFormatError("texture.png", "is damaged"), "texture.png: is damaged"),
    ],
)
def test_error_while_rendering_that_is_no_bug(monkeypatch, run, square, error, complaint):
    def fail(*_, **__):
        raise error

    monkeypatch.setattr("raystream.tracer.Tracer.first_hit", fail)
    assert run("render", "square.obj").complaint == complaint
    assert not Path("square.png").exists()


@pytest.mark.parametrize("how", ["option", "environment"])
def test_debug_shows_the_traceback(run, monkeypatch, how):
    if how == "environment":
        monkeypatch.setenv("RAYSTREAM_DEBUG", "1")
    result = run(*(["--debug"] if how == "option" else []), "info", "nosuch.obj")
    assert result.code == 2
    assert "Traceback" in result.err
    assert result.err.splitlines()[-1].startswith("raystream: nosuch.obj: ")


def test_interrupt_is_one_line(monkeypatch, run, square):
    def load(*_, **__):
        raise KeyboardInterrupt

    monkeypatch.setattr("raystream.scene.load.load", load)
    result = run("info", "square.obj")
    assert result.code == 130
    assert result.out == ""
    assert result.err == "interrupted\n"


@pytest.mark.ci
@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="needs POSIX pipes")
@pytest.mark.parametrize("arguments", [["info", "square.obj"], ["info", "square.obj", "--json"]])
def test_closed_pipe_is_quiet(start, square, arguments):
    reader, writer = os.pipe()
    os.close(reader)
    result = start(*arguments, stdout=writer, cwd=square.parent)
    os.close(writer)
    assert result.returncode == 1
    assert result.stderr == ""


@pytest.mark.ci
@pytest.mark.skipif(not Path("/dev/full").exists(), reason="needs /dev/full")
def test_full_disk_behind_stdout_is_one_line(start, square):
    with open("/dev/full", "w") as full:
        result = start("info", "square.obj", stdout=full, cwd=square.parent)
    assert result.returncode == 2
    assert result.stderr.startswith("raystream: stdout: ")
    assert result.stderr.count("\n") == 1


# Names for help and completion, which must not import the modules they name.


def test_names_are_those_of_the_library():
    from raystream import MODES
    from raystream.rendering.heatmap import HEATMAPS
    from raystream.rendering.lighting import ADDED, LIGHTS
    from raystream.rendering.render import RENDERERS
    from raystream.rendering.tone import TONES
    from raystream.scene.procedural import BUILTIN
    from raystream.scene.projections import PROJECTIONS as LIBRARY_PROJECTIONS
    from raystream.tracer.devices import DEVICES, device_of

    assert set(options.MODES) == set(MODES)
    assert tuple(HEATMAPS) == options.HEATMAPS
    assert options.LIGHTS == LIGHTS
    assert set(LIT) == set(ADDED)
    assert set(PROJECTIONS) == set(LIBRARY_PROJECTIONS)
    assert {name for name, mode in RENDERERS.items() if mode.default_samples > 1} == set(NOISY)
    assert tuple(TONES) == options.TONES
    assert tuple(BUILTIN) == options.SCENES
    machines = {name: device_of(name).machines.names for name in options.DEVICES}
    assert set(MACHINES) == {"multipass"}.union(*machines.values())
    assert {name: known[0] for name, known in machines.items()} == options.DEFAULT_MACHINES
    assert set(options.DEVICES) <= set(DEVICES)


@pytest.mark.parametrize(
    ("name", "known"),
    [("structure", STRUCTURES), ("device", options.DEVICES), ("scheduler", SCHEDULERS)],
)
def test_first_name_is_the_librarys_default(name, known):
    from raystream.machines import MultipassBackend

    taker = MultipassBackend if name == "scheduler" else raystream.Tracer
    assert inspect.signature(taker).parameters[name].default == next(iter(known))


@pytest.mark.parametrize(
    ("words", "offered", "kept_back"),
    [
        ("raystream re", {"render"}, {"info"}),
        ("raystream render co", {"cornell", "conference"}, {"robots"}),
        ("raystream info ro", {"robots"}, {"cornell"}),
        ("raystream render cornell --mode ", {"raycast", "vis"}, {"bvh"}),
        ("raystream render cornell --heatmap ", {"cells", "tests", "steps"}, {"vis"}),
        ("raystream render cornell --tone ", {"linear", "aces"}, {"vis"}),
        ("raystream info cornell --machine ", {"branching", "multipass", "compute"}, {"naive"}),
        ("raystream query cornell rays.npz --device ", {"cpu", "graphics"}, {"compute"}),
        ("raystream query cornell rays.npz --scheduler ", {"naive", "double"}, {"multipass"}),
        ("raystream query cornell rays.npz --structure b", {"bvh", "brute"}, {"vis"}),
        ("raystream query cornell rays.npz --crossings s", {"surfaces"}, {"triangles"}),
    ],
)
def test_completion(run, monkeypatch, words, offered, kept_back):
    monkeypatch.setenv("_RAYSTREAM_COMPLETE", "complete_bash")
    monkeypatch.setenv("COMP_WORDS", words)
    monkeypatch.setenv("COMP_CWORD", str(words.count(" ")))
    result = run()
    completions = set(result.out.split())
    assert offered <= completions
    assert not kept_back & completions
    assert result.err == ""


def test_completion_of_a_file_is_left_to_the_shell(tmp_path):
    assert list(options.complete_scenes("./models/")) == []
    assert ("cornell", "the Cornell box") in [
        (name, text[:15]) for name, text in options.complete_scenes("")
    ]


def test_warning_class_is_the_one_that_is_shown(run, monkeypatch, square):
    from raystream.scene import load as module

    load = module.load

    def load_in_part(*arguments, **named):
        warnings.warn("square.obj:\n only a part", RaystreamWarning, stacklevel=1)
        return load(*arguments, **named)

    monkeypatch.setattr(module, "load", load_in_part)
    assert run("info", "square.obj").err == "warning: square.obj: only a part\n"
