"""benchmarks/gpu_step.py times gradient steps with two ways to differentiate convolutions."""

import sys
from typing import Any

import pytest
from torch import nn

from splatrl.training.convolution import Convolution


def test_both_ways_are_timed(
    benchmark: Any, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(sys, "argv", ["gpu_step.py", "--dry-run"])
    timed = benchmark("gpu_step")
    monkeypatch.setattr(timed, "STEPS", 2)
    timed.main()
    rows = [line.split("|")[1:-1] for line in capsys.readouterr().out.splitlines() if "|" in line]
    assert [row[0].strip() for row in rows[2:]] == ["cuDNN's", "a product of matrices"]
    assert all(float(row[1]) > 0 for row in rows[2:])


def test_cudnn_is_used_only_for_a_while(benchmark: Any) -> None:
    own = Convolution.forward
    with benchmark("gpu_step").with_cudnn():
        assert Convolution.forward is nn.Conv2d.forward
    assert Convolution.forward is own
