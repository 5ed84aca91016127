"""The choice of a device, with and without a GPU."""

import pytest
import torch

from splatrl import device as room
from splatrl.device import chosen_device, cuda_extra, device_line


def gpu(monkeypatch: pytest.MonkeyPatch, extra: bool) -> None:
    """Pretend that there is one GPU."""
    monkeypatch.setattr(torch.cuda, "is_available", lambda: True)
    monkeypatch.setattr(torch.cuda, "device_count", lambda: 1)
    monkeypatch.setattr(torch.cuda, "get_device_name", lambda device=None: "H200")
    monkeypatch.setattr(room, "cuda_extra", lambda: extra)


@pytest.mark.parametrize(("extra", "kind"), [(True, "cuda"), (False, "cpu")])
def test_auto_takes_a_gpu_if_there_is_one_and_the_extra_is_installed(
    monkeypatch: pytest.MonkeyPatch, extra: bool, kind: str
) -> None:
    gpu(monkeypatch, extra)
    device = chosen_device("auto")
    assert device.type == kind
    line = {"cuda": "device: cuda (H200)", "cpu": "device: cpu; for H200: pip install 'splatrl[cuda]'"}
    assert device_line(device) == line[kind]


def test_auto_takes_the_cpu_where_there_is_no_gpu(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(torch.cuda, "is_available", lambda: False)
    assert device_line(chosen_device("auto")) == "device: cpu"


@pytest.mark.parametrize("name", ["cuda", "cuda:0", "cuda:3"])
def test_a_gpu_that_the_machine_lacks_is_refused(monkeypatch: pytest.MonkeyPatch, name: str) -> None:
    monkeypatch.setattr(torch.cuda, "device_count", lambda: 0)
    with pytest.raises(
        ValueError, match=f"device: expected a device of this machine, got {name}, but .* finds 0 CUDA devices"
    ):
        chosen_device(name)


def test_a_numbered_gpu_becomes_the_current_device(monkeypatch: pytest.MonkeyPatch) -> None:
    gpu(monkeypatch, True)
    chosen = []
    monkeypatch.setattr(torch.cuda, "set_device", chosen.append)
    assert chosen_device("cuda") == torch.device("cuda") and chosen == []
    assert [chosen_device("cuda:0")] == chosen


@pytest.mark.parametrize("name", ["gpu", "", "cuda:x"])
def test_a_name_that_is_no_device_is_refused(name: str) -> None:
    with pytest.raises(ValueError, match="device: expected auto, cpu, cuda or cuda:<number>, got"):
        chosen_device(name)


def test_the_extra_counts_as_missing_if_its_modules_are_missing(monkeypatch: pytest.MonkeyPatch) -> None:
    found = {"cuda": object(), "cuda.core": None}
    monkeypatch.setattr(room, "find_spec", found.get)
    assert not cuda_extra()
    found["cuda.core"] = object()
    assert cuda_extra()
    found.clear()
    assert not cuda_extra()
