"""benchmarks/gpu_against.py draws with the kernels of other checkouts."""

import shutil
import sys
from pathlib import Path
from typing import Any

import pytest

from splatrl.native.cuda import compiler

ROOT = Path(__file__).parents[2]


def test_kernels_of_another_checkout_are_run_and_their_bytes_compared(
    benchmark: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    against = benchmark("gpu_against")
    darker = tmp_path / "darker"
    shutil.copytree(ROOT / "splatrl" / "native", darker / "splatrl" / "native")
    blend = darker / "splatrl" / "native" / "cuda" / "blend.h"
    blend.write_text(blend.read_text().replace("255.0f * value", "200.0f * value"))
    monkeypatch.setattr(against, "SECONDS", 0.0)
    monkeypatch.setattr(sys, "argv", ["gpu_against.py", str(darker), "--dry-run", "--tolerances", "0"])
    before = compiler.FOLDERS
    against.main()
    assert before == compiler.FOLDERS
    mine, other = (line.split("|")[1:-1] for line in capsys.readouterr().out.splitlines()[3:5])
    assert [cell.strip() for cell in mine[:3]] == ["tiny", "0", "this one"] and mine[5].strip() == "0"
    assert other[2].strip() == str(darker) and int(other[5].replace(",", "")) > 100


def test_a_folder_that_is_no_checkout_is_refused(benchmark: Any, tmp_path: Path) -> None:
    refused = pytest.raises(SystemExit, match=r"expected a checkout with splatrl/native/cuda/render.cu")
    with refused, benchmark("gpu_against").sources_of(tmp_path):
        pass
