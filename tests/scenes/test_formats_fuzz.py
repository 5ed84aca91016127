"""Damaged files: whatever the damage, a reader raises ValueError or returns valid Gaussians."""

import functools
import gzip
import json
import warnings
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from splatrl.scenes import gaussians as gaussians_module
from splatrl.scenes.formats import ply_rows, read_gaussians
from splatrl.scenes.formats import spz as spz_module
from tests.scenes.samples import (
    assert_valid,
    compressed_ply_bytes,
    ply_bytes,
    ply_fields,
    random_spz,
    sample_gaussians,
    sog_entries,
    splat_bytes,
    spz_bytes,
    zip_bytes,
)

Damage = Callable[[bytes], bytes]


@st.composite
def damages(draw: st.DrawFn) -> Damage:
    """Draw overwritten, inserted and removed bytes, and perhaps truncation; places are fractions of the length."""
    place = st.floats(0.0, 1.0, exclude_max=True)
    near_start = place.map(lambda fraction: fraction**4)  # headers are short and matter most
    edits = draw(
        st.lists(st.tuples(st.one_of(place, near_start), st.integers(0, 2), st.binary(max_size=6)), max_size=5)
    )
    cut = draw(st.one_of(st.none(), place))

    def damage(content: bytes) -> bytes:
        damaged = bytearray(content)
        for fraction, kind, new in edits:
            at = int(fraction * len(damaged))
            damaged[at : at + (0 if kind == 1 else len(new))] = b"" if kind == 2 else new
        return bytes(damaged if cut is None else damaged[: int(cut * len(damaged))])

    return damage


def check(path: Path, content: bytes) -> None:
    path.write_bytes(content)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)
        try:
            gaussians = read_gaussians(path)
        except ValueError as error:
            assert str(path) in str(error)
            return
    assert_valid(gaussians)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("damaged")


PLY_FILES = {
    (kind, degree): ply_bytes(ply_fields(sample_gaussians(4, degree)), kind)
    for kind in ("ascii", "binary_little_endian", "binary_big_endian")
    for degree in (0, 1)
}


@settings(max_examples=100)
@given(content=st.sampled_from(list(PLY_FILES.values())), damage=damages())
def test_a_damaged_ply_file_is_refused_or_valid(folder: Path, content: bytes, damage: Damage) -> None:
    check(folder / "a.ply", damage(content))


@settings(max_examples=100)
@given(version=st.integers(2, 3), degree=st.integers(0, 3), damage=damages())
def test_a_damaged_spz_file_is_refused_or_valid(folder: Path, version: int, degree: int, damage: Damage) -> None:
    payload, count = random_spz(version, degree)
    check(folder / "a.spz", damage(spz_bytes(payload, count, version, degree)))


@settings(max_examples=100)
@given(version=st.integers(2, 3), degree=st.integers(0, 3), damage=damages())
def test_an_spz_file_with_damage_that_its_checksum_does_not_reveal_is_refused_or_valid(
    folder: Path, version: int, degree: int, damage: Damage
) -> None:
    payload, count = random_spz(version, degree)
    check(folder / "a.spz", gzip.compress(damage(gzip.decompress(spz_bytes(payload, count, version, degree)))))


SPLAT = splat_bytes([(1, 2, 3)] * 3, [(0.1, 0.2, 0.3)] * 3, [(9, 99, 199, 255)] * 3, [(200, 128, 90, 100)] * 3)


@settings(max_examples=100)
@given(damage=damages())
def test_a_damaged_splat_file_is_refused_or_valid(folder: Path, damage: Damage) -> None:
    check(folder / "a.splat", damage(SPLAT))


CHUNKS = np.linspace(-3.0, 3.0, 36).reshape(2, 18)
PACKED = np.random.default_rng(0).integers(0, 1 << 32, (258, 4)).astype(np.uint32)
COMPRESSED = [
    compressed_ply_bytes(CHUNKS, PACKED),
    compressed_ply_bytes(CHUNKS, PACKED, np.zeros((258, 9), np.uint8)),
]


@settings(max_examples=100)
@given(content=st.sampled_from(COMPRESSED), damage=damages())
def test_a_damaged_compressed_ply_file_is_refused_or_valid(folder: Path, content: bytes, damage: Damage) -> None:
    pytest.importorskip("gsply", reason="needs the extra gsply")
    check(folder / "a.ply", damage(content))


@functools.cache
def sog() -> dict[str, bytes]:
    """Return the entries of a SOG bundle with harmonics of degree 1, encoded once."""
    return sog_entries(bands=1)[0]


@settings(max_examples=100)
@given(damage=damages())
def test_a_damaged_sog_file_is_refused_or_valid(folder: Path, damage: Damage) -> None:
    pytest.importorskip("imagecodecs", reason="needs the extra gsply")
    check(folder / "a.sog", damage(zip_bytes(sog())))


@settings(max_examples=100)
@given(name=st.sampled_from(["meta.json", "means_l", "quats", "shN_centroids", "shN_labels"]), damage=damages())
def test_a_sog_file_with_damage_that_its_checksums_do_not_reveal_is_refused_or_valid(
    folder: Path, name: str, damage: Damage
) -> None:
    pytest.importorskip("imagecodecs", reason="needs the extra gsply")
    entries = sog()
    key = name if name in entries else f"{name}.webp"
    check(folder / "a.sog", zip_bytes({**entries, key: damage(entries[key])}))


TEXT = st.text("a0.-é😀\0", max_size=5)  # of few characters: collecting all of Unicode's takes a second
JSON = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | TEXT,
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(TEXT, inner, max_size=3),
    max_leaves=5,
)
FIELDS = [
    *[(name,) for name in ("version", "count", "means", "scales", "quats", "sh0", "shN")],
    *[
        (name, key)
        for name in ("means", "sh0", "shN")
        for key in ("files", "codebook", "mins", "maxs", "bands", "count")
    ],
]


@settings(max_examples=100)
@given(keys=st.sampled_from(FIELDS), value=JSON)
def test_a_sog_file_with_any_json_in_place_of_a_field_is_refused_or_valid(
    folder: Path, keys: tuple[str, ...], value: object
) -> None:
    pytest.importorskip("imagecodecs", reason="needs the extra gsply")
    entries = sog()
    meta = json.loads(entries["meta.json"])
    (meta if len(keys) == 1 else meta[keys[0]])[keys[-1]] = value
    check(folder / "a.sog", zip_bytes({**entries, "meta.json": json.dumps(meta).encode()}))


@pytest.mark.parametrize("degree", [0, 2])
def test_the_number_of_rows_read_at_once_does_not_change_the_result(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, degree: int
) -> None:
    gaussians = sample_gaussians(11, degree)
    gaussians.opacities[[2, 7]] = 0.0  # rows that are dropped
    spz, count = random_spz(3, degree)
    contents = {
        "a.ply": ply_bytes(ply_fields(gaussians), "binary_little_endian"),
        "b.ply": ply_bytes(ply_fields(gaussians), "ascii"),
        "c.spz": spz_bytes(spz, count, 3, degree),
    }
    for name, content in contents.items():
        (tmp_path / name).write_bytes(content)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", UserWarning)
            whole = read_gaussians(tmp_path / name)
            with monkeypatch.context() as patched:
                for module in (ply_rows, spz_module, gaussians_module):
                    patched.setattr(module, "BLOCK", 3)
                patched.setattr(spz_module, "PIECE", 7)
                found = read_gaussians(tmp_path / name)
        for field in ("means", "quats", "scales", "opacities", "sh"):
            assert getattr(found, field).equal(getattr(whole, field)), (name, field)
