"""Translate the engine's WGSL to SPIR-V, HLSL, MSL and GLSL, and validate the translations.

    pip install dawn-python
    apt install glslang-tools mesa-vulkan-drivers spirv-cross spirv-tools
    python benchmarks/shader_languages.py
    python benchmarks/shader_languages.py --write FOLDER

Passes every program that the graphics device compiles for tracers, images and two users' kernels to
Dawn, the WebGPU implementation of Chromium. Dawn's compiler, Tint, translates WGSL to SPIR-V for
its Vulkan backend; with ``dump_shaders``, Dawn logs the result. spirv-cross translates SPIR-V to
the other languages. SPIR-V is validated by spirv-val; GLSL and HLSL by glslangValidator, whose HLSL
front end supports a part of the language. No validator of MSL runs here.
"""

import argparse
import contextlib
import ctypes
import importlib.util
import itertools
import os
import re
import runpy
import shutil
import subprocess
import tempfile
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple
from unittest import mock

import numpy as np

import raystream as rs
from raystream.graphics import hybrid, pipelines, streams
from raystream.graphics.errors import GraphicsError
from raystream.graphics.pipelines import Program
from raystream.structures import names_with

TOOLS = ("glslangValidator", "spirv-as", "spirv-cross", "spirv-val")

#: Dawn accepts no value for a constant that an entry point does not use.
_UNUSED = re.compile(r'constant "*(\w+)"* not found.*?entryPoint: "(\w+)"', re.DOTALL)

#: A store to an atomic counter: all of ours are u32.
_STORE = re.compile(r"OpAtomicStore %(\w+)")

#: Text in the first line of Dawn's log entries.
_DUMPED = "SPIRV disassembly"

#: Suffixes by which glslangValidator recognises stages, by their names in SPIR-V.
_STAGES = {"Vertex": "vert", "Fragment": "frag", "GLCompute": "comp"}

#: Machines, and the options of structures besides the defaults.
_MACHINES = ("compute", "branching", "multipass")
_TRAVERSALS = ("restart", "backtrack", "short-stack")

#: Modes that run as one loop of fragment programs.
_MODES = ("raycast", "vis", "shadow", "whitted", "path", "kajiya")

#: Arguments of spirv-cross and of the validator, by language; {stage} is one of `_STAGES`.
LANGUAGES: dict[str, tuple[str, list[str], list[str] | None]] = {
    "HLSL": ("hlsl", ["--hlsl", "--shader-model", "60"], ["-D", "-e", "main", "-V"]),
    "MSL": ("metal", ["--msl", "--msl-version", "20400"], None),
    "GLSL": ("glsl", ["--version", "450", "--no-420pack-extension"], []),
}


class Compiled(NamedTuple):
    """A program as the graphics device compiles it.

    Attributes
    ----------
    name : str
        As in errors.
    program : Program
    constants : dict of str to float
    targets : tuple of (str, bool) or None
        Format of each render target, and whether it is written; None for a compute program.
    """

    name: str
    program: Program
    constants: dict[str, float]
    targets: tuple[tuple[str, bool], ...] | None


class Translation(NamedTuple):
    """A stage of a program, in all languages.

    Attributes
    ----------
    name : str
    stage : str
        "vert", "frag" or "comp"; empty if Dawn rejects the WGSL.
    texts : dict of str to str
        By language; SPIR-V as assembly.
    errors : dict of str to str
        The message of a tool, for languages that failed.
    """

    name: str
    stage: str
    texts: dict[str, str]
    errors: dict[str, str]


def missing() -> str:
    """Why nothing can be translated here; empty if it can."""
    absent = [tool for tool in TOOLS if shutil.which(tool) is None]
    if absent:
        return f"needs {', '.join(absent)}: apt install glslang-tools spirv-cross spirv-tools"
    if importlib.util.find_spec("pydawn") is None:
        return "needs pydawn: pip install dawn-python"
    return ""


@contextlib.contextmanager
def noting() -> Iterator[dict[Any, Compiled]]:
    """Collect the programs that are compiled in a block, each once."""
    found: dict[Any, Compiled] = {}
    make = pipelines._made

    def note(opened, name, program, constants, drawn, made):
        targets = None if drawn is None else drawn[0]
        key = program.source, program.entry, program.vertex, tuple(constants.items()), targets
        found.setdefault(key, Compiled(name, program, dict(constants), targets))
        return make(opened, name, program, constants, drawn, made)

    with mock.patch.object(pipelines, "_made", note):
        yield found


def tracers() -> Iterator[dict[str, Any]]:
    """Options of tracers: every structure, machine, traversal and way of counting."""
    for structure in names_with("graphics"):
        for machine in _MACHINES:
            options = {"structure": structure, "device": "graphics", "machine": machine}
            yield options
            if structure == "kdtree":
                yield from ({**options, "traversal": one} for one in _TRAVERSALS)
            if machine == "multipass":
                yield {**options, "loop": "queries"}
                yield {**options, "loop": "queries", "traversal": "restart"}


def engine_programs() -> list[Compiled]:
    """Collect the programs of tracers and images."""
    scene = rs.load("cornell")
    placed = rs.Scene.instances(scene, np.eye(3, 4)[None])
    origins, directions = np.zeros((4, 3)), np.eye(4, 3) + 0.1
    with noting() as found:
        for options, one in itertools.product(tracers(), (scene, placed)):
            try:
                for counters in (False, True):
                    tracer = rs.Tracer(one, **options, counters=counters)
                    for query in ("first_hit", "any_hit", "count_hits", "multi_hit"):
                        getattr(tracer, query)(origins, directions)
            except (GraphicsError, TypeError, ValueError):
                continue  # a combination that is not supported
        hybrid(scene, (8, 8))
        for mode in _MODES:
            for name in ("cornell", "spheres"):  # an area light; mirrors, glass, points
                for memory in ("buffers", "textures"):
                    looping = rs.Tracer(
                        rs.load(name), "grid", "graphics", machine="multipass", memory=memory
                    )
                    rs.render(looping, mode, size=(8, 8), samples=1)
    return list(found.values())


def kernel_programs() -> list[Compiled]:
    """Collect the programs of the examples' kernels, including one with a condition."""
    examples = Path(__file__).resolve().parents[1] / "examples" / "streams"
    react = runpy.run_path(str(examples / "reaction_diffusion.py"))["REACT"]
    exchange = runpy.run_path(str(examples / "sort_on_graphics.py"))["EXCHANGE"]
    pairs = streams.Stream.zeros(16, (np.float32, 2))
    with noting() as found:
        streams.Kernel(
            react,
            inputs={"at": pairs, "i": streams.INDEX},
            outputs=pairs,
            gathers={"field": streams.GatherArray(pairs, (4, 4))},
            constants={"spread": (0.2, 0.1), "feed": 0.03, "kill": 0.06},
        )
        streams.Kernel(
            exchange,
            inputs={"own": pairs, "i": streams.INDEX},
            outputs=pairs,
            gathers={"records": pairs},
            constants={"block": 2, "distance": 1},
            where=streams.Stream.zeros(16, np.int32) == 0,
        ).execute(counters=streams.Counters())
    return list(found.values())


class Dawn:
    """A device of Dawn that logs the SPIR-V it generates from WGSL."""

    def __init__(self) -> None:
        os.environ.setdefault("XDG_RUNTIME_DIR", tempfile.gettempdir())
        from pydawn import utils, webgpu

        self._gpu, self._utils = webgpu, utils
        self._texts: list[str] = []
        with mock.patch.object(utils, "to_c_string", _with_dumps(utils.to_c_string)):
            adapter = utils.request_adapter_sync(webgpu.WGPUPowerPreference_HighPerformance)
            self._device = utils.request_device_sync(adapter)

        def log(_kind: Any, text: Any, _data: Any) -> None:
            self._texts.append(utils.from_wgpu_str(text))

        self._log = webgpu.WGPULoggingCallback(log)  # kept alive
        webgpu.wgpuDeviceSetLoggingCallback(self._device, self._log, None)

    def spirv(self, compiled: Compiled) -> list[str]:
        """The assembly of each stage; raises RuntimeError if Dawn rejects the program."""
        # wgpu's own attribute for a forced early test, which WGSL does not have.
        source = compiled.program.source.replace("@early_depth_test(force)", "")
        module = self._utils.create_shader_module(self._device, source)
        unused: set[tuple[str, str]] = set()
        while True:
            self._texts.clear()
            error = self._pipeline(compiled, module, unused)
            match = _UNUSED.search(error)
            if match is None or match.group(2, 1) in unused:
                break
            unused.add(match.group(2, 1))
        if error:
            raise RuntimeError(error)
        return [one.partition("\n")[2] for one in self._texts if _DUMPED in one.partition("\n")[0]]

    def _pipeline(self, compiled: Compiled, module: Any, unused: set[tuple[str, str]]) -> str:
        """Make a pipeline; returns Dawn's error, if there is one."""
        gpu, program = self._gpu, compiled.program

        def fill(stage: Any, entry: str) -> None:
            used = {
                key: one for key, one in compiled.constants.items() if (entry, key) not in unused
            }
            entries = (gpu.WGPUConstantEntry * len(used))()
            for place, (key, value) in zip(entries, used.items(), strict=True):
                place.key, place.value = self._utils.to_wgpu_str(key), value
            stage.module, stage.entryPoint = module, self._utils.to_wgpu_str(entry)
            stage.constantCount, stage.constants = len(entries), entries

        gpu.wgpuDevicePushErrorScope(self._device, gpu.WGPUErrorFilter_Validation)
        if compiled.targets is None:
            compute = gpu.WGPUComputePipelineDescriptor()
            fill(compute.compute, program.entry)
            gpu.wgpuDeviceCreateComputePipeline(self._device, compute)
        else:
            render = gpu.WGPURenderPipelineDescriptor()
            fill(render.vertex, program.vertex)
            render.primitive.topology = gpu.WGPUPrimitiveTopology_TriangleList
            render.multisample.count, render.multisample.mask = 1, 0xFFFFFFFF
            targets = (gpu.WGPUColorTargetState * len(compiled.targets))()
            for target, (texel, is_written) in zip(targets, compiled.targets, strict=True):
                # A narrower format, which SPIR-V does not show: Dawn allows 32 bytes per pixel.
                name = f"WGPUTextureFormat_R16{texel.partition('32')[2].capitalize()}"
                target.format, target.writeMask = getattr(gpu, name), 0xF * is_written
            fragment = gpu.WGPUFragmentState()
            fill(fragment, program.entry)
            fragment.targetCount, fragment.targets = len(targets), targets
            render.fragment = ctypes.pointer(fragment)
            gpu.wgpuDeviceCreateRenderPipeline(self._device, render)
        return self._utils.pop_error(self._device) or ""


def _with_dumps(to_c_string: Any) -> Any:
    """Replace the toggles that pydawn enables and disables on a device, one each, with ours."""
    ours = {
        "allow_unsafe_apis": "dump_shaders",
        # OpenGL's GLSL has no demotion: without it, Tint ends a discarded invocation later.
        "timestamp_quantization": "vulkan_use_demote_to_helper_invocation_extension",
    }
    return lambda text: to_c_string(ours.get(text, text))


def translate(name: str, assembly: str, folder: Path) -> Translation:
    """Assemble, validate and translate a stage."""
    stage = next(short for long, short in _STAGES.items() if f"OpEntryPoint {long}" in assembly)
    found = Translation(name, stage, {"SPIR-V": assembly}, {})
    binary, exchanging = folder / "stage.spv", folder / "exchanging.spv"
    said = _assemble(assembly, binary)
    # In HLSL, spirv-cross declares the old value of an exchange, but not that of a store.
    said = said or _assemble(
        _STORE.sub(r"%old_\1 = OpAtomicExchange %uint %\1", assembly), exchanging
    )
    if said:
        found.errors["SPIR-V"] = said
        return found
    for language, (suffix, arguments, check) in LANGUAGES.items():
        path = folder / f"stage.{suffix}"
        source = exchanging if language == "HLSL" else binary
        said = _run("spirv-cross", source, *arguments, "--output", path)
        if not said and check is not None:
            said = _run("glslangValidator", "-S", stage, *check, path)
        if said:
            found.errors[language] = said
        else:
            found.texts[language] = path.read_text(encoding="utf-8")
    return found


def _assemble(assembly: str, binary: Path) -> str:
    """Assemble and validate; returns the error, if there is one."""
    text = binary.with_suffix(".spvasm")
    text.write_text(assembly, encoding="utf-8")
    said = _run("spirv-as", "--target-env", "spv1.3", text, "-o", binary)
    return said or _run("spirv-val", "--target-env", "vulkan1.1", binary)


def _run(*command: Any) -> str:
    """Run a tool; returns its message if it failed."""
    ran = subprocess.run(
        [str(one) for one in command],
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
        cwd=Path(str(command[-1])).parent,
    )
    return "" if ran.returncode == 0 else (ran.stdout + ran.stderr).strip() or "failed"


def translations(programs: list[Compiled]) -> list[Translation]:
    """Translate programs; stages with the same assembly only once."""
    dawn = Dawn()
    stages: dict[str, str] = {}
    refused = []
    for compiled in programs:
        try:
            assemblies = dawn.spirv(compiled)
        except RuntimeError as error:
            refused.append(Translation(compiled.name, "", {}, {"WGSL": str(error)}))
            continue
        for assembly in assemblies:
            stages.setdefault(assembly, compiled.name)
    with tempfile.TemporaryDirectory() as folder:
        found = [translate(name, text, Path(folder)) for text, name in stages.items()]
    return [*refused, *found]


def write(found: list[Translation], folder: Path) -> None:
    """Write all texts to a folder."""
    folder.mkdir(parents=True, exist_ok=True)
    for number, one in enumerate(found):
        for language, text in one.texts.items():
            suffix = LANGUAGES[language][0] if language in LANGUAGES else "spvasm"
            (folder / f"{number:03}.{one.stage}.{suffix}").write_text(text, encoding="utf-8")


def is_too_large(one: Translation) -> bool:
    """Whether Dawn rejects a program for its storage buffers: it allows ten on any adapter."""
    return "number of storage buffers" in one.errors.get("WGSL", "")


def report(programs: int, found: list[Translation]) -> None:
    """Print the number of stages by language, and all errors."""
    stages = Counter(one.stage for one in found if one.stage)
    refused = sum(map(is_too_large, found))
    print(f"{programs} programs; {refused} have more storage buffers than Dawn allows")
    print(f"{stages.total()} different stages: {dict(stages)}")
    for language in ("SPIR-V", *LANGUAGES):
        good = sum(language in one.texts and language not in one.errors for one in found)
        check = "translated, not validated" if language == "MSL" else "valid"
        print(f"{language:7} {good:4} {check}")
    for one in found:
        for language, said in one.errors.items():
            if not is_too_large(one):
                print(f"  {one.name}, {one.stage}, {language}: {said[:400]}")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--write", type=Path, metavar="FOLDER", help="write all translations")
    options = parser.parse_args()
    if reason := missing():
        raise SystemExit(reason)
    collected = [*engine_programs(), *kernel_programs()]
    results = translations(collected)
    report(len(collected), results)
    if options.write:
        write(results, options.write)
    raise SystemExit(any(one.errors and not is_too_large(one) for one in results))
