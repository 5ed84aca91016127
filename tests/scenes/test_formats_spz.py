import gzip
import math
import struct
import tracemalloc
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from splatrl.scenes.formats import read_gaussians, write_gaussians
from splatrl.scenes.formats.reading import trained_antialiased
from splatrl.scenes.sources import read_scene
from tests.scenes.samples import (
    assert_same,
    assert_valid,
    random_spz,
    sample_gaussians,
    spz_4_bytes,
    spz_bytes,
    spz_payload,
)


def written(path: Path, content: bytes) -> Path:
    path.write_bytes(content)
    return path


def one(rotation: list[int], version: int, tmp_path: Path) -> torch.Tensor:
    """Return the quaternion of one Gaussian with these rotation bytes."""
    payload = spz_payload(
        np.zeros((1, 3), np.int64), np.full(1, 255), np.full(3, 128), np.full(3, 160), np.array(rotation), np.zeros(0)
    )
    return read_gaussians(written(tmp_path / "a.spz", spz_bytes(payload, 1, version))).quats[0]


def test_bytes_are_decoded_as_the_format_says(tmp_path: Path) -> None:
    payload = spz_payload(
        positions=np.array([[-6144, 1, 8388607], [0, -1, -8388608]]),
        alphas=np.array([255, 51]),
        colors=np.array([[0, 255, 51], [204, 102, 153]]),
        scales=np.array([[160, 0, 255], [144, 176, 16]]),
        rotations=np.array([[0, 0, 0, 192], [0, 0, 0, 0]]),
        sh=np.arange(18).reshape(2, 3, 3) * 8 + 64,
    )
    gaussians = read_gaussians(written(tmp_path / "a.spz", spz_bytes(payload, 2, degree=1)))
    exact = torch.tensor([[-1.5, 2**-12, 2048 - 2**-12], [0.0, -(2**-12), -2048.0]])
    torch.testing.assert_close(gaussians.means, exact, atol=0, rtol=0)
    torch.testing.assert_close(gaussians.opacities, torch.tensor([1.0, 0.2]))
    torch.testing.assert_close(gaussians.scales.log(), torch.tensor([[0, -10, 5.9375], [-1, 1, -9]]))
    sh0 = torch.tensor([[-0.5, 0.5, -0.3], [0.3, -0.1, 0.1]]) / 0.15
    torch.testing.assert_close(gaussians.sh[:, 0], sh0, atol=1e-6, rtol=1e-6)
    sh1 = torch.arange(18).reshape(2, 3, 3) / 16 - 0.5  # harmonic, then channel
    torch.testing.assert_close(gaussians.sh[:, 1:], sh1, atol=0, rtol=0)
    torch.testing.assert_close(gaussians.quats, torch.tensor([[1.0, 0, 0, 0], [0, 1, 0, 0]]))


def test_fractional_bits_scale_the_positions(tmp_path: Path) -> None:
    payload, count = random_spz(3, 0)
    at_12 = read_gaussians(written(tmp_path / "a.spz", spz_bytes(payload, count, fractional_bits=12))).means
    at_9 = read_gaussians(written(tmp_path / "b.spz", spz_bytes(payload, count, fractional_bits=9))).means
    torch.testing.assert_close(at_9, 8 * at_12, atol=0, rtol=0)


@pytest.fixture
def gsply(monkeypatch: pytest.MonkeyPatch) -> Any:
    """The package gsply, which reads SPZ files here without compiling its reader: that would take five seconds."""
    package = pytest.importorskip("gsply", reason="needs the extra gsply")
    monkeypatch.setattr(package.spz, "_decode_spz_kernel", package.spz._decode_spz_kernel.py_func)
    return package


def test_positions_of_version_1_are_halves(tmp_path: Path) -> None:
    payload, count = random_spz(2, 1)
    places = np.linspace(-3, 3, 3 * count).astype("<f2")
    first = written(tmp_path / "1.spz", spz_bytes(places.tobytes() + payload[9 * count :], count, 1, 1))
    second = read_gaussians(written(tmp_path / "2.spz", spz_bytes(payload, count, 2, 1)))
    second.means = torch.from_numpy(places.astype(np.float32)).reshape(count, 3)
    assert_same(read_gaussians(first), second)


@pytest.mark.parametrize("version", [3, 4])
def test_harmonics_of_degree_4_are_left_out_with_a_warning(tmp_path: Path, version: int) -> None:
    payload, count = random_spz(3, 4)
    before, sh = payload[: -72 * count], np.frombuffer(payload[-72 * count :], np.uint8).reshape(count, 72)
    coarse = read_gaussians(written(tmp_path / "3.spz", spz_bytes(before + sh[:, :45].tobytes(), count, degree=3)))
    if version == 4:
        pytest.importorskip("imagecodecs", reason="needs the extra gsply")
    content = (spz_bytes if version == 3 else spz_4_bytes)(payload, count, degree=4)
    with pytest.warns(UserWarning, match=r"4\.spz: left out the harmonics of degree 4"):
        assert_same(read_gaussians(written(tmp_path / "4.spz", content)), coarse)


@pytest.mark.parametrize("largest", range(4))
def test_a_version_3_rotation_leaves_out_its_largest_component(tmp_path: Path, largest: int) -> None:
    xyzw = np.insert(np.array([0.3, -0.2, 0.1]), largest, np.sqrt(1 - 0.14))
    word = largest
    for value in np.delete(xyzw, largest):
        word = word << 10 | (value < 0) << 9 | round(abs(value) * np.sqrt(2) * 511)
    quat = one(list(int(word).to_bytes(4, "little")), 3, tmp_path)
    torch.testing.assert_close(quat, torch.tensor(np.roll(xyzw, 1), dtype=torch.float32), atol=1.5e-3, rtol=0)


def test_a_version_2_rotation_has_its_real_part_left_out(tmp_path: Path) -> None:
    xyz = np.array([0.3, -0.2, 0.1])
    quat = one(np.round(xyz * 127.5 + 127.5).astype(int).tolist(), 2, tmp_path)
    expected = torch.tensor([np.sqrt(1 - 0.14), *xyz], dtype=torch.float32)
    torch.testing.assert_close(quat, expected, atol=8e-3, rtol=0)


@pytest.mark.parametrize("version", [2, 3])
@pytest.mark.parametrize("degree", [0, 1, 2, 3])
def test_gsply_reads_the_same_values(tmp_path: Path, gsply: Any, version: int, degree: int) -> None:
    payload, count = random_spz(version, degree, count=37)
    path = written(tmp_path / "a.spz", spz_bytes(payload, count, version, degree))
    ours, theirs = read_gaussians(path), gsply.read_spz(path)
    assert_valid(ours)
    np.testing.assert_allclose(ours.means, theirs.means, rtol=1e-6)
    np.testing.assert_allclose(ours.scales.log(), theirs.scales, atol=1e-5)
    np.testing.assert_allclose(ours.opacities, 1 / (1 + np.exp(-theirs.opacities)), atol=2e-6)
    np.testing.assert_allclose(ours.sh[:, 0], theirs.sh0, atol=1e-6)
    if degree > 0:
        np.testing.assert_allclose(ours.sh[:, 1:], theirs.shN, atol=1e-6)
    unit = theirs.quats / np.linalg.norm(theirs.quats, axis=1, keepdims=True)
    np.testing.assert_allclose(ours.quats, unit, atol=1e-6)


def test_a_file_written_by_gsply_is_read_within_its_quantisation(tmp_path: Path) -> None:
    gsply = pytest.importorskip("gsply", reason="needs the extra gsply")
    gaussians = sample_gaussians(25, 3)
    gaussians.sh = gaussians.sh.clamp(-0.9, 0.9)
    data = gsply.GSData.from_arrays(
        means=gaussians.means.numpy(),
        scales=gaussians.scales.log().numpy(),
        quats=gaussians.quats.numpy(),
        opacities=gaussians.opacities.logit().numpy(),
        sh0=gaussians.sh[:, 0].numpy(),
        shN=gaussians.sh[:, 1:].numpy(),
        format="ply",
    )
    gsply.write_spz(tmp_path / "a.spz", data)
    read = read_gaussians(tmp_path / "a.spz")
    torch.testing.assert_close(read.means, gaussians.means, atol=2**-13 * 1.01, rtol=0)
    torch.testing.assert_close(read.scales.log(), gaussians.scales.log(), atol=1 / 31, rtol=0)
    torch.testing.assert_close(read.opacities, gaussians.opacities, atol=1 / 500, rtol=0)
    torch.testing.assert_close(read.sh, gaussians.sh, atol=0.014, rtol=0)
    assert ((read.quats * gaussians.quats).sum(1).abs() > 1 - 1e-5).all()


@pytest.mark.parametrize("degree", [0, 1, 2, 3])
def test_written_gaussians_read_back_within_the_quantisation(tmp_path: Path, degree: int) -> None:
    gaussians = sample_gaussians(500, degree)
    gaussians.sh[:, 1:] = gaussians.sh[:, 1:].clamp(-0.99, 0.99)
    write_gaussians(tmp_path / "a.spz", gaussians)
    read = read_gaussians(tmp_path / "a.spz")
    assert_valid(read)
    torch.testing.assert_close(read.means, gaussians.means, atol=2**-13 * 1.01, rtol=0)
    torch.testing.assert_close(read.scales.log(), gaussians.scales.log(), atol=1 / 31, rtol=0)
    torch.testing.assert_close(read.opacities, gaussians.opacities, atol=1 / 500, rtol=0)
    torch.testing.assert_close(read.sh[:, 0], gaussians.sh[:, 0], atol=0.5 / 255 / 0.15 * 1.01, rtol=0)
    torch.testing.assert_close(read.sh[:, 1:], gaussians.sh[:, 1:], atol=1 / 255, rtol=0)
    angle = 2 * (read.quats.double() * gaussians.quats.double()).sum(1).abs().clamp(max=1).acos()
    assert float(angle.max()) < math.radians(0.3)
    write_gaussians(tmp_path / "b.spz", read)
    again = read_gaussians(tmp_path / "b.spz")
    for name in ("means", "scales", "opacities", "sh"):
        torch.testing.assert_close(getattr(again, name), getattr(read, name), atol=1e-6, rtol=1e-6)


@pytest.mark.parametrize("degree", [0, 2])
def test_gsply_reads_a_written_file_with_the_same_values(tmp_path: Path, gsply: Any, degree: int) -> None:
    write_gaussians(tmp_path / "a.spz", sample_gaussians(41, degree))
    ours, theirs = read_gaussians(tmp_path / "a.spz"), gsply.read_spz(tmp_path / "a.spz")
    np.testing.assert_allclose(ours.means, theirs.means, rtol=1e-6)
    np.testing.assert_allclose(ours.scales.log(), theirs.scales, atol=1e-5)
    np.testing.assert_allclose(ours.sh[:, 0], theirs.sh0, atol=1e-6)
    unit = theirs.quats / np.linalg.norm(theirs.quats, axis=1, keepdims=True)
    np.testing.assert_allclose(ours.quats, unit, atol=1e-6)


@pytest.mark.parametrize(("antialiased", "flag"), [(None, 0), (False, 0), (True, 1)])
def test_files_say_whether_the_splat_was_trained_antialiased(
    tmp_path: Path, antialiased: bool | None, flag: int
) -> None:
    path = tmp_path / "a.spz"
    write_gaussians(path, sample_gaussians(9, 1), antialiased)
    assert gzip.decompress(path.read_bytes())[14] == flag
    assert trained_antialiased(path) is bool(flag)


def test_files_of_version_4_say_whether_the_splat_was_trained_antialiased(tmp_path: Path) -> None:
    pytest.importorskip("imagecodecs", reason="needs the extra gsply")
    for flags in (0, 1):
        path = written(tmp_path / "a.spz", spz_4_bytes(*random_spz(3, 0), claims={"flags": flags}))
        assert trained_antialiased(path) is bool(flags)


def test_files_are_reproducible_and_small(tmp_path: Path) -> None:
    gaussians = sample_gaussians(2000, 1)
    sizes = {}
    for name in ("a.spz", "b.spz", "a.ply"):
        write_gaussians(tmp_path / name, gaussians)
        sizes[name] = (tmp_path / name).stat().st_size
    assert (tmp_path / "a.spz").read_bytes() == (tmp_path / "b.spz").read_bytes()
    assert sizes["a.spz"] < sizes["a.ply"] / 3.5


def test_positions_of_a_large_place_are_stored_as_finely_as_the_format_allows(tmp_path: Path) -> None:
    gaussians = sample_gaussians(5, 0)
    gaussians.means = torch.tensor([[5000.0, -7000, 3.3], [0, 0, 0], [1.7, 2.9, -8191], [0, 1, 2], [3, 4, 5]])
    write_gaussians(tmp_path / "a.spz", gaussians)
    torch.testing.assert_close(read_gaussians(tmp_path / "a.spz").means, gaussians.means, atol=2**-11, rtol=1e-6)
    before = (tmp_path / "a.spz").read_bytes()
    gaussians.means = 1e7 * gaussians.means
    with pytest.raises(ValueError, match=r"a\.spz: means: expected at most 8,388,607 units from the origin"):
        write_gaussians(tmp_path / "a.spz", gaussians)
    assert (tmp_path / "a.spz").read_bytes() == before


@pytest.mark.parametrize("place", [1e5, -1e6, 1e8])
def test_a_few_stray_gaussians_do_not_coarsen_the_others(tmp_path: Path, place: float) -> None:
    gaussians = sample_gaussians(3000, 0)
    gaussians.scales = 0.01 * gaussians.scales
    gaussians.means[[5, 7], 1] = place
    with pytest.warns(UserWarning, match=r"a\.spz: left out 2 of 3000 Gaussians, so far from the others"):
        write_gaussians(tmp_path / "a.spz", gaussians)
    others = torch.cat([gaussians[:5], gaussians[6:7], gaussians[8:]])
    torch.testing.assert_close(read_gaussians(tmp_path / "a.spz").means, others.means, atol=2**-13, rtol=1e-6)


@pytest.mark.parametrize("far", [5, 3000])
def test_a_scene_too_large_for_fine_positions_is_written_whole_with_a_warning(tmp_path: Path, far: int) -> None:
    gaussians = sample_gaussians(3000, 0)
    gaussians.scales = 0.01 * gaussians.scales
    gaussians.means[:far, 0] += 500_000.0
    with pytest.warns(UserWarning, match=r"a\.spz: positions are rounded to 0\.062 units, .* up to 5e\+05 units"):
        write_gaussians(tmp_path / "a.spz", gaussians)
    assert int.from_bytes(gzip.decompress((tmp_path / "a.spz").read_bytes())[8:12], "little") == 3000


@pytest.mark.parametrize("name", ["means", "quats", "scales", "opacities", "sh"])
def test_values_that_are_not_finite_are_not_written(tmp_path: Path, name: str) -> None:
    gaussians = sample_gaussians(3, 1)
    getattr(gaussians, name).view(-1)[1] = 0.0 if name == "scales" else math.nan
    with pytest.raises(ValueError, match=rf"a\.spz: {name}: expected values that are finite when stored"):
        write_gaussians(tmp_path / "a.spz", gaussians)
    assert not list(tmp_path.iterdir())


def test_values_beyond_the_range_of_a_byte_are_clamped_with_a_warning_about_sizes(tmp_path: Path) -> None:
    gaussians = sample_gaussians(2, 1)
    gaussians.scales = torch.tensor([[1e-9, 1.0, 1e9], [1, 390, 1]])
    gaussians.sh[0] = torch.tensor([[9.0, -9, 0], [5, -5, 0], [0, 0, 0], [0, 0, 0]])
    with pytest.warns(UserWarning, match=r"a\.spz: 1 of 2 Gaussians are shrunk to 379 units, .*; write a PLY"):
        write_gaussians(tmp_path / "a.spz", gaussians)
    read = read_gaussians(tmp_path / "a.spz")
    torch.testing.assert_close(read.scales[0].log(), torch.tensor([-10.0, 0, 95 / 16 + 0]), atol=1e-4, rtol=0)
    torch.testing.assert_close(read.sh[0, :2, :2], torch.tensor([[1 / 0.3, -1 / 0.3], [127 / 128, -1]]))


@pytest.mark.parametrize(
    ("header", "message"),
    [
        ({"version": 0}, "version: expected 1 to 3, got 0"),
        ({"version": 4}, "version: expected 1 to 3, got 4"),
        ({"degree": 5}, "shDegree: expected 0 to 4, got 5"),
        ({"fractional_bits": 25}, "fractionalBits: expected at most 24, got 25"),
        ({"count": 0}, "numPoints: expected at least 1, got 0"),
        ({"count": 10}, "expected 200 bytes after the header, got 180: truncated"),
        ({"count": 8}, "expected 160 bytes after the header, got more"),
        ({"degree": 1}, "expected 261 bytes after the header, got 180: truncated"),
        (
            {"count": 0xFFFFFFFF},
            r"numPoints: expected at most 16 unpacked bytes .* got 85,899,345,900; scene\.max_inflation",
        ),
    ],
)
def test_a_header_that_does_not_fit_is_refused_by_field(tmp_path: Path, header: dict[str, int], message: str) -> None:
    payload, count = random_spz(3, 0)
    path = written(tmp_path / "a.spz", spz_bytes(payload, **{"count": count, **header}))
    with pytest.raises(ValueError, match=rf"a\.spz: {message}"):
        read_gaussians(path)


def test_extensions_after_the_attributes_are_ignored(tmp_path: Path) -> None:
    payload, count = random_spz(3, 1)
    plain = read_gaussians(written(tmp_path / "a.spz", spz_bytes(payload, count, degree=1)))
    extended = written(tmp_path / "b.spz", spz_bytes(payload + b"a vendor's record", count, degree=1, flags=2))
    with pytest.warns(UserWarning, match=r"b\.spz: ignored vendor records of unknown types: 0x65762061"):
        torch.testing.assert_close(read_gaussians(extended).sh, plain.sh, atol=0, rtol=0)


UNKNOWN = struct.pack("<II3s", 0x12340001, 3, b"any")
CAMERA = struct.pack("<II3f", 0xADBE0002, 12, 0.1, 0.2, 3.0)
SH_RANGE = struct.pack("<BBff", 8, 8, -0.5, 0.25)
RECORDS = [
    struct.pack("<I", 0xADBE0001) + SH_RANGE,  # early writers state no size
    struct.pack("<I3fI", 0xADBE0002, 0.1, 0.2, 3.0, 0xADBE0001) + SH_RANGE,
    struct.pack("<II", 0xADBE0001, 10) + SH_RANGE,
    CAMERA + struct.pack("<II", 0xADBE0001, 10) + SH_RANGE + CAMERA,
]
SH_BITS = struct.pack("<IBB", 0xADBE0001, 5, 4)  # the first writers state neither size nor range
RECORDS_WITHOUT_RANGE = [
    SH_BITS,
    SH_BITS + struct.pack("<I3f", 0xADBE0002, -0.5, 0.5, 1.0),
    struct.pack("<I3f", 0xADBE0002, -0.5, 0.5, 1.0) + SH_BITS,
    SH_BITS + CAMERA,
    struct.pack("<IIBB", 0xADBE0001, 2, 5, 4),
    struct.pack("<IIBB", 0xADBE0001, 2, 5, 4) + CAMERA,
]


@pytest.mark.parametrize(
    ("version", "records"), [*((2, one) for one in RECORDS), *((3, one) for one in RECORDS), (4, RECORDS[2])]
)
def test_harmonics_have_the_range_that_a_vendor_record_states(tmp_path: Path, version: int, records: bytes) -> None:
    payload, count = random_spz(2 if version == 2 else 3, 1)
    if version < 4:
        content = spz_bytes(payload + records, count, version, 1, flags=2)
    else:
        pytest.importorskip("imagecodecs", reason="needs the extra gsply")
        content = spz_4_bytes(payload, count, 1, records)
    sh = read_gaussians(written(tmp_path / "a.spz", content)).sh[:, 1:]
    stored = np.frombuffer(payload[-9 * count :], np.uint8).reshape(count, 3, 3)
    torch.testing.assert_close(sh, torch.tensor(stored / 255 * 0.75 - 0.5, dtype=torch.float32), atol=1e-6, rtol=0)


@pytest.mark.parametrize("records", RECORDS_WITHOUT_RANGE)
@pytest.mark.parametrize("version", [2, 3])
def test_harmonics_have_their_usual_range_if_a_vendor_record_states_none(
    tmp_path: Path, version: int, records: bytes
) -> None:
    payload, count = random_spz(version, 1)
    plain = read_gaussians(written(tmp_path / "a.spz", spz_bytes(payload, count, version, 1)))
    extended = written(tmp_path / "b.spz", spz_bytes(payload + records, count, version, 1, flags=2))
    torch.testing.assert_close(read_gaussians(extended).sh, plain.sh, atol=0, rtol=0)


def test_unknown_vendor_records_are_skipped_with_one_warning(tmp_path: Path) -> None:
    payload, count = random_spz(3, 1)
    content = spz_bytes(payload + UNKNOWN + RECORDS[2] + UNKNOWN, count, 3, 1, flags=2)
    with pytest.warns(UserWarning, match=r"unknown types: 0x12340001$") as said:
        sh = read_gaussians(written(tmp_path / "a.spz", content)).sh[:, 1:]
    assert len(said) == 1
    assert -0.5 <= float(sh.min()) < float(sh.max()) <= 0.25


@pytest.mark.parametrize(("low", "high"), [(0.5, -0.5), (1.0, 1.0), (math.nan, 1.0), (-1.0, math.inf)])
def test_a_range_of_harmonics_that_is_none_is_ignored_with_a_warning(tmp_path: Path, low: float, high: float) -> None:
    payload, count = random_spz(3, 1)
    record = struct.pack("<IIBBff", 0xADBE0001, 10, 8, 8, low, high)
    plain = read_gaussians(written(tmp_path / "a.spz", spz_bytes(payload, count, 3, 1)))
    extended = written(tmp_path / "b.spz", spz_bytes(payload + record, count, 3, 1, flags=2))
    with pytest.warns(UserWarning, match=r"b\.spz: expected a range of harmonics, got "):
        torch.testing.assert_close(read_gaussians(extended).sh, plain.sh, atol=0, rtol=0)


@pytest.mark.parametrize("kept", [1, 9, 15, 60, -9, -1])
def test_a_truncated_stream_is_refused(tmp_path: Path, kept: int) -> None:
    payload, count = random_spz(2, 1)
    with pytest.raises(ValueError, match=r"a\.spz: "):
        read_gaussians(written(tmp_path / "a.spz", spz_bytes(payload, count, 2, 1)[:kept]))


def test_a_flipped_bit_is_refused_by_the_checksum(tmp_path: Path) -> None:
    payload, count = random_spz(3, 0)
    content = bytearray(spz_bytes(payload, count))
    content[60] ^= 1
    with pytest.raises(ValueError, match=r"a\.spz: expected a gzip stream, got a damaged one"):
        read_gaussians(written(tmp_path / "a.spz", bytes(content)))


def test_a_stream_that_is_not_spz_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="magic: expected b'NGSP', got b'some'"):
        read_gaussians(written(tmp_path / "a.spz", gzip.compress(b"something else altogether")))
    with pytest.raises(ValueError, match="version: expected 4, got 3"):
        read_gaussians(written(tmp_path / "a.spz", b"NGSP" + (3).to_bytes(4, "little") + bytes(40)))


def test_a_stream_that_unpacks_to_more_than_its_header_promises_is_not_unpacked(tmp_path: Path) -> None:
    payload, count = random_spz(3, 0)
    path = written(tmp_path / "a.spz", spz_bytes(payload + bytes(1 << 27), count))
    tracemalloc.start()
    with pytest.raises(ValueError, match="expected 180 bytes after the header, got more"):
        read_gaussians(path)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 1 << 22


def test_the_captured_kitchen_is_read(shared_scenes: Path) -> None:
    gaussians = read_gaussians(shared_scenes / "kitchen" / "kitchen.spz")
    assert (len(gaussians), gaussians.sh_degree) == (213_944, 0)
    assert_valid(gaussians)


def test_a_few_kilobytes_do_not_unpack_to_megabytes_unless_that_is_allowed(tmp_path: Path) -> None:
    count = 200_000
    path = written(tmp_path / "a.spz", spz_bytes(bytes(9 * count) + bytes([255]) * (11 * count), count))
    assert path.stat().st_size < 20_000
    with pytest.raises(
        ValueError, match=r"a\.spz: numPoints: expected at most 16 unpacked bytes .*; scene\.max_inflation"
    ):
        read_gaussians(path)
    assert len(read_gaussians(path, max_inflation=1000.0).means) == count
    assert len(read_scene(path, max_inflation=1000.0).gaussians.means) == count


@pytest.mark.parametrize("degree", [0, 1, 2, 3])
def test_version_4_gives_the_same_gaussians_as_version_3(tmp_path: Path, degree: int) -> None:
    pytest.importorskip("imagecodecs", reason="needs the extra gsply")
    payload, count = random_spz(3, degree)
    third = read_gaussians(written(tmp_path / "3.spz", spz_bytes(payload, count, 3, degree)))
    for extension in (b"", struct.pack("<II3f", 0xADBE0002, 12, 0.0, 1.0, 2.0)):
        fourth = read_gaussians(written(tmp_path / "4.spz", spz_4_bytes(payload, count, degree, extension)))
        assert_same(third, fourth)


@pytest.mark.parametrize(
    ("claims", "message"),
    [
        ({"version": 5}, "version: expected 4, got 5"),
        ({"degree": 5}, "shDegree: expected 0 to 4, got 5"),
        ({"degree": 1}, "expected a table of 6 streams in the file, got 5 at byte 32"),
        ({"streams": 6}, "expected a table of 5 streams in the file, got 6 at byte 32"),
        ({"contents": 4}, "expected a table of 5 streams in the file, got 5 at byte 4"),
        ({"contents": 0xFFFFFFFF}, "expected a table of 5 streams in the file, got 5 at byte 4294967295"),
        ({"contents": 33}, "stream 0: expected 81 unpacked bytes"),
        ({"count": 8}, "stream 0: expected 72 unpacked bytes, got 81"),
        ({"count": 0xFFFFFFFF}, r"numPoints: expected at most 16 unpacked bytes .*scene\.max_inflation"),
    ],
)
def test_a_header_of_version_4_that_does_not_fit_is_refused(
    tmp_path: Path, claims: dict[str, int], message: str
) -> None:
    pytest.importorskip("imagecodecs", reason="needs the extra gsply")
    path = written(tmp_path / "a.spz", spz_4_bytes(*random_spz(3, 0), claims=claims))
    with pytest.raises(ValueError, match=rf"a\.spz: {message}"):
        read_gaussians(path)


def test_a_damaged_file_of_version_4_is_refused(tmp_path: Path) -> None:
    pytest.importorskip("imagecodecs", reason="needs the extra gsply")
    whole = spz_4_bytes(*random_spz(3, 0))
    for damaged in (whole[:20], whole[:-1], whole[:112] + b"x" + whole[113:]):
        with pytest.raises(ValueError, match=r"a\.spz: "):
            read_gaussians(written(tmp_path / "a.spz", damaged))
