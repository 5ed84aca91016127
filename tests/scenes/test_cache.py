import math
import os
import time
import zipfile
from pathlib import Path

import numpy as np
import pytest

from splatrl import waits
from splatrl.scenes import cache
from splatrl.scenes.cache import DAY, _warn_unwritable, cache_dir, cached_arrays

ARRAYS = {"a": np.arange(6).reshape(2, 3), "b": np.array(0.5)}


class Build:
    """Builder that counts its calls."""

    def __init__(self) -> None:
        self.calls = 0

    def __call__(self) -> dict[str, np.ndarray]:
        self.calls += 1
        return ARRAYS


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("SPLATRL_CACHE", str(tmp_path / "deep" / "cache"))
    return tmp_path / "deep" / "cache"


def assert_arrays(arrays: dict[str, np.ndarray]) -> None:
    assert arrays.keys() == ARRAYS.keys()
    for name, values in ARRAYS.items():
        assert np.array_equal(arrays[name], values) and arrays[name].dtype == values.dtype


def test_arrays_are_built_once_and_kept_in_one_file(folder: Path) -> None:
    build = Build()
    assert_arrays(cached_arrays("x-1", build))
    assert_arrays(cached_arrays("x-1", build))
    assert build.calls == 1
    assert [entry.name for entry in folder.iterdir()] == ["x-1.npz"]


def test_arrays_that_take_long_to_build_are_announced(
    folder: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(waits, "LONG", 0.0)
    told = [""]

    def build() -> dict[str, np.ndarray]:
        while not told[-1] and len(told) < 10_000:
            time.sleep(0.001)
            told.append(capsys.readouterr().err)
        return ARRAYS

    cached_arrays("levels-1", build, what="levels")
    assert told[-1] == f"computing levels, which takes long only once: the result is kept in {folder}\n"


def test_arrays_whose_progress_is_shown_elsewhere_are_not_announced(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(cache, "announced", pytest.fail)
    cached_arrays("packed-1", Build())


@pytest.mark.parametrize("size", [0, 10, 150, -20])
def test_a_damaged_file_is_rebuilt_with_a_warning(folder: Path, size: int) -> None:
    build = Build()
    cached_arrays("x-1", build)
    path = folder / "x-1.npz"
    path.write_bytes(path.read_bytes()[:size])
    with pytest.warns(UserWarning, match=r"x-1\.npz: expected a complete .npz.*; rebuilding this cache file"):
        assert_arrays(cached_arrays("x-1", build))
    assert_arrays(cached_arrays("x-1", build))
    assert build.calls == 2


def test_a_file_with_pickled_objects_is_not_loaded(folder: Path) -> None:
    folder.mkdir(parents=True)
    np.savez(folder / "x-1.npz", a=np.array([print], dtype=object))
    with pytest.warns(UserWarning, match=r"a\.npy: expected object"):
        assert_arrays(cached_arrays("x-1", Build()))


def deflated(folder: Path, most: int) -> dict[str, np.ndarray]:
    """Cache a megabyte of zeros, compressed, with a limit of ``most`` bytes."""
    return cached_arrays("x-1", lambda: {"a": np.zeros(1 << 20, np.uint8)}, most)


def test_a_file_with_more_bytes_of_arrays_than_allowed_is_not_loaded(folder: Path) -> None:
    deflated(folder, 2 << 20)
    assert (folder / "x-1.npz").stat().st_size < 4096
    assert deflated(folder, 2 << 20)["a"].shape == (1 << 20,)
    with pytest.warns(UserWarning, match="expected at most 1,000 bytes of arrays, got 1,048,704"):
        deflated(folder, 1000)
    with pytest.warns(UserWarning, match="expected at most .* bytes of arrays"):  # for an uncompressed file
        assert_arrays(cached_arrays("x-1", Build()))


def test_a_file_with_a_bare_array_or_an_absurd_shape_is_rebuilt(folder: Path) -> None:
    folder.mkdir(parents=True)
    np.save(folder / "x-1.npy", np.zeros(3))
    (folder / "x-1.npy").rename(folder / "x-1.npz")
    with pytest.warns(UserWarning, match="rebuilding this cache file"):
        assert_arrays(cached_arrays("x-1", Build()))
    with zipfile.ZipFile(folder / "x-1.npz", "w") as archive:
        header = b"{'descr': '<f8', 'fortran_order': False, 'shape': (1000000000000,), }"
        archive.writestr("a.npy", b"\x93NUMPY\x01\x00" + len(header).to_bytes(2, "little") + header)
    with pytest.warns(UserWarning, match="rebuilding this cache file"):
        assert_arrays(cached_arrays("x-1", Build()))


def test_an_unwritable_folder_gives_one_warning_and_no_error(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, recwarn: pytest.WarningsRecorder
) -> None:
    (tmp_path / "file").write_text("")
    monkeypatch.setenv("SPLATRL_CACHE", str(tmp_path / "file" / "cache"))
    _warn_unwritable.cache_clear()
    build = Build()
    assert_arrays(cached_arrays("x-1", build))
    assert_arrays(cached_arrays("x-1", build))
    assert build.calls == 2
    assert [
        str(w.message).startswith(f"{tmp_path / 'file' / 'cache'}: cannot write the cache here") for w in recwarn
    ] == [True]


def test_a_failed_write_leaves_no_partial_file(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(*_: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "replace", full)
    _warn_unwritable.cache_clear()
    with pytest.warns(UserWarning, match="No space left on device"):
        assert_arrays(cached_arrays("x-1", Build()))
    assert list(folder.iterdir()) == []


def kept(folder: Path, name: str, days: float, size: int = 1000) -> Path:
    """Write a file that was last used ``days`` days ago."""
    folder.mkdir(parents=True, exist_ok=True)
    path, then = folder / name, time.time() - days * DAY
    path.write_bytes(b"x" * size)
    os.utime(path, (then, then))
    return path


def test_the_least_recently_used_files_are_removed_beyond_the_size_limit(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("SPLATRL_CACHE_GB", "4e-6")  # 4,000 bytes
    digests = [f"{number:032x}" for number in range(6)]
    days = [3.0, 9.0, 0.5, 5.0]
    files = [kept(folder, f"levels-{digest}.npz", ago) for digest, ago in zip(digests, days, strict=False)]
    others = kept(folder, "mine.npz", 400.0), kept(folder, f"render-{digests[0]}.cubin", 400.0)
    cached_arrays(f"levels-{digests[4]}", lambda: {"a": np.zeros(150)})  # adds 1.5 kB, which makes 5.5 kB
    assert [path.exists() for path in (*files, *others)] == [True, False, True, False, True, True]
    monkeypatch.setenv("SPLATRL_CACHE_GB", "0")
    cached_arrays(f"levels-{digests[5]}", lambda: {"a": np.zeros(150)})
    left = {path.name for path in folder.glob("levels-*")}
    assert left == {f"levels-{digests[number]}.npz" for number in (2, 4, 5)}  # used within the last day


def test_what_killed_processes_left_is_removed_after_a_day(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("splatrl.scenes.cache._unseen", math.inf)  # as in a new process
    digest, town = "1f" * 16, folder / f"town-3-2-{'2e' * 16}"
    left = [kept(folder, f"levels-{digest}.npz.1234abcd.tmp", 2.0), kept(town, "block+0+1.spz.1234abcd.tmp", 2.0)]
    fresh = [kept(folder, f"levels-{digest}.npz.5678abcd.tmp", 0.5), kept(town, "around.spz.5678abcd.tmp", 0.5)]
    others = [kept(folder, "mine.npz.1234abcd.tmp", 400.0), kept(town, "around.spz", 400.0)]
    cached_arrays(f"levels-{digest}", Build())
    assert [path.exists() for path in (*left, *fresh, *others)] == [False, False, True, True, True, True]


def test_reading_a_file_marks_it_as_used(folder: Path) -> None:
    cached_arrays("x-1", Build())
    then = time.time() - 3 * DAY
    os.utime(folder / "x-1.npz", (then, then))
    cached_arrays("x-1", Build())
    assert (folder / "x-1.npz").stat().st_mtime > then + 2 * DAY


@pytest.mark.parametrize("limit", ["many", "-1", "nan"])
def test_an_invalid_size_limit_is_refused(folder: Path, limit: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("SPLATRL_CACHE_GB", limit)
    with pytest.raises(
        ValueError, match=f"SPLATRL_CACHE_GB: expected a non-negative number of gigabytes, got '{limit}'"
    ):
        cached_arrays("x-1", Build())


def test_an_error_in_the_builder_is_not_hidden(folder: Path) -> None:
    def build() -> dict[str, np.ndarray]:
        raise OSError("from the builder")

    with pytest.raises(OSError, match="from the builder"):
        cached_arrays("x-1", build)


def test_the_cache_folder_is_the_configured_one_or_the_users(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("SPLATRL_CACHE", str(tmp_path))
    assert cache_dir() == tmp_path
    monkeypatch.setenv("SPLATRL_CACHE", "")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "xdg"))
    assert cache_dir() == tmp_path / "xdg" / "splatrl"
    monkeypatch.delenv("XDG_CACHE_HOME")
    monkeypatch.setenv("HOME", str(tmp_path))
    assert cache_dir() == tmp_path / ".cache" / "splatrl"
