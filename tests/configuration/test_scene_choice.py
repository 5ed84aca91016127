"""A path after scene=, which stands for its config."""

from pathlib import Path

import pytest
import torch
from omegaconf import OmegaConf

from splatrl.building import build_world
from splatrl.configuration import (
    command_line,
    load_config,
    with_scene_paths,
)
from tests.tiny import tiny_gaussians, tiny_overrides


@pytest.fixture
def places(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A working directory with a splat file, a scene folder, and a file with the name of a built-in scene."""
    monkeypatch.chdir(tmp_path)
    tiny_overrides(tmp_path)
    for name in ("it's, a (room).ply", "kitchen"):
        (tmp_path / name).write_bytes((tmp_path / "tiny.ply").read_bytes())
    (tmp_path / "garden").mkdir()
    (tmp_path / "tiny.ply").rename(tmp_path / "garden" / "splat.ply")
    frame = {"axes": ["y", "-x", "z"], "scale": 2.0}
    OmegaConf.save(
        OmegaConf.create({"splat": "splat.ply", "world_from_splat": frame}), tmp_path / "garden" / "scene.yaml"
    )
    return tmp_path


@pytest.mark.parametrize("path", ["garden", "garden/splat.ply", "it's, a (room).ply", "./kitchen"])
def test_the_path_of_a_scene_stands_for_its_config(path: str, places: Path) -> None:
    for written in (path, str(places / path)):
        for overrides in (
            with_scene_paths([f"scene={written}"]),
            command_line("train", ["seed=1", f"scene={written}"]),
        ):
            cfg = load_config(overrides)
            assert (cfg.scene._target_, cfg.scene.path) == ("splatrl.read_scene", written)
        assert load_config([f"scene={written}"]).scene.path == written


def test_a_path_may_be_in_quotes(places: Path) -> None:
    for quote in "'\"":
        assert load_config([f"scene={quote}garden/splat.ply{quote}"]).scene.path == "garden/splat.ply"


def test_the_name_of_a_scene_takes_precedence_over_a_file_of_that_name(places: Path) -> None:
    assert with_scene_paths(["scene=kitchen", "task=fps"]) == ["scene=kitchen", "task=fps"]
    assert OmegaConf.is_missing(load_config(["scene=kitchen"]).scene, "path")


def test_a_missing_path_is_refused_with_the_valid_choices(places: Path) -> None:
    with pytest.raises(SystemExit, match=r"scene: expected one of backyard, file, .* or an existing path, got no.ply"):
        command_line("train", ["scene=no.ply"])


def test_overrides_that_give_no_path_of_a_scene_are_unchanged(places: Path) -> None:
    others = ["scene=nowhere", "scene=", "scene.path=garden", "task=garden", "+scene=garden", "~scene", "-m"]
    assert with_scene_paths(others) == others


def test_a_scene_folder_states_its_frame(places: Path) -> None:
    room = tiny_overrides(places)
    tiny = ("scene=", "scene.path=", "task.motion.", "robot.height", "robot.body")
    kept = [override for override in room if not override.startswith(tiny)]
    scene = build_world(load_config(["scene=garden", *kept, "robot.height=1.0", "collision=none"])).scene
    means = tiny_gaussians().means
    expected = 2 * torch.stack([means[:, 1], -means[:, 0], means[:, 2]], 1)
    torch.testing.assert_close(scene.gaussians.means, expected, atol=1e-4, rtol=0)
