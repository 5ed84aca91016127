"""benchmarks/gpu_stalls.py reads the output of the profiler."""

import sys
from pathlib import Path
from typing import Any

import pytest

COLUMNS = '"Line No","Source","Address","Source","# Samples","Instructions Executed"'
COLUMNS += ',"stall_barrier","stall_wait","stall_wait (Not Issued)"'
PAGE = f"""\
"File Path","/somewhere/order.h"
"Function Name","draw_pixels"
{COLUMNS}
"2","<Unable to open source file>","-","-","30","100","20","5","5"
"","","0x10","      BAR.SYNC","30","100","20","5","5"
"9999","<Unable to open source file>","-","-","10","300","-","10","10"
"File Path","/somewhere/else.h"
"Function Name","draw_pixels"
{COLUMNS}
"7","<Unable to open source file>","-","-","60","0","60","0","0"
"""


def test_lines_are_listed_with_their_share_of_samples_and_what_warps_waited_for(
    benchmark: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "page.csv").write_text(PAGE)
    monkeypatch.setattr(sys, "argv", ["gpu_stalls.py", str(tmp_path / "page.csv"), "--lines", "2"])
    benchmark("gpu_stalls").main()
    first, *_, one, two, _ = capsys.readouterr().out.splitlines()
    assert first == "all: barrier 80.0%, wait 15.0%"
    assert [cell.strip() for cell in one.split("|")[1:5]] == ["else.h:7", "60.0%", "0.0%", "barrier 60.0%"]
    cells = [cell.strip() for cell in two.split("|")[1:-1]]
    assert cells == ["order.h:2", "30.0%", "25.0%", "barrier 20.0%, wait 5.0%", "#pragma once"]


def test_a_file_of_another_format_is_refused(benchmark: Any, tmp_path: Path) -> None:
    (tmp_path / "page.csv").write_text("one,two\n")
    with pytest.raises(SystemExit, match=r"page.csv: expected the output of ncu --page source"):
        benchmark("gpu_stalls").lines_of(tmp_path / "page.csv")
