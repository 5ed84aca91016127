"""Checkpoints survive crashes, and damage is reported."""

import io
import os
import resource
import zipfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest
import torch

from splatrl.training import load_checkpoint, save_checkpoint

STATE: dict[str, Any] = {"frames": 7, "model": {"weight": torch.arange(6.0).view(2, 3)}, "history": [{"success": 0.5}]}


def saved(value: Any = STATE) -> bytes:
    buffer = io.BytesIO()
    torch.save(value, buffer)
    return buffer.getvalue()


def test_a_saved_checkpoint_is_loaded_unchanged(tmp_path: Path) -> None:
    path = tmp_path / "last.pt"
    save_checkpoint(path, STATE)
    loaded = load_checkpoint(path)
    assert torch.equal(loaded["model"].pop("weight"), torch.arange(6.0).view(2, 3))
    assert loaded == {"frames": 7, "model": {}, "history": [{"success": 0.5}]}
    assert os.listdir(tmp_path) == ["last.pt"]


@pytest.mark.parametrize("room", [0, 10, 1000, 30_000])
def test_a_full_disk_leaves_the_old_checkpoint_and_the_error_names_the_path(tmp_path: Path, room: int) -> None:
    path = tmp_path / "last.pt"
    save_checkpoint(path, {"frames": 1})
    with limited_files(room), pytest.raises(OSError, match=r"cannot write: File too large: .*last\.pt"):
        save_checkpoint(path, {"weight": torch.zeros(10_000)})
    assert load_checkpoint(path) == {"frames": 1}
    assert os.listdir(tmp_path) == ["last.pt"]


@contextmanager
def limited_files(size: int) -> Iterator[None]:
    """Limit the size of files within a block, bytes, as on a disk that fills up."""
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))


def test_a_new_checkpoint_replaces_the_old_one_only_after_it_is_synced_to_disk(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "last.pt"
    save_checkpoint(path, {"frames": 1})
    events: list[str] = []
    real = {"fsync": os.fsync, "replace": os.replace}
    for name, call in real.items():
        monkeypatch.setattr(os, name, lambda *a, name=name, call=call: (events.append(name), call(*a)))
    save_checkpoint(path, {"frames": 2})
    assert events == ["fsync", "replace"]
    assert load_checkpoint(path) == {"frames": 2}


@pytest.mark.parametrize(
    "content",
    [b"", b"garbage", b"PK\x03\x04", saved()[: len(saved()) // 2], saved({"run": os.system}), saved([1, 2])],
    ids=["empty", "garbage", "signature", "half", "code", "list"],
)
def test_a_file_that_is_not_a_checkpoint_is_refused_by_name(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "last.pt"
    path.write_bytes(content)
    with pytest.raises(ValueError, match=rf"{path}: expected a"):
        load_checkpoint(path)


def test_a_flipped_bit_in_a_tensor_is_detected(tmp_path: Path) -> None:
    path = tmp_path / "last.pt"
    content = bytearray(saved())
    place = content.index(torch.tensor([4.0, 5.0]).numpy().tobytes())
    content[place] ^= 1
    path.write_bytes(content)
    with pytest.raises(ValueError, match=rf"{path}: expected a complete checkpoint .* checksum"):
        load_checkpoint(path)


def test_a_checkpoint_truncated_at_any_length_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "last.pt"
    content = saved()
    for length in range(0, len(content), 7):
        path.write_bytes(content[:length])
        with pytest.raises(ValueError, match=rf"{path}: expected a complete checkpoint"):
            load_checkpoint(path)


@pytest.mark.parametrize("name", ["nothing.pt", "."])
def test_a_missing_checkpoint_is_reported(tmp_path: Path, name: str) -> None:
    with pytest.raises(FileNotFoundError, match="expected a checkpoint, found none"):
        load_checkpoint(tmp_path / name)


def test_compressed_entries_are_refused(tmp_path: Path) -> None:
    with zipfile.ZipFile(io.BytesIO(saved({"a": torch.zeros(1 << 20)}))) as plain:
        entries = {name: plain.read(name) for name in plain.namelist()}
    path = tmp_path / "last.pt"
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, content in entries.items():
            archive.writestr(name, content)
    assert path.stat().st_size < 10_000 and "a" in torch.load(path, weights_only=True)
    with pytest.raises(ValueError, match=r"last\.pt: .*expected uncompressed entries"):
        load_checkpoint(path)


@pytest.mark.parametrize("value", [bytearray(8), {1, 2}, 1j, torch.nn.Parameter(torch.ones(1)), torch.float32])
def test_only_tensors_and_plain_values_are_loaded(value: Any, tmp_path: Path) -> None:
    (tmp_path / "last.pt").write_bytes(saved({"a": value}))
    with pytest.raises(ValueError, match=r"last\.pt: .*expected tensors and plain values, got"):
        load_checkpoint(tmp_path / "last.pt")


def test_overlapping_entries_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "last.pt"
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("archive/a", bytes(1000))
        info = archive.infolist()[0]
        for number in range(50):  # more names for the same bytes
            twin = zipfile.ZipInfo(f"archive/{number}")
            twin.file_size, twin.compress_size, twin.CRC = info.file_size, info.compress_size, info.CRC
            twin.header_offset = info.header_offset
            archive.filelist.append(twin)
            archive.NameToInfo[twin.filename] = twin
        archive._didModify = True
    with pytest.raises(ValueError, match=r"last\.pt: .*expected entries of at most"):
        load_checkpoint(path)
