"""WGSL in other languages: Dawn translates it to SPIR-V, and spirv-cross that to the others."""

from __future__ import annotations

import importlib.util
from pathlib import Path

import pytest

from conftest import skip_without_adapter
from extras import need

need("pydawn")

SCRIPT = Path(__file__).resolve().parents[2] / "benchmarks" / "shader_languages.py"
if not SCRIPT.is_file():
    pytest.skip("the script is not in an installed package", allow_module_level=True)

LANGUAGES = {"SPIR-V", "HLSL", "MSL", "GLSL"}

BROKEN = """
OpCapability Shader
OpMemoryModel Logical GLSL450
OpEntryPoint Fragment %main "main"
%void = OpTypeVoid
%kind = OpTypeFunction %void
%main = OpFunction %void None %kind
%label = OpLabel
OpReturn
OpFunctionEnd
"""


@pytest.fixture(scope="module")
def languages():
    skip_without_adapter()
    spec = importlib.util.spec_from_file_location("shader_languages", SCRIPT)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    if reason := module.missing():
        pytest.skip(reason)
    return module


def test_users_kernels_are_valid_in_every_language(languages):
    programs = languages.kernel_programs()
    found = languages.translations(programs)
    assert len(programs) == 3
    assert {one.stage for one in found} == {"vert", "frag"}
    assert {one.name for one in found} == {"react", "exchange"}
    for one in found:
        assert not one.errors
        assert set(one.texts) == LANGUAGES
        assert "OpEntryPoint" in one.texts["SPIR-V"]
        assert "using namespace metal" in one.texts["MSL"]
        assert "#version 450" in one.texts["GLSL"]
        assert "SV_" in one.texts["HLSL"]


@pytest.mark.exhaustive
def test_the_engines_programs_are_valid_in_every_language(languages):
    programs = languages.engine_programs()
    found = languages.translations(programs)
    assert len(programs) > 300
    errors = {one.name: one.errors for one in found if one.errors}
    assert all(languages.is_too_large(one) for one in found if one.errors), errors
    assert len(errors) < 10
    assert {one.stage for one in found if not one.errors} == {"vert", "frag", "comp"}


def test_what_is_not_valid_is_said(languages, tmp_path):
    found = languages.translate("broken", BROKEN, tmp_path)
    assert found.stage == "frag"
    assert "OriginUpperLeft" in found.errors["SPIR-V"]
    fine = BROKEN.replace("%void =", "OpExecutionMode %main OriginUpperLeft\n%void =")
    assert not languages.translate("fine", fine, tmp_path).errors


def test_wgsl_that_dawn_refuses_is_an_error_of_the_program(languages):
    program = languages.Program("fn f( {}", "f", [])
    (found,) = languages.translations([languages.Compiled("mine", program, {}, None)])
    assert "expected" in found.errors["WGSL"]
    assert not found.texts
    assert not languages.is_too_large(found)


def test_missing_tools_are_said(languages, monkeypatch, tmp_path):
    monkeypatch.setenv("PATH", str(tmp_path))
    assert languages.missing().startswith(
        "needs glslangValidator, spirv-as, spirv-cross, spirv-val"
    )
