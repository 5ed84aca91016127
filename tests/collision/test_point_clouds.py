import struct

import numpy as np
import plyfile
import pytest
import torch

from splatrl.collision import Occupancy
from splatrl.collision.point_clouds import read_points
from tests.collision.test_occupancy import blobs, remembering

CLOUD = np.array([[0.05, 0.12, -0.01], [1.5, -2.25, 3.0], [0.31, -0.29, 0.4]])


def write_ply(path, points=CLOUD, text=False, byte_order="<", kind="f4", faces=False):
    rows = np.zeros(len(points), [("red", "u1"), ("z", kind), ("x", kind), ("y", kind), ("alpha", "u2")])
    for i, axis in enumerate("xyz"):
        rows[axis] = points[:, i]
    elements = [plyfile.PlyElement.describe(rows, "vertex")]
    if faces:
        face = np.empty(1, [("vertex_indices", "O")])
        face["vertex_indices"] = [np.array([0, 1, 2], np.int32)]
        elements.append(plyfile.PlyElement.describe(face, "face"))
    plyfile.PlyData(elements, text=text, byte_order="=" if text else byte_order).write(str(path))


def pcd(points=CLOUD, data="binary", kind="f") -> bytes:
    """Encode a PCD cloud with an intensity before the coordinates and four bytes of padding after them."""
    size = struct.calcsize(kind)
    header = (
        f"# .PCD v0.7 - Point Cloud Data file format\nVERSION 0.7\n"
        f"FIELDS intensity x y z _\nSIZE 4 {size} {size} {size} 1\n"
        f"TYPE F F F F U\nCOUNT 1 1 1 1 4\nWIDTH {len(points)}\nHEIGHT 1\nVIEWPOINT 0 0 0 1 0 0 0\n"
        f"POINTS {len(points)}\nDATA {data}\n"
    ).encode()
    if data == "ascii":
        return header + b"".join(b"0.5 %.6f %.6f %.6f 1 2 3 4\n" % tuple(point) for point in points)
    return header + b"".join(struct.pack(f"<f3{kind}4x", 0.5, *point) for point in points)


@pytest.mark.parametrize("faces", [False, True])
@pytest.mark.parametrize("layout", [{"text": True}, {"byte_order": "<"}, {"byte_order": ">"}, {"kind": "f8"}])
def test_ply_vertices_are_read_in_any_layout(tmp_path, layout, faces):
    write_ply(tmp_path / "cloud.ply", faces=faces, **layout)
    points = read_points(tmp_path / "cloud.ply")
    assert points.dtype == np.float64
    assert points == pytest.approx(CLOUD, abs=1e-6)


@pytest.mark.parametrize("data", ["ascii", "binary"])
@pytest.mark.parametrize("kind", ["f", "d"])
def test_pcd_points_are_read_from_among_other_fields(tmp_path, data, kind):
    (tmp_path / "cloud.PCD").write_bytes(pcd(data=data, kind=kind))
    assert read_points(tmp_path / "cloud.PCD") == pytest.approx(CLOUD, abs=1e-6)


@pytest.mark.parametrize("data", ["ascii", "binary"])
def test_points_with_non_finite_coordinates_are_dropped(tmp_path, data):
    points = np.insert(CLOUD, 1, [np.nan, np.nan, np.nan], 0)
    points = np.insert(points, 0, [np.inf, 0.0, 0.0], 0)
    (tmp_path / "cloud.pcd").write_bytes(pcd(points, data))
    write_ply(tmp_path / "cloud.ply", points)
    for name in ("cloud.pcd", "cloud.ply"):
        assert read_points(tmp_path / name) == pytest.approx(CLOUD, abs=1e-6)


@pytest.mark.parametrize("points", [np.zeros((0, 3)), np.full((2, 3), np.nan)])
def test_a_cloud_without_points_is_refused(tmp_path, points):
    (tmp_path / "cloud.pcd").write_bytes(pcd(points))
    write_ply(tmp_path / "cloud.ply", points)
    for name in ("cloud.pcd", "cloud.ply"):
        with pytest.raises(
            ValueError, match=rf"{name}: expected finite points, got {len(points)} points, none of them finite"
        ):
            read_points(tmp_path / name)


def test_an_unknown_extension_a_folder_and_a_missing_file_give_different_errors(tmp_path):
    with pytest.raises(
        ValueError, match=r"cloud.las: expected a point cloud with the extension .ply or .pcd, got '.las'"
    ):
        read_points(tmp_path / "cloud.las")
    with pytest.raises(FileNotFoundError, match=r"cloud.ply: no such point cloud file"):
        read_points(tmp_path / "cloud.ply")
    (tmp_path / "cloud.pcd").mkdir()
    with pytest.raises(ValueError, match=r"got a folder"):
        read_points(tmp_path / "cloud.pcd")


def test_a_compressed_pcd_is_refused_with_the_formats_that_are_read(tmp_path):
    (tmp_path / "cloud.pcd").write_bytes(pcd(data="binary_compressed"))
    with pytest.raises(ValueError, match=r"cloud.pcd: DATA: expected ascii or binary, got 'binary_compressed'"):
        read_points(tmp_path / "cloud.pcd")


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        (b"x y z", b"x y w", "FIELDS: expected x, y and z, once each"),
        (b"x y z", b"x x z", "FIELDS: expected x, y and z, once each"),
        (b"COUNT 1 1", b"COUNT 1 2", "FIELDS: expected x, y and z, once each"),
        (b"TYPE F F", b"TYPE F Q", "TYPE, SIZE: expected one of"),
        (b"SIZE 4 4", b"SIZE 4 3", "TYPE, SIZE: expected one of"),
        (b"SIZE 4 4", b"SIZE 4", "SIZE: expected 5 whole numbers"),
        (b"WIDTH 3", b"WIDTH -3", "WIDTH: expected 1 whole numbers, got '-3'"),
        (b"WIDTH 3", b"WIDTH 4", "POINTS: expected WIDTH × HEIGHT = 4, got 3"),
        (b"HEIGHT 1\n", b"", "expected the lines .* found no HEIGHT"),
        (b"DATA", b"TADA", "expected a PCD file whose header ends with a DATA line"),
        (
            b"POINTS 3",
            b"POINTS 999999999999\nWIDTH 999999999999",
            r"expected at least \d+ bytes after the header, got \d+",
        ),
        (b"COUNT 1 1 1 1 4", b"COUNT 1 1 1 1 999999999999", r"expected at least \d+ bytes after the header"),
    ],
)
@pytest.mark.parametrize("data", ["ascii", "binary"])
def test_a_damaged_pcd_header_is_refused_before_anything_is_allocated(tmp_path, old, new, message, data):
    content = pcd(data=data)
    assert old in content
    (tmp_path / "cloud.pcd").write_bytes(content.replace(old, new))
    with pytest.raises(ValueError, match=rf"cloud.pcd: .*{message}|cloud.pcd: {message}"):
        read_points(tmp_path / "cloud.pcd")


def test_a_truncated_pcd_or_one_with_words_for_numbers_is_refused(tmp_path):
    path = tmp_path / "cloud.pcd"
    path.write_bytes(pcd()[:-1])
    with pytest.raises(ValueError, match=r"cloud.pcd: expected at least 60 bytes after the header, got 59"):
        read_points(path)
    path.write_bytes(pcd(data="ascii").replace(b"1.500000", b"1.5000oo"))
    with pytest.raises(ValueError, match=r"cloud.pcd: expected 8 numbers per row"):
        read_points(path)
    lines = pcd(data="ascii").splitlines(keepends=True)
    path.write_bytes(b"".join(lines[:-1]))
    with pytest.raises(ValueError, match=r"cloud.pcd: expected 3 rows, got 2"):
        read_points(path)


def test_a_damaged_ply_is_refused_by_name(tmp_path):
    path = tmp_path / "cloud.ply"
    for layout in ({}, {"faces": True}, {"text": True}):
        write_ply(path, **layout)
        content = path.read_bytes()
        path.write_bytes(content.replace(b"vertex 3", b"vertex 999999999999"))
        with pytest.raises(ValueError, match=r"cloud.ply: expected .*, got"):
            read_points(path)
        path.write_bytes(content.replace(b"float z", b"float w"))
        with pytest.raises(
            ValueError, match=r"cloud.ply: expected vertices with x, y and z, found no z; their properties are"
        ):
            read_points(path)
        path.write_bytes(content.replace(b"element vertex", b"element corner"))
        with pytest.raises(ValueError, match=r"cloud.ply: expected an element called vertex, got corner"):
            read_points(path)
    path.write_bytes(b"plyo")
    with pytest.raises(ValueError, match=r"cloud.ply: expected a PLY file"):
        read_points(path)


def test_the_centres_of_a_splat_are_read_as_a_cloud(shared_scenes):
    points = read_points(shared_scenes / "brighton" / "brighton.ply")
    assert points.shape == (11843, 3)


def test_a_cloud_becomes_an_occupancy_within_its_crop(tmp_path):
    write_ply(tmp_path / "cloud.ply")
    occupancy = Occupancy.from_file(tmp_path / "cloud.ply", 0.1, crop=((0, -1, -1), (1, 1, 1)))
    assert occupancy.keys().tolist() == [[0, 1, -1], [3, -3, 4]]
    assert Occupancy.from_file(tmp_path / "cloud.ply", 0.1).count == 3


def test_a_crop_without_points_is_refused_with_the_extent_of_the_points(tmp_path):
    write_ply(tmp_path / "cloud.ply")
    with pytest.raises(
        ValueError, match=r"cloud.ply: crop: expected a box that contains points, got .* spans .* \[1.5, 0.12, 3.0\]"
    ):
        Occupancy.from_file(tmp_path / "cloud.ply", 0.1, crop=((7, 7, 7), (8, 8, 8)))


def test_a_scenes_solid_voxels_can_come_from_a_cloud_and_be_edited(tmp_path):
    (tmp_path / "cloud.pcd").write_bytes(pcd())
    sheet = torch.cartesian_prod(torch.arange(-1, 1, 0.04), torch.arange(-1, 1, 0.04), torch.tensor([0.0]))
    scene, builds = remembering(blobs(sheet, 0.03), ((0.0, -0.6, -0.1), (1.0, 0.4, 0.5)))
    cloud = {"resolution": 0.1, "cloud": tmp_path / "cloud.pcd"}
    assert Occupancy.from_scene(scene, **cloud).keys().tolist() == [[0, 1, -1], [3, -3, 4]]  # one is out of bounds
    edited = Occupancy.from_scene(
        scene, **cloud, clear=[((0, 0, -1), (1, 1, 1))], add=[((0.5, 0.1, 0.2), (0.6, 0.3, 0.3))]
    )
    assert edited.keys().tolist() == [[3, -3, 4], [5, 1, 2], [5, 2, 2]]
    assert Occupancy.from_scene(scene, resolution=0.1).count > 100
    assert len(builds) == 3


def test_a_cloud_is_read_again_only_when_its_content_changes(tmp_path):
    path = tmp_path / "cloud.pcd"
    path.write_bytes(pcd())
    scene, builds = remembering(blobs(torch.zeros(1, 3), 0.1), ((0.0, -3.0, -1.0), (2.0, 1.0, 4.0)))
    assert Occupancy.from_scene(scene, cloud=path).count == 3
    moved = path.rename(tmp_path / "moved.pcd")
    assert Occupancy.from_scene(scene, cloud=str(moved)).count == 3
    assert len(builds) == 1
    moved.write_bytes(pcd(CLOUD[:2]))
    assert Occupancy.from_scene(scene, cloud=moved).count == 2
    with pytest.raises(FileNotFoundError, match=r"cloud.pcd: no such point cloud file"):
        Occupancy.from_scene(scene, cloud=path)
    with pytest.raises(ValueError, match=r"cloud.las: expected a point cloud with the extension"):
        Occupancy.from_scene(scene, cloud="cloud.las")
