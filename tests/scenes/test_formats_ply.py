import random
import warnings
from pathlib import Path

import numpy as np
import pytest
import torch

from splatrl.scenes.formats import read_gaussians, write_gaussians
from splatrl.scenes.formats.ply import write_ply
from splatrl.scenes.formats.reading import trained_antialiased
from splatrl.scenes.gaussians import INVISIBLE
from tests.scenes.samples import assert_same, ply_bytes, ply_fields, sample_gaussians

KINDS = ["ascii", "binary_little_endian", "binary_big_endian"]


def written(path: Path, content: bytes) -> Path:
    path.write_bytes(content)
    return path


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("degree", [0, 1, 2, 3])
def test_fields_are_found_by_name_whatever_their_order_and_encoding(tmp_path: Path, kind: str, degree: int) -> None:
    gaussians = sample_gaussians(7, degree)
    fields = {**ply_fields(gaussians), "nx": np.zeros(7, np.float32), "confidence": np.ones(7, np.float32)}
    names = list(fields)
    random.Random(degree).shuffle(names)
    path = written(tmp_path / "a.ply", ply_bytes({name: fields[name] for name in names}, kind))
    assert_same(read_gaussians(path), gaussians)


@pytest.mark.parametrize(
    ("comments", "antialiased"),
    [
        (["Exported from Brush", "SH degree: 0", "SplatRenderMode: mip"], True),
        (["SplatRenderMode: default"], False),
        (["antialiased 1"], True),
        (["antialiased 0"], False),
        (["antialiased 0", "SplatRenderMode: mip"], None),
        (["rendered antialiased"], None),
        ([], None),
    ],
)
def test_comments_say_whether_a_splat_was_trained_antialiased(
    tmp_path: Path, comments: list[str], antialiased: bool | None
) -> None:
    lines = "".join(f"comment {comment}\n" for comment in comments).encode()
    content = ply_bytes(ply_fields(sample_gaussians(3, 0)), KINDS[1])
    path = written(tmp_path / "a.ply", content.replace(b"element", lines + b"element", 1))
    assert trained_antialiased(path) is antialiased
    write_gaussians(tmp_path / "b.ply", read_gaussians(path), antialiased)
    assert trained_antialiased(tmp_path / "b.ply") is antialiased


def test_fields_may_be_doubles_and_other_elements_are_skipped(tmp_path: Path) -> None:
    gaussians = sample_gaussians(3, 0)
    fields = ply_fields(gaussians)
    header = ["ply", "format binary_little_endian 1.0", "element sensor 2", "property ushort id", "element vertex 3"]
    header += [*(f"property double {name}" for name in fields), "element camera 2", "property list uchar int ids"]
    header += ["end_header", ""]
    camera = bytes([1]) + (5).to_bytes(4, "little") + bytes([0])
    rows = np.stack(list(fields.values()), 1).astype("<f8").tobytes()
    path = written(tmp_path / "A.PLY", "\r\n".join(header).encode() + bytes(4) + rows + camera)
    assert_same(read_gaussians(path), gaussians)


@pytest.mark.parametrize("kind", KINDS)
def test_the_smoothing_filter_of_mip_splatting_is_applied(tmp_path: Path, kind: str) -> None:
    plain = sample_gaussians(7, 1)
    smoothing = plain.scales.amax(1).numpy() * np.linspace(0.0, 0.5, 7, dtype=np.float32)
    fused = plain.clone()
    fused.scales = (plain.scales**2 + torch.from_numpy(smoothing)[:, None] ** 2).sqrt()
    fused.opacities = plain.opacities * plain.scales.prod(1) / fused.scales.prod(1)
    path = written(tmp_path / "a.ply", ply_bytes({**ply_fields(plain), "filter_3D": smoothing}, kind))
    assert_same(read_gaussians(path), fused)


@pytest.mark.parametrize("kind", KINDS)
def test_surfels_of_2d_gaussian_splatting_are_a_hundredth_as_thick_as_wide(tmp_path: Path, kind: str) -> None:
    gaussians = sample_gaussians(7, 1)
    fields = ply_fields(gaussians)
    del fields["scale_2"]
    gaussians.scales[:, 2] = 0.01 * gaussians.scales[:, :2].amin(1)
    assert_same(read_gaussians(written(tmp_path / "a.ply", ply_bytes(fields, kind))), gaussians)


def test_a_third_scale_of_another_name_makes_no_surfels(tmp_path: Path) -> None:
    fields = ply_fields(sample_gaussians(3, 0))
    fields["scale_02"] = fields.pop("scale_2")
    with pytest.raises(ValueError, match=r"got a PLY file without scale_2; it has .*scale_02"):
        read_gaussians(written(tmp_path / "a.ply", ply_bytes(fields)))


@pytest.mark.parametrize("degree", [0, 3])
def test_written_gaussians_read_back_the_same(tmp_path: Path, degree: int) -> None:
    gaussians = sample_gaussians(11, degree)
    write_gaussians(tmp_path / "a.ply", gaussians)
    assert_same(read_gaussians(str(tmp_path / "a.ply")), gaussians)
    assert [entry.name for entry in tmp_path.iterdir()] == ["a.ply"]


def test_a_written_file_has_the_fields_of_inrias_code_in_the_same_order(tmp_path: Path) -> None:
    write_gaussians(tmp_path / "a.ply", sample_gaussians(2, 1))
    header = (tmp_path / "a.ply").read_bytes().split(b"end_header\n")[0].decode().splitlines()
    names = [line.split()[-1] for line in header if line.startswith("property float")]
    rest = [f"f_rest_{i}" for i in range(9)]
    shape = [f"scale_{i}" for i in range(3)] + [f"rot_{i}" for i in range(4)]
    assert names == ["x", "y", "z", "nx", "ny", "nz", "f_dc_0", "f_dc_1", "f_dc_2", *rest, "opacity", *shape]
    assert header[1] == "format binary_little_endian 1.0"


def test_opacities_of_0_and_1_are_stored_finite_and_1_reads_back_as_1(tmp_path: Path) -> None:
    gaussians = sample_gaussians(3, 0)
    gaussians.opacities = torch.tensor([0.0, 1.0, 0.5])
    write_gaussians(tmp_path / "a.ply", gaussians)
    with pytest.warns(UserWarning, match="dropped 0 non-finite or degenerate and 1 fully transparent of 3"):
        assert read_gaussians(tmp_path / "a.ply").opacities.tolist() == [1.0, 0.5]


def test_values_that_cannot_be_stored_are_refused_and_the_old_file_is_kept(tmp_path: Path) -> None:
    path = tmp_path / "a.ply"
    path.write_bytes(b"old")
    gaussians = sample_gaussians(3, 0)
    gaussians.scales = gaussians.scales * torch.tensor([1.0, 0.0, 1.0])
    with pytest.raises(
        ValueError, match=r"a\.ply: scale_0, scale_1, scale_2: expected values that are finite when stored"
    ):
        write_gaussians(path, gaussians)
    assert path.read_bytes() == b"old"
    with pytest.raises(ValueError, match=r"expected the extension \.ply or \.spz, got '\.splat'"):
        write_gaussians(tmp_path / "a.splat", sample_gaussians())


@pytest.mark.parametrize("name", ["y", "f_dc_1", "opacity", "scale_1", "rot_0"])
def test_a_missing_field_is_named_in_the_error(tmp_path: Path, name: str) -> None:
    fields = ply_fields(sample_gaussians(3, 0))
    del fields[name]
    path = written(tmp_path / "a.ply", ply_bytes(fields))
    with pytest.raises(ValueError, match=rf"a\.ply: expected the fields of Gaussians, got a PLY file without {name};"):
        read_gaussians(path)


@pytest.mark.parametrize("removed", ["f_rest_23", "f_rest_0"])
def test_a_wrong_number_of_harmonics_is_refused(tmp_path: Path, removed: str) -> None:
    fields = ply_fields(sample_gaussians(3, 2))
    del fields[removed]
    path = written(tmp_path / "a.ply", ply_bytes(fields))
    with pytest.raises(ValueError, match=r"a\.ply: f_rest_\*: expected 0, 9, 24, 45 or 72 .* got 23"):
        read_gaussians(path)


def test_harmonics_with_a_gap_in_their_numbers_are_refused(tmp_path: Path) -> None:
    fields = ply_fields(sample_gaussians(3, 1))
    fields["f_rest_9"] = fields.pop("f_rest_4")
    with pytest.raises(ValueError, match="without f_rest_4;"):
        read_gaussians(written(tmp_path / "a.ply", ply_bytes(fields)))


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("promised", [8, 10**11])
def test_a_header_that_promises_more_than_the_file_holds_is_refused(tmp_path: Path, kind: str, promised: int) -> None:
    fields = ply_fields(sample_gaussians(7, 0))
    path = written(tmp_path / "a.ply", ply_bytes(fields, kind, count=promised))
    with pytest.raises(ValueError, match=r"a\.ply: expected"):
        read_gaussians(path)


def test_a_header_that_promises_endless_lists_is_refused(tmp_path: Path) -> None:
    header = (
        b"ply\nformat binary_little_endian 1.0\nelement face 99999999999\nproperty list uchar int v\nelement vertex 0\n"
    )
    names = ply_fields(sample_gaussians(1, 0))
    header += b"".join(f"property float {name}\n".encode() for name in names) + b"end_header\n"
    with pytest.raises(ValueError, match="expected 99999999999 bytes or more after the header, got 0"):
        read_gaussians(written(tmp_path / "a.ply", header))


def test_a_binary_file_that_is_too_short_is_refused(tmp_path: Path) -> None:
    content = ply_bytes(ply_fields(sample_gaussians(7, 0)))
    with pytest.raises(ValueError, match="expected 392 bytes after the header, got 391"):
        read_gaussians(written(tmp_path / "a.ply", content[:-1]))


@pytest.mark.parametrize("extra", [1, 1000])
def test_what_follows_the_last_row_is_ignored_with_a_warning(tmp_path: Path, extra: int) -> None:
    gaussians = sample_gaussians(7, 0)
    path = written(tmp_path / "a.ply", ply_bytes(ply_fields(gaussians)) + b"\0" * extra)
    with pytest.warns(UserWarning, match=rf"a\.ply: ignored {extra} bytes after the last row"):
        assert_same(read_gaussians(path), gaussians)


def test_harmonics_of_degree_4_are_left_out_with_a_warning(tmp_path: Path) -> None:
    gaussians = sample_gaussians(7, 3)
    fields = ply_fields(gaussians)
    finer = {f"f_rest_{24 * channel + i}": np.full(7, 9.0) for channel in range(3) for i in range(24)}
    for channel in range(3):
        for i in range(15):
            finer[f"f_rest_{24 * channel + i}"] = fields.pop(f"f_rest_{15 * channel + i}")
    path = written(tmp_path / "a.ply", ply_bytes({**fields, **finer}))
    with pytest.warns(UserWarning, match=r"a\.ply: left out the harmonics of degree 4"):
        assert_same(read_gaussians(path), gaussians)


@pytest.mark.parametrize("flat", [7, 6, 1])
def test_flat_gaussians_are_a_hundredth_as_thick_as_wide(tmp_path: Path, flat: int) -> None:
    gaussians = sample_gaussians(7, 0)
    fields = ply_fields(gaussians)
    fields["scale_2"][:flat] = -np.inf
    gaussians.scales[:flat, 2] = 0.01 * gaussians.scales[:flat, :2].amin(1)
    assert_same(read_gaussians(written(tmp_path / "a.ply", ply_bytes(fields))), gaussians)


@pytest.mark.parametrize(
    ("name", "value", "reason"),
    [("rot_", 0.0, "7 have a zero quaternion, 0 "), ("scale_", -np.inf, "0 have .*, 7 a scale of 0 or less, 0 ")],
)
def test_the_reason_is_said_why_no_gaussian_is_usable(tmp_path: Path, name: str, value: float, reason: str) -> None:
    fields = ply_fields(sample_gaussians(7, 0))
    fields |= {key: np.full(7, value) for key in fields if key.startswith(name)}
    with pytest.raises(ValueError, match=rf"a\.ply: .* got none among 7: {reason}"):
        read_gaussians(written(tmp_path / "a.ply", ply_bytes(fields)))


@pytest.mark.parametrize(
    "line", ["element vertex x", "property float", "property quad x", "format ascii 2.0", "element vertex 1", "splat"]
)
def test_an_invalid_header_line_is_quoted_in_the_error(tmp_path: Path, line: str) -> None:
    header = f"ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\n{line}\nend_header\n0\n"
    with pytest.raises(ValueError, match=rf"a\.ply: header: expected a line of a PLY header, got '{line}'"):
        read_gaussians(written(tmp_path / "a.ply", header.encode()))


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"not a splat", "expected a PLY file with a header"),
        (b"ply\nformat ascii 1.0\nelement vertex 3\n", "expected a PLY file with a header"),
        (b"ply\nelement vertex 1\nend_header\n", "expected a format line"),
        (b"ply\nformat ascii 1.0\nend_header\n", "expected an element vertex, got none"),
        (b"ply\nformat ascii 1.0\nproperty float x\nend_header\n", "expected a line of a PLY header"),
        (
            b"ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\nproperty float x\nend_header\n",
            "expected each property of vertex once, got x twice",
        ),
        (
            b"ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\nend_header\n1\n",
            "PLY file without y, z, f_dc_0",
        ),
    ],
)
def test_the_error_for_a_file_that_is_not_a_splat_says_what_is_missing(
    tmp_path: Path, content: bytes, message: str
) -> None:
    with pytest.raises(ValueError, match=rf"a\.ply: .*{message}"):
        read_gaussians(written(tmp_path / "a.ply", content))


def test_words_in_place_of_numbers_are_refused(tmp_path: Path) -> None:
    content = ply_bytes(ply_fields(sample_gaussians(2, 0)), "ascii")
    body = content.index(b"end_header\n") + len(b"end_header\n")
    damaged = content[:body] + b"z" * (len(content) - body - 1) + b"\n"
    with pytest.raises(ValueError, match=r"a\.ply: expected the rows that the header describes"):
        read_gaussians(written(tmp_path / "a.ply", damaged))


@pytest.mark.parametrize("degree", [0, 2])
def test_a_file_without_gaussians_is_refused(tmp_path: Path, degree: int) -> None:
    path = tmp_path / "none.ply"
    write_ply(path, sample_gaussians(4, degree)[:0])
    with pytest.raises(ValueError, match=r"none.ply: expected at least one Gaussian, got none"):
        read_gaussians(path)
    for ending in ("ply", "spz"):
        with pytest.raises(ValueError, match=rf"a.{ending}: expected at least one Gaussian to write, got none"):
            write_gaussians(tmp_path / f"a.{ending}", sample_gaussians(4, degree)[:0])


def test_the_faintest_visible_gaussians_are_read_again(tmp_path: Path) -> None:
    gaussians = sample_gaussians(7, 0)
    gaussians.opacities[:] = INVISIBLE
    write_gaussians(tmp_path / "faint.ply", gaussians)
    assert len(read_gaussians(tmp_path / "faint.ply")) == 7


def test_gaussians_too_far_from_the_origin_for_single_precision_give_a_warning(tmp_path: Path) -> None:
    gaussians, path = sample_gaussians(50, 0), tmp_path / "far.ply"
    gaussians.scales[:] = 0.05
    gaussians.means += torch.tensor([5e5, 5.4e6, 0.0])
    write_gaussians(path, gaussians)
    with pytest.warns(UserWarning, match=r"far.ply: .* 5.4e\+06 units from the origin, .* rounds positions to 0.5"):
        read_gaussians(path)
    gaussians.means -= torch.tensor([5e5, 5.4e6 - 5e3, 0.0])
    write_gaussians(path, gaussians)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        read_gaussians(path)


def test_a_non_finite_row_is_dropped(tmp_path: Path) -> None:
    fields = ply_fields(sample_gaussians(4, 0))
    fields["scale_1"] = np.array([0.0, 1000.0, -1000.0, np.nan], np.float32)
    with pytest.warns(UserWarning, match=r"a\.ply: dropped 3 non-finite or degenerate"):
        assert len(read_gaussians(written(tmp_path / "a.ply", ply_bytes(fields)))) == 1


def test_missing_and_empty_files_folders_and_unknown_extensions_have_their_own_errors(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError, match=r"none\.ply: no such splat file"):
        read_gaussians(tmp_path / "none.ply")
    with pytest.raises(ValueError, match="expected a splat file, got a folder"):
        read_gaussians(tmp_path)
    with pytest.raises(ValueError, match=r"a\.ply: expected a splat file, got an empty one"):
        read_gaussians(written(tmp_path / "a.ply", b""))
    with pytest.raises(
        ValueError, match=r"expected a file with the extension \.ply, \.sog, \.json, \.splat, \.spz, got '\.obj'"
    ):
        read_gaussians(tmp_path / "a.obj")
    with pytest.raises(ValueError, match="got 'no extension'"):
        read_gaussians(tmp_path / "a")


def test_a_trained_scene_is_read(shared_scenes: Path) -> None:
    gaussians = read_gaussians(shared_scenes / "brighton" / "brighton.ply")
    assert (len(gaussians), gaussians.sh_degree) == (11843, 1)


def test_elements_with_lists_are_skipped_and_lists_in_vertices_are_refused(tmp_path: Path) -> None:
    fields = ply_fields(sample_gaussians(3, 0))
    content = ply_bytes(fields, "ascii").decode()
    lists = "element face 2\nproperty list uchar int vertex_indices\nend_header"
    path = written(tmp_path / "a.ply", (content.replace("end_header", lists) + "not\nread\n").encode())
    assert_same(read_gaussians(path), sample_gaussians(3, 0))
    path = written(tmp_path / "a.ply", content.replace("end_header", "property list uchar int x2\nend_header").encode())
    with pytest.raises(ValueError, match=r"a\.ply: vertex: expected rows of a fixed size, got list properties"):
        read_gaussians(path)


def test_a_header_of_thousands_of_elements_is_refused_at_once(tmp_path: Path) -> None:
    many = "".join(f"element e{i} 1\nproperty char c\n" for i in range(30_000))
    path = written(tmp_path / "a.ply", f"ply\nformat ascii 1.0\n{many}end_header\n".encode())
    with pytest.raises(ValueError, match="expected a PLY file with a header"):
        read_gaussians(path)
