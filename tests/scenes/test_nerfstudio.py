"""A splat that nerfstudio trained is moved back to its cameras' frame; files made of it say how it was trained."""

import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from PIL import Image

from splatrl.capture.inspection import ScenePictures
from splatrl.commands.scene import main
from splatrl.configuration import load_config, run_config, save_config, with_scene_paths
from splatrl.evaluation.scene_pictures import draw_scene
from splatrl.scenes import Gaussians, Scene, read_scene, similarity, write_gaussians
from splatrl.scenes.description import read_description
from splatrl.scenes.formats.reading import trained_antialiased
from splatrl.scenes.nerfstudio import antialiased_beside
from tests.scenes.samples import assert_same, sample_gaussians
from tests.scenes.test_survey import BOXES, FLOOR, surfaces

CONFIG = """!!python/object:nerfstudio.engine.trainer.TrainerConfig
_target: !!python/name:nerfstudio.engine.trainer.Trainer ''
evil: !!python/object/apply:os.system ['touch evil']
pipeline:
  model: !!python/object:nerfstudio.models.splatfacto.SplatfactoModelConfig
    rasterize_mode: {}
    sh_degree: 3
"""
SCALE = 0.25


def turned_about_z(yaw: float, tilt: float = 0.0) -> torch.Tensor:
    """Return what nerfstudio applies to cameras whose frame is z up: a turn, a slight tilt and a shift; [3, 4]."""
    c, s, ct, st = math.cos(yaw), math.sin(yaw), math.cos(tilt), math.sin(tilt)
    turn = torch.tensor([[c, -s, 0], [s, c, 0], [0, 0, 1]]) @ torch.tensor([[1, 0, 0], [0, ct, -st], [0, st, ct]])
    return torch.cat([turn, torch.tensor([[0.5], [2.0], [-1.0]])], 1).double()


def trained(
    folder: Path, captured: Gaussians, moved: torch.Tensor, mode: str | None = None, name: str = "splat.ply"
) -> Path:
    """Write what nerfstudio exports for Gaussians in the frame of the cameras: x_splat = SCALE · (R x + t)."""
    folder.mkdir(exist_ok=True)
    whole = torch.cat([SCALE * moved, torch.tensor([[0.0, 0, 0, 1]], dtype=torch.float64)])
    write_gaussians(folder / name, captured.transformed(whole))
    (folder / "dataparser_transforms.json").write_text(json.dumps({"transform": moved.tolist(), "scale": SCALE}))
    if mode is not None:
        (folder / "config.yml").write_text(CONFIG.format(mode))
    return folder / name


def test_a_splat_returns_to_the_frame_of_its_cameras_with_its_harmonics_turned(tmp_path: Path) -> None:
    captured = sample_gaussians(30, degree=3)
    splat = trained(tmp_path / "ns", captured, turned_about_z(2.0, 0.3))
    assert_same(read_scene(splat).gaussians, captured, atol=1e-5)
    splat.with_name("dataparser_transforms.json").unlink()
    assert not torch.allclose(read_scene(splat).gaussians.means, captured.means, atol=0.1)


def test_a_stated_frame_takes_precedence_over_the_transforms_file(tmp_path: Path) -> None:
    captured = sample_gaussians(9, degree=1)
    splat = trained(tmp_path / "ns", captured, turned_about_z(2.0))
    raw = read_scene(splat, similarity()).gaussians
    assert_same(read_scene(splat, {"axes": ["x", "-z", "y"]}).gaussians, raw.transformed(similarity(["x", "-z", "y"])))
    (splat.parent / "scene.yaml").write_text("splat: splat.ply\nworld_from_splat: {scale: 3.0}\n")
    assert_same(read_scene(splat.parent).gaussians, raw.transformed(similarity(scale=3.0)))
    (splat.parent / "scene.yaml").write_text("splat: splat.ply\nname: yard\n")
    assert_same(read_scene(splat.parent).gaussians, captured, atol=1e-5)


def test_a_frame_that_is_not_z_up_gives_a_warning(tmp_path: Path) -> None:
    captured = sample_gaussians(9, degree=0)
    from_y_up = torch.tensor([[1.0, 0, 0, 0.5], [0, 0, -1, 2], [0, 1, 0, -1]]).double()
    splat = trained(tmp_path / "ns", captured, from_y_up)
    with pytest.warns(UserWarning, match=r"splat\.ply: dataparser_transforms\.json .* not z-up; .* with splatrl-scene"):
        assert_same(read_scene(splat).gaussians, captured, atol=1e-5)


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ('{"transform": [[2, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0]], "scale": 1}', "expected a rotation and a shift"),
        ('{"transform": [[1, 0, 0, NaN], [0, 1, 0, 0], [0, 0, 1, 0]], "scale": 1}', "3 rows of 4 finite numbers"),
        (
            '{"transform": [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0]], "scale": Infinity}',
            "scale: expected a number above 0",
        ),
        ('{"transform": [[1, 0, 0, 1e999], [0, 1, 0, 0], [0, 0, 1, 0]], "scale": 1}', "3 rows of 4 finite numbers"),
        (f'{{"transform": [[{10**400}, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0]], "scale": 1}}', "expected numbers"),
        ("[" * 100_000, "expected JSON"),
        (" " * (2**20 + 1), "expected at most 1,048,576 bytes"),
    ],
)
def test_a_malformed_transforms_file_gives_a_one_line_error(tmp_path: Path, content: str, message: str) -> None:
    splat = trained(tmp_path / "ns", sample_gaussians(9, degree=0), turned_about_z(1.0))
    splat.with_name("dataparser_transforms.json").write_text(content)
    with pytest.raises(ValueError, match=rf"dataparser_transforms\.json: .*{message}") as refused:
        read_scene(splat)
    assert "\n" not in str(refused.value)
    with pytest.raises(SystemExit, match=rf"splatrl-scene: .*{message}"):
        main([str(splat)])


@pytest.mark.parametrize(("mode", "antialiased"), [("classic", False), ("antialiased", True), ("'classic'", False)])
def test_images_are_antialiased_however_a_splat_was_trained(tmp_path: Path, mode: str, antialiased: bool) -> None:
    splat = trained(tmp_path / "ns", sample_gaussians(9, degree=0), turned_about_z(1.0), mode)
    assert antialiased_beside(splat) is antialiased
    overrides = [f"scene={splat}", "robot.height=1", "landmarks.goal=[0,0,0]"]
    cfg = load_config(overrides)
    assert cfg.renderer.antialiased is cfg.renderer.cpu.antialiased is True
    save_config(cfg, tmp_path)
    assert run_config(tmp_path).renderer.cpu.antialiased is True
    assert load_config(["renderer.antialiased=false", *overrides]).renderer.antialiased is False
    assert load_config([*overrides, "renderer=reference"]).renderer.antialiased is True
    assert not (tmp_path / "evil").exists() and not Path("evil").exists()


@pytest.mark.parametrize(
    "content",
    ["rasterize_mode: other", "a: 'rasterize_mode: classic'", "rasterize_mode: classic\nrasterize_mode: antialiased"],
)
def test_no_rasterize_mode_is_assumed_where_the_config_is_unclear(tmp_path: Path, content: str) -> None:
    splat = trained(tmp_path / "ns", sample_gaussians(9, degree=0), turned_about_z(1.0))
    (splat.parent / "config.yml").write_text(content)
    assert antialiased_beside(splat) is None
    assert with_scene_paths([f"scene={splat}"]) == ["scene=file", f"scene.path='{splat}'"]


def test_only_the_scene_yaml_of_a_folder_asks_for_classic_images(tmp_path: Path) -> None:
    splat = trained(tmp_path / "ns", sample_gaussians(9, degree=0), turned_about_z(1.0), "classic")
    (splat.parent / "scene.yaml").write_text("splat: splat.ply\nrobot_height: 1.0\n")
    assert load_config([f"scene={splat.parent}"]).renderer.antialiased is True
    (splat.parent / "scene.yaml").write_text("splat: splat.ply\nrobot_height: 1.0\nantialiased: false\n")
    assert load_config([f"scene={splat.parent}"]).renderer.antialiased is False
    (splat.parent / "scene.yaml").write_text("splat: splat.ply\nantialiased: 1\n")
    with pytest.raises(ValueError, match=r"scene\.yaml: antialiased: expected true or false, got 1"):
        load_config([f"scene={splat.parent}"])


@pytest.mark.usefixtures("ungrounded")
def test_splatrl_scene_reads_the_frame_beside_the_splat_and_draws_as_the_scene_yaml_says(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    drawn: list[bool] = []

    def draw(pictures: ScenePictures, scene: Scene, *others: Any) -> list[Path]:
        drawn.append(pictures.antialiased)
        return draw_scene(scene, *others, pictures.folder, pictures.antialiased)

    monkeypatch.setattr(ScenePictures, "of_scene", draw)
    world = surfaces([FLOOR, *BOXES])
    splat = trained(tmp_path / "ns", world, turned_about_z(1.0), "classic")
    main([str(splat)])
    assert "frame       from dataparser_transforms.json next to the file" in capsys.readouterr().out
    description = splat.with_name("scene.yaml")
    assert "antialiased" not in read_description(splat.parent)
    torch.testing.assert_close(read_scene(splat.parent).gaussians.means, world.means, atol=1e-4, rtol=0)
    antialiased = np.asarray(Image.open(splat.with_name("splat-view.png")))
    description.write_text(description.read_text() + "antialiased: false\n")
    main([str(splat.parent)])
    assert drawn == [True, False]
    assert (np.asarray(Image.open(splat.with_name("splat-view.png"))) != antialiased).any()


@pytest.mark.usefixtures("unproposed")
@pytest.mark.parametrize(("mode", "antialiased"), [("classic", False), ("antialiased", True)])
def test_a_written_splat_says_how_nerfstudio_trained_it(tmp_path: Path, mode: str, antialiased: bool) -> None:
    splat = trained(tmp_path / "ns", surfaces([FLOOR, *BOXES]), turned_about_z(1.0), mode)
    main([str(splat), "--out", str(tmp_path / "small.spz")])
    assert trained_antialiased(tmp_path / "small" / "splat.spz") is antialiased


@pytest.mark.usefixtures("ungrounded")
def test_splatrl_scene_finds_up_where_the_cameras_frame_is_not_z_up(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    world = surfaces([FLOOR, *BOXES])
    y_up = similarity(["x", "z", "-y"])  # the cameras' frame has +y up
    moved = torch.tensor([[1.0, 0, 0, 0.5], [0, 0, -1, 2], [0, 1, 0, -1]]).double()
    splat = trained(tmp_path / "ns", world.transformed(y_up), moved)
    main([str(splat)])
    assert "scale from dataparser_transforms.json" in capsys.readouterr().out
    z = read_scene(splat.parent).gaussians.means[:, 2]
    assert (float(z.median()), float(z.max())) == pytest.approx((0.0, 1.2), abs=0.02)
