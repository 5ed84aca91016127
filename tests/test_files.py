"""Paths as people type them, the folder for caches, and entries of untrusted ZIP archives."""

import errno
import fcntl
import io
import shutil
import struct
import tracemalloc
import zipfile
import zlib
from pathlib import Path

import pytest

from splatrl.files import alone_in, cache_dir, discard, expanded, new_folder, read_entry, remove_stale, replacing
from tests.scenes.samples import lying_zip, zip_bytes

MIB = 1 << 20


def test_a_tilde_is_a_home_folder_only_where_it_names_a_user() -> None:
    assert expanded("~/a.ply") == Path.home() / "a.ply"
    assert expanded(Path("~t.ply")) == Path("~t.ply")
    assert expanded("~nobody-of-this-name/a.ply") == Path("~nobody-of-this-name/a.ply")


def test_a_user_without_a_home_folder_is_asked_for_a_folder_for_caches(monkeypatch: pytest.MonkeyPatch) -> None:
    def homeless() -> Path:
        raise RuntimeError("Could not determine home directory.")

    monkeypatch.setattr(Path, "home", homeless)
    for name in ("SPLATRL_CACHE", "XDG_CACHE_HOME"):
        monkeypatch.delenv(name, raising=False)
    with pytest.raises(ValueError, match=r"^SPLATRL_CACHE: expected a folder for caches where there is no home folder"):
        cache_dir()
    monkeypatch.setenv("XDG_CACHE_HOME", "caches")
    assert cache_dir() == Path("caches/splatrl")
    monkeypatch.setenv("SPLATRL_CACHE", "mine")
    assert cache_dir() == Path("mine")
    monkeypatch.setenv("HOME", "/home/me")
    monkeypatch.setenv("SPLATRL_CACHE", "~/mine")  # as in a file with variables for a container
    assert cache_dir() == Path("/home/me/mine")


def test_a_new_folder_removes_what_killed_processes_left_of_it_and_nothing_else(tmp_path: Path) -> None:
    left, busy = tmp_path / ".demos.0123abcd.tmp", tmp_path / ".demos.0123abce.tmp"
    others = [tmp_path / name for name in (".demos.original.tmp", ".demos2.0123abcd.tmp", "demos.0123abcd.tmp")]
    for folder in (left, busy, *others):
        (folder / "inner").mkdir(parents=True)
    (tmp_path / ".demos.0123abcf.tmp").symlink_to(others[0])
    before = {*tmp_path.rglob("*")}
    with alone_in(busy), new_folder(tmp_path / "demos"):
        assert not left.exists()
    assert {*tmp_path.rglob("*")} == before - {left, left / "inner"} | {tmp_path / "demos"}


def test_what_killed_processes_left_is_removed_and_what_others_are_writing_is_not(tmp_path: Path) -> None:
    (tmp_path / "film.mp4.0123abcd.tmp").touch()
    (tmp_path / ".demos.0123abcd.tmp").mkdir()
    (tmp_path / "mine.tmp").touch()
    with new_folder(tmp_path / "others") as folder, replacing(tmp_path / "curve.png") as stream:
        remove_stale(tmp_path)
        assert {*tmp_path.iterdir()} == {folder, Path(stream.name), tmp_path / "mine.tmp"}
    assert {path.name for path in tmp_path.iterdir()} == {"others", "curve.png", "mine.tmp"}


def test_a_folder_is_discarded_as_a_whole(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "run" / "checkpoints").mkdir(parents=True)
    with monkeypatch.context() as patched:
        patched.setattr(shutil, "rmtree", lambda _: pytest.fail("killed"))
        with pytest.raises(pytest.fail.Exception):
            discard(tmp_path / "run")
    assert not (tmp_path / "run").exists() and any(tmp_path.iterdir())
    remove_stale(tmp_path)
    assert not any(tmp_path.iterdir())


def test_a_file_system_without_locks_can_be_used_by_one_process_at_a_time(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def flock(descriptor: int, how: int) -> None:
        raise OSError(errno.ENOSYS, "Function not implemented")

    monkeypatch.setattr(fcntl, "flock", flock)
    (tmp_path / "film.mp4.0123abcd.tmp").touch()  # of another process, perhaps
    with pytest.warns(UserWarning, match=rf"^{tmp_path}: its file system has no locks; let only"), alone_in(tmp_path):
        with replacing(tmp_path / "curve.png") as stream:
            stream.write(b"a curve")
        remove_stale(tmp_path)
    assert {path.name for path in tmp_path.iterdir()} == {"curve.png", "film.mp4.0123abcd.tmp"}


def _read(archive: bytes, most: int = MIB) -> bytes:
    with zipfile.ZipFile(io.BytesIO(archive)) as opened:
        return read_entry(opened, opened.infolist()[0], most)


@pytest.mark.parametrize("compression", [zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED])
@pytest.mark.parametrize("content", [b"", b"a", bytes(100_000)])
def test_an_honest_entry_is_read_whole(compression: int, content: bytes) -> None:
    assert _read(zip_bytes({"a": content}, compression)) == content


@pytest.mark.parametrize(
    ("compression", "message"),
    [
        (zipfile.ZIP_STORED, "expected 100 bytes, as it declares, got more|Bad CRC-32"),
        (zipfile.ZIP_DEFLATED, "expected 100 bytes, as it declares, got more|Bad CRC-32"),
        (zipfile.ZIP_BZIP2, "expected stored or deflated data, got compression type 12"),
        (zipfile.ZIP_LZMA, "expected stored or deflated data, got compression type 14"),
    ],
)
def test_an_entry_longer_than_it_declares_is_refused_without_unpacking_it(compression: int, message: str) -> None:
    archive = lying_zip("a", bytes(8 * MIB), 100, compression)
    tracemalloc.start()
    try:
        with pytest.raises((ValueError, zipfile.BadZipFile), match=message):
            _read(archive)
        assert tracemalloc.get_traced_memory()[1] < MIB
    finally:
        tracemalloc.stop()


def test_an_entry_shorter_than_it_declares_is_refused() -> None:
    with pytest.raises(
        (ValueError, zipfile.BadZipFile), match=r"expected 100 bytes, as it declares, got 10|Bad CRC-32"
    ):
        _read(lying_zip("a", bytes(10), 100, zipfile.ZIP_DEFLATED))


def test_an_entry_with_the_checksum_of_more_than_it_declares_is_refused() -> None:
    archive = lying_zip("a", bytes(100), 99, zipfile.ZIP_DEFLATED)
    with pytest.raises(ValueError, match="expected 99 bytes, as it declares, got more"):
        _read(archive.replace(struct.pack("<I", zlib.crc32(bytes(99))), struct.pack("<I", zlib.crc32(bytes(100)))))


def test_an_entry_that_declares_more_than_the_limit_is_refused() -> None:
    with pytest.raises(ValueError, match="expected at most 9 bytes, got 10"):
        _read(zip_bytes({"a": bytes(10)}), 9)
