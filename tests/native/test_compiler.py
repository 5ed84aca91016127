import re
import sys
from pathlib import Path

import pytest

from splatrl.bodies import Box, Capsule, Sphere
from splatrl.capture.fitting.structs import kernel_defines as fit_defines
from splatrl.collision.cuda import kernel_defines as collision_defines
from splatrl.native.cuda import compiler
from splatrl.native.cuda.compiler import FOLDERS, compiled
from splatrl.renderers.cuda import kernel_defines
from tests.native.kept import kept

SOURCES: dict[str, list[dict[str, int]]] = {
    "collide": [collision_defines(body) for body in (Box((0.4, 0.4, 0.1)), Sphere(0.1), Capsule(0.1, 0.2))],
    "render": [
        kernel_defines(antialiased, degree, levels, parts)
        for antialiased, degree, levels in ((True, 0, False), (True, 3, True), (False, 1, True), (False, 2, False))
        for parts in (False, True)
    ],
    "fit": [fit_defines(degree) for degree in range(4)],
    "place": [{}],
}
"""Every source of kernels, with every value of each of its macros."""
ARCHITECTURES = ("sm_80", "sm_90", "sm_120")
CHOSEN = {
    "collide": [("sm_90", 0), ("sm_80", 1), ("sm_120", 2)],
    "render": [("sm_90", 0), ("sm_80", 3), ("sm_120", 4), ("sm_80", 7)],
    "fit": [("sm_80", 0), ("sm_90", 1), ("sm_120", 2), *((arch, 3) for arch in ARCHITECTURES)],
    "place": [(arch, 0) for arch in ARCHITECTURES],
}
"""What is compiled of each source: architectures, and indices into ``SOURCES``. Every architecture occurs, every value
of each macro, and every combination of any two switches; for the fit, the degree that needs most registers occurs with
all architectures. For the renderer and the collision checker, the sm_90 variants are those that a dry run of
benchmarks/gpu.py compiles."""
COMPILED = [
    pytest.param(name, SOURCES[name][i], arch, marks=[] if arch == "sm_90" else [pytest.mark.slow])
    for name, variants in CHOSEN.items()
    for arch, i in variants
]

pytest.importorskip("cuda.core", reason="needs the extra cuda")


@pytest.fixture
def cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """An empty cache folder."""
    monkeypatch.setenv("SPLATRL_CACHE", str(tmp_path / "cache"))
    return tmp_path / "cache"


@pytest.fixture
def sources(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder with one kernel and one header, in place of the package's sources."""
    folder = tmp_path / "sources"
    folder.mkdir()
    (folder / "double.cu").write_text('#include "factor.h"\nextern "C" __global__ void f(float* x) { *x *= FACTOR; }\n')
    (folder / "factor.h").write_text("#define FACTOR 2.0f\n")
    monkeypatch.setattr(compiler, "FOLDERS", (folder,))
    return folder


def test_the_lists_cover_every_kernel_architecture_and_macro_value() -> None:
    assert set(SOURCES) == {path.stem for path in FOLDERS[0].glob("*.cu")}
    for name, many in SOURCES.items():
        assert {arch for arch, _ in CHOSEN[name]} == set(ARCHITECTURES), name
        macros = {macro for defines in many for macro in defines.items()}
        assert {macro for _, i in CHOSEN[name] for macro in many[i].items()} == macros, name


@pytest.mark.parametrize(("source", "defines", "arch"), COMPILED)
def test_every_kernel_compiles_for_every_architecture(source: str, defines: dict[str, int], arch: str) -> None:
    code, log = kept(source, arch, defines)
    assert code[:4] == b"\x7fELF"
    assert f"for '{arch}" in log and "registers" in log


@pytest.mark.parametrize(("source", "defines", "arch"), [one for one in COMPILED if one.values[0] == "fit"])
def test_the_kernels_of_the_fit_spill_no_registers(source: str, defines: dict[str, int], arch: str) -> None:
    _, log = kept(source, arch, defines)
    spilled = re.findall(r"(\d+) bytes stack frame, (\d+) bytes spill stores", log)
    assert spilled == [("0", "0")] * 8


@pytest.mark.slow
def test_the_renderer_spills_no_registers_on_a_gpu_with_little_shared_memory() -> None:
    _, log = kept("render", "sm_120", SOURCES["render"][4])
    assert re.findall(r"(\d+) bytes stack frame, (\d+) bytes spill stores", log) == [("0", "0")] * 2


def test_a_kernel_is_compiled_once_and_a_message_says_so(
    cache: Path, sources: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    first = compiled("double", "sm_90")
    assert "compiling double.cu for sm_90 (once)" in capsys.readouterr().err
    assert [path.suffix for path in cache.iterdir()] == [".cubin"]
    assert compiled("double", "sm_90") == first
    assert capsys.readouterr().err == ""


def test_a_change_of_header_architecture_or_macro_compiles_the_kernel_again(cache: Path, sources: Path) -> None:
    compiled("double", "sm_90")
    (sources / "factor.h").write_text("#define FACTOR 3.0f\n")
    compiled("double", "sm_90")
    compiled("double", "sm_80")
    compiled("double", "sm_80", {"UNUSED": 1})
    assert len(list(cache.iterdir())) == 4


def test_a_source_with_an_error_is_refused_with_the_compilers_message(cache: Path, sources: Path) -> None:
    (sources / "factor.h").write_text("#define FACTOR nonsense\n")
    with pytest.raises(RuntimeError, match=r'double.cu for sm_90(.|\n)*"nonsense" is undefined'):
        compiled("double", "sm_90")
    assert not cache.exists() or not list(cache.iterdir())


def test_without_a_writable_cache_a_kernel_is_compiled_every_time(
    tmp_path: Path, sources: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "file").write_text("")
    monkeypatch.setenv("SPLATRL_CACHE", str(tmp_path / "file" / "cache"))
    assert compiled("double", "sm_90") == compiled("double", "sm_90")
    assert capsys.readouterr().err.count("set SPLATRL_CACHE") == 2


def test_without_the_extra_cuda_the_error_says_what_to_install(cache: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "cuda.core", None)
    with pytest.raises(ImportError, match=r"pip install 'splatrl\[cuda\]'"):
        compiled("render", "sm_90")
