import json
import math
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from hydra.utils import instantiate
from omegaconf import OmegaConf

from splatrl.scenes import Gaussians, Scene, backyard, read_scene, write_gaussians
from splatrl.scenes.scene import FreeSpace, content_of, robust_bounds
from tests.scenes.samples import assert_same, sample_gaussians

CONF = Path(__file__).parents[2] / "conf" / "scene"
UPRIGHT = {"axes": ["x", "-z", "y"], "scale": 2.0}


@pytest.fixture(autouse=True)
def cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("SPLATRL_CACHE", str(tmp_path / "cache"))
    return tmp_path / "cache"


@pytest.fixture
def splat(tmp_path: Path) -> Path:
    write_gaussians(tmp_path / "garden.ply", sample_gaussians(9, 1))
    return tmp_path / "garden.ply"


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    (tmp_path / "yard").mkdir()
    write_gaussians(tmp_path / "yard" / "point_cloud.ply", sample_gaussians(9, 1))
    return tmp_path / "yard"


def scene_of(gaussians: Gaussians) -> Scene:
    return Scene("test", gaussians, robust_bounds(gaussians))


def counting(calls: list[int], value: float = 1.0) -> dict[str, np.ndarray]:
    calls.append(1)
    return {"value": np.array([value])}


def test_a_splat_file_becomes_a_scene_of_the_same_name_in_its_own_coordinates(splat: Path) -> None:
    scene = read_scene(splat)
    assert scene.name == "garden"
    assert_same(scene.gaussians, sample_gaussians(9, 1))
    assert scene.bounds == robust_bounds(scene.gaussians)


def test_a_frame_turns_the_gaussians_upright_and_scales_them_to_metres(splat: Path) -> None:
    x, y, z = sample_gaussians(9, 1).means.unbind(1)
    upright = read_scene(str(splat), UPRIGHT)
    torch.testing.assert_close(upright.gaussians.means, 2 * torch.stack([x, -z, y], 1))
    matrix = torch.tensor([[2.0, 0, 0, 0], [0, 0, -2, 0], [0, 2, 0, 0], [0, 0, 0, 1]])
    assert_same(read_scene(splat, matrix).gaussians, upright.gaussians)


def test_a_folder_describes_its_splat_in_scene_yaml(folder: Path) -> None:
    (folder / "scene.yaml").write_text(
        "splat: point_cloud.ply\nname: our yard\nworld_from_splat:\n  axes: [x, -z, y]\n  scale: 2.0\n"
        "bounds: [[-1, -2, 0], [1, 2, 3.5]]\n"
    )
    scene = read_scene(folder)
    assert scene.name == "our yard"
    assert scene.bounds == ((-1.0, -2.0, 0.0), (1.0, 2.0, 3.5))
    assert_same(scene.gaussians, read_scene(folder / "point_cloud.ply", UPRIGHT).gaussians)


def test_arguments_override_the_scene_yaml_key_by_key(folder: Path) -> None:
    (folder / "scene.yaml").write_text("splat: point_cloud.ply\nworld_from_splat: {axes: [x, -z, y], scale: 7.0}\n")
    scene = read_scene(folder, {"axes": None, "scale": 2.0}, bounds=[(0, 0, 0), (1, 1, 1)], name="mine")
    assert scene.name == "mine"
    assert scene.bounds == ((0.0, 0.0, 0.0), (1.0, 1.0, 1.0))
    assert read_scene(folder, bounds=[np.zeros(3).tolist(), list(np.ones(3, np.float32))]).bounds == scene.bounds
    assert_same(scene.gaussians, read_scene(folder / "point_cloud.ply", UPRIGHT).gaussians)


TURN = ["x", "-z", "y"]
ROWS = [[2.0, 0.0, 0.0, 1.0], [0.0, 0.0, -2.0, 2.0], [0.0, 2.0, 0.0, 3.0], [0.0, 0.0, 0.0, 1.0]]
PARTS = {"axes": TURN, "scale": 2.0, "translation": [1.0, 2.0, 3.0]}


@pytest.mark.parametrize("own", [{"matrix": ROWS}, PARTS, {"matrix": ROWS, "axes": None, "scale": None}])
@pytest.mark.parametrize(
    ("typed", "expected"),
    [
        ({}, PARTS),
        ({"scale": 5.0}, {**PARTS, "scale": 5.0}),
        ({"axes": ["-x", "-y", "z"]}, {**PARTS, "axes": ["-x", "-y", "z"]}),
        ({"translation": [0.0, 0.0, 1.0]}, {**PARTS, "translation": [0.0, 0.0, 1.0]}),
        ({"axes": ["x", "y", "z"], "scale": 1.0, "translation": [0.0, 0.0, 0.0]}, {"axes": ["x", "y", "z"]}),
        ({"matrix": np.diag([3.0, 3.0, 3.0, 1.0]).tolist()}, {"scale": 3.0}),
        ({"matrix": None, "axes": None, "scale": None, "translation": None}, PARTS),
    ],
)
def test_a_typed_part_of_the_frame_replaces_that_part_whatever_the_form_of_the_scene_yaml(
    folder: Path, own: dict[str, Any], typed: dict[str, Any], expected: dict[str, Any]
) -> None:
    (folder / "scene.yaml").write_text(f"splat: point_cloud.ply\nworld_from_splat: {json.dumps(own)}\n")
    found, right = read_scene(folder, typed).gaussians, read_scene(folder / "point_cloud.ply", expected).gaussians
    torch.testing.assert_close(found.means, right.means)
    torch.testing.assert_close(found.scales, right.scales)


def test_a_typed_frame_of_both_forms_is_refused(folder: Path) -> None:
    (folder / "scene.yaml").write_text("splat: point_cloud.ply\nworld_from_splat: {scale: 2.0}\n")
    with pytest.raises(ValueError, match=r"^world_from_splat: expected either a matrix or axes, scale and translation"):
        read_scene(folder, {"matrix": ROWS, "scale": 3.0})


@pytest.mark.parametrize(
    ("line", "message"),
    [
        (
            "world_from_splat: {scale: -1}",
            r"world_from_splat\.scale: expected",
        ),
        ("world_from_splat: {up: z}", "world_from_splat: expected the keys"),
        ("bounds: [[0, 0, 0], [1, 0, 1]]", "bounds: expected lower below upper along y"),
        ("free: free.ply", "free: expected voxel_size to be stated with it"),
    ],
)
def test_an_error_in_a_scene_yaml_names_the_file_and_one_that_was_typed_does_not(
    folder: Path, line: str, message: str
) -> None:
    (folder / "scene.yaml").write_text(f"splat: point_cloud.ply\n{line}\n")
    with pytest.raises(ValueError, match=rf"^{re.escape(str(folder / 'scene.yaml'))}: {message}"):
        read_scene(folder)
    (folder / "scene.yaml").write_text("splat: point_cloud.ply\n")
    for typed in ({"scale": -2}, {"up": "z"}):
        with pytest.raises(ValueError, match=r"^world_from_splat"):
            read_scene(folder, typed)
    with pytest.raises(ValueError, match=r"^bounds: expected lower below upper"):
        read_scene(folder, bounds=[[0, 0, 0], [1, 0, 1]])


def test_a_folder_without_a_frame_or_a_name_takes_the_defaults(folder: Path) -> None:
    (folder / "scene.yaml").write_text("splat: point_cloud.ply\nworld_from_splat: null\nname:\n")
    scene = read_scene(folder)
    assert scene.name == "yard"
    assert_same(scene.gaussians, sample_gaussians(9, 1))


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (
            "splat: point_cloud.ply\nup: z\nsplats: 1",
            "expected the keys splat, name, .* got up, splats; did you mean splat",
        ),
        (
            "splat: point_cloud.ply\nrobot_hieght: 0.4",
            r"expected the keys .*, got robot_hieght; did you mean robot_height\?",
        ),
        ("name: x", "splat: expected the name of a file in this folder, got none"),
        ("splat: ../other.ply", "splat: expected a name, without slashes, got '../other.ply'"),
        ("splat: 3", "splat: expected a name, without slashes, got 3"),
        (f"splat: a.ply\nname: {'厨房' * 34}", "name: expected a name of at most 200 bytes, got 204 in '厨房"),
        ("splat: point_cloud.ply\nname: [1]", "name: expected a name, without slashes"),
        ("splat: point_cloud.ply\nworld_from_splat: upright", "world_from_splat: expected keys and values"),
        ("- splat", "expected keys and values, got \\['splat'\\]"),
        ("splat: [", "expected plain YAML, got"),
        ("just text", "expected"),
        ("", "splat: expected the name of a file in this folder, got none"),
    ],
)
def test_a_malformed_scene_yaml_is_refused_by_key(folder: Path, content: str, message: str) -> None:
    (folder / "scene.yaml").write_text(content)
    with pytest.raises(ValueError, match=rf"scene\.yaml: {message}"):
        read_scene(folder)


def test_a_frame_with_unknown_keys_is_refused(folder: Path, splat: Path) -> None:
    (folder / "scene.yaml").write_text("splat: point_cloud.ply\nworld_from_splat: {up: z}")
    for path, frame in ((folder, None), (splat, {"up": "z"})):
        message = "world_from_splat: expected the keys axes, scale, translation, matrix, got up"
        with pytest.raises(ValueError, match=message):
            read_scene(path, frame)


def test_missing_files_are_named_in_the_error(tmp_path: Path, folder: Path) -> None:
    with pytest.raises(FileNotFoundError, match=r"none: expected a splat file or a scene's folder, found none"):
        read_scene(tmp_path / "none")
    with pytest.raises(FileNotFoundError, match=r"yard: expected a scene folder with scene\.yaml"):
        read_scene(folder)
    (folder / "scene.yaml").write_text("splat: none.spz")
    with pytest.raises(FileNotFoundError, match=r"none\.spz: no such splat file"):
        read_scene(folder)


@pytest.mark.parametrize(
    "bounds",
    [[(0, 0, 0)], [(0, 0), (1, 1)], [(0, 0, 0), (1, 0, 1)], [(0, 0, 0), (1, 1, math.nan)], "ab", ["abc", (0, 0, 0)]],
)
def test_invalid_bounds_are_refused(splat: Path, bounds: object) -> None:
    with pytest.raises(ValueError, match="bounds: expected"):
        read_scene(splat, bounds=bounds)


def test_bounds_leave_out_floaters_and_faint_gaussians() -> None:
    gaussians = sample_gaussians(1000, 0)
    gaussians.means = torch.rand(1000, 3, generator=torch.Generator().manual_seed(0))
    gaussians.opacities = torch.ones(1000)
    gaussians.means[:3] = 1000.0
    gaussians.means[3:300, 2] = -50.0
    gaussians.opacities[3:300] = 0.4
    lower, upper = robust_bounds(gaussians)
    assert all(-0.05 < low < 0.05 for low in lower)
    assert all(0.95 < high < 1.05 for high in upper)
    gaussians.opacities[:] = 0.4
    assert robust_bounds(gaussians)[0][2] == -50.0


def test_the_backyard_follows_seed_and_clutter_and_has_the_bounds_of_the_yard(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(
        "splatrl.scenes.sources.backyard_gaussians", lambda seed, clutter: sample_gaussians(seed=seed + 10 * clutter)
    )
    assert_same(backyard().gaussians, sample_gaussians(seed=0))
    scene = backyard(seed=1, clutter=2)
    assert_same(scene.gaussians, sample_gaussians(seed=21))
    assert scene.name == "backyard"
    assert scene.bounds == ((-3.0, -3.0, 0.0), (3.0, 3.0, 3.0))
    assert backyard(bounds=[[0, 0, 0], [1, 2, 3]]).bounds == ((0.0, 0.0, 0.0), (1.0, 2.0, 3.0))
    with pytest.raises(ValueError, match="bounds: expected lower below upper along z"):
        backyard(bounds=[[0, 0, 0], [1, 2, -3]])


def test_a_file_called_backyard_is_a_file_like_any_other(tmp_path: Path) -> None:
    (tmp_path / "backyard").mkdir()
    with pytest.raises(FileNotFoundError, match="expected a scene folder"):
        read_scene(tmp_path / "backyard")
    write_gaussians(tmp_path / "backyard.ply", sample_gaussians(9, 1))
    assert_same(read_scene(tmp_path / "backyard.ply").gaussians, sample_gaussians(9, 1))


def test_cached_arrays_are_rebuilt_exactly_when_gaussians_settings_or_name_change() -> None:
    gaussians = sample_gaussians(9)
    calls: list[int] = []
    settings = {"resolution": 0.05, "crop": ((0, 0, 0), (1, 1, 1))}
    for scene in (scene_of(gaussians), scene_of(gaussians.clone())):
        assert scene.cached("voxels", settings, lambda: counting(calls, 3.5))["value"].tolist() == [3.5]
    as_yaml = OmegaConf.create({"crop": [[0, 0, 0], [1, 1, 1]], "resolution": 0.05})
    scene_of(gaussians).cached("voxels", dict(as_yaml), lambda: counting(calls))
    assert len(calls) == 1
    scene_of(gaussians).cached("voxels", {**settings, "resolution": 0.1}, lambda: counting(calls))
    scene_of(gaussians).cached("points", settings, lambda: counting(calls))
    scene_of(sample_gaussians(9, seed=1)).cached("voxels", settings, lambda: counting(calls))
    assert len(calls) == 4


@pytest.mark.parametrize("name", ["means", "quats", "scales", "opacities", "sh"])
def test_a_change_in_any_field_changes_the_digest_of_a_scene(name: str) -> None:
    changed = sample_gaussians(9)
    values = getattr(changed, name).clone()
    values.view(-1)[-1] += 1e-6
    setattr(changed, name, values)
    assert scene_of(changed).digest != scene_of(sample_gaussians(9)).digest


def test_the_content_of_a_scene_includes_its_free_space_of_which_its_digest_knows_nothing(tmp_path: Path) -> None:
    cloud = tmp_path / "free.ply"
    cloud.write_text("points")

    def scene(edge: float = 0.1) -> Scene:
        return replace(scene_of(sample_gaussians(9)), free=FreeSpace(cloud, edge))

    plain, first = scene_of(sample_gaussians(9)), scene()
    assert plain.content == plain.digest == first.digest != first.content == scene().content
    assert scene(0.2).content != first.content
    cloud.write_text("other points")
    assert scene().content != first.content
    assert content_of([plain]) == plain.content
    assert len({content_of(scenes) for scenes in ([plain], [plain, first], [first, plain])}) == 3


@pytest.mark.parametrize(
    "path",
    [path for path in sorted(CONF.glob("*.yaml")) if "_target_" in OmegaConf.load(path).scene],
    ids=lambda path: path.stem,
)
def test_every_scene_node_of_the_configuration_loads_a_scene(
    path: Path, splat: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in ("block_gaussians", "around_gaussians"):
        monkeypatch.setattr(f"splatrl.scenes.town.source.{name}", lambda *_: sample_gaussians())
    node = OmegaConf.load(path).scene
    if OmegaConf.is_missing(node, "path"):
        node.path = str(splat)
    if path.stem == "town":
        node.blocks = 1
    scene = instantiate(node)
    assert isinstance(scene, Scene)
    if path.stem == "kitchen":
        assert_same(scene.gaussians, read_scene(splat, {"axes": ["x", "-z", "y"]}).gaussians)
    if path.stem == "file":
        node.world_from_splat = {"axes": ["x", "-z", "y"], "scale": 2}
        node.bounds = [[0, 0, 0], [1, 1, 1]]
        scene = instantiate(node)
        assert_same(scene.gaussians, read_scene(splat, UPRIGHT).gaussians)
        assert scene.bounds == ((0.0, 0.0, 0.0), (1.0, 1.0, 1.0))


def test_the_captured_kitchen_stands_on_its_floor(shared_scenes: Path) -> None:
    scene = read_scene(shared_scenes / "kitchen" / "kitchen.spz", {"axes": ["x", "-z", "y"]})
    extents = [high - low for low, high in zip(*scene.bounds, strict=True)]
    assert extents == pytest.approx([3.6, 2.1, 2.3], abs=0.15)
    opaque = scene.gaussians.means[scene.gaussians.opacities > 0.5]
    on_the_floor = (opaque[:, 2].abs() < 0.03).float().mean()
    assert on_the_floor > 0.2  # nothing else is as large and level


HUGE = "1" + 400 * "0"


@pytest.mark.parametrize(
    ("line", "message"),
    [
        (f"voxel_size: {HUGE}", "voxel_size: expected"),
        (f"goal: [0, {HUGE}, 0]", "goal: expected"),
        (f"bounds: [[0, 0, 0], [1, 1, {HUGE}]]", "bounds: expected numbers from -1e.15"),
        (f"world_from_splat: {{scale: {HUGE}}}", "world_from_splat.scale: expected finite numbers"),
        (f"world_from_splat: {{translation: [0, 0, {HUGE}]}}", "world_from_splat.translation: expected finite"),
        ("world_from_splat: {translation: [0, 0, 1.0e+39]}", "world_from_splat: expected positions of at most"),
        ("world_from_splat: {scale: 1.0e-44}", "world_from_splat: expected positions of .* and positive sizes"),
    ],
)
def test_numbers_out_of_any_range_are_refused_in_one_line(tmp_path: Path, line: str, message: str) -> None:
    write_gaussians(tmp_path / "a.ply", sample_gaussians(5, 0))
    (tmp_path / "scene.yaml").write_text(f"splat: a.ply\n{line}\n")
    with pytest.raises(ValueError, match=message) as found:
        _ = read_scene(tmp_path).gaussians
    assert len(str(found.value)) < 1000
