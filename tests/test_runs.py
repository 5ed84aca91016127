"""Policies are loaded from run folders."""

import math
import shutil
import warnings
from dataclasses import replace
from pathlib import Path

import pytest
import torch
from PIL import Image

from splatrl.building import build_world
from splatrl.configuration import config_elsewhere, run_config
from splatrl.made_with import actions_of, check_actions, made_with
from splatrl.motions import DriveMotion, NavigateMotion
from splatrl.runs import load_policy
from splatrl.scenes import write_gaussians
from splatrl.training import save_checkpoint
from tests.experiments.trained import BEST, config, save_run
from tests.tiny import tiny_gaussians


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The run folder of a recurrent policy that prefers to move backwards."""
    folder = tmp_path_factory.mktemp("run")
    return save_run(folder / "run", config(folder, "memory=gru"), 1)


def test_a_policy_acts_in_the_world_that_it_was_trained_in(run: Path) -> None:
    trained = load_policy(run)
    assert trained.cfg == run_config(run)
    assert trained.world.task.reach == pytest.approx(0.5)
    begun = trained.beginning()
    assert begun.batch_size == (1,) and begun["pixels"].shape == (1, 12, 16, 3)
    assert set(trained.policy.in_keys) <= set(begun.keys(include_nested=True))
    acted = trained.policy(begun)
    assert int(acted["logits"].argmax()) == 1 and int(acted["action"]) in range(4)


def test_the_weights_are_those_of_the_checkpoint_that_is_asked_for(run: Path) -> None:
    world = build_world(run_config(run))
    for checkpoint, action in ((None, 1), ("last", 1), ("best", BEST)):
        trained = load_policy(str(run), checkpoint, world=world)
        assert trained.world is world
        assert int(trained.policy(trained.beginning())["logits"].argmax()) == action
        saved = torch.load(run / "checkpoints" / f"{checkpoint or 'last'}.pt", weights_only=True)["ppo"]["model"]
        for key, value in trained.model.state_dict().items():
            assert torch.equal(value, saved[key]) and torch.equal(value, trained.checkpoint["ppo"]["model"][key]), key


def test_the_config_chooses_the_checkpoint_and_a_changed_config_takes_precedence(run: Path) -> None:
    cfg = run_config(run)
    cfg.evaluation.checkpoint = "best"
    trained = load_policy(run, cfg=cfg)
    assert trained.cfg is cfg
    assert int(trained.policy(trained.beginning())["logits"].argmax()) == BEST


def test_a_policy_can_be_loaded_on_another_device_than_it_was_trained_on(run: Path) -> None:
    cfg = run_config(run)
    cfg.device = "cuda"
    trained = load_policy(run, device="cpu", cfg=cfg)
    assert trained.world.device.type == "cpu" and next(trained.model.parameters()).device.type == "cpu"


@pytest.mark.parametrize("place", [["scene.path=moved"], ["scene.paths=[b,a]"], ["scene.places.0.scene.path=moved"]])
def test_another_scene_where_the_runs_own_should_be_is_refused(run: Path, tmp_path: Path, place: list[str]) -> None:
    world, run = build_world(run_config(run)), Path(shutil.copytree(run, tmp_path / "run"))
    path = run / "checkpoints/last.pt"
    save_checkpoint(path, torch.load(path, weights_only=True) | {"made_with": {"scene": world.digest}})
    load_policy(run, world=world, place=place)
    emptied = replace(world, scene=replace(world.scene, gaussians=world.scene.gaussians[1:]), made_by=None)
    load_policy(run, world=emptied, place=["scene=b", *place])
    with pytest.raises(ValueError, match=r"expected the training's own scenes, .* got others or other contents"):
        load_policy(run, world=emptied, place=place)


@pytest.fixture
def duck(tmp_path: Path) -> tuple[Path, Path]:
    """A run folder with the content of its files in the checkpoint, and one of them, the picture of a sprite."""
    picture = tmp_path / "duck.png"
    Image.new("RGBA", (8, 8), "red").save(picture)
    cfg = config(tmp_path, f"drawing.sprite={picture}")
    run = save_run(tmp_path / "run", cfg, 1)
    path, made = run / "checkpoints/last.pt", made_with(cfg, build_world(cfg).digest)
    save_checkpoint(path, torch.load(path, weights_only=True) | {"made_with": made})
    return run, picture


def test_a_file_whose_content_has_changed_since_the_training_is_refused_by_name(duck: tuple[Path, Path]) -> None:
    run, picture = duck
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        load_policy(run, place=[])
    Image.new("RGBA", (8, 8), "darkred").save(picture)
    told = r"drawing\.sprite: its content differs from what the policy of .*last\.pt was trained with"
    for place in ([], ["checkpoint=last"]):
        with pytest.raises(ValueError, match=rf"^{told}; to use it as it is, type drawing\.sprite={picture}$"):
            load_policy(run, place=place)
    with pytest.warns(UserWarning, match=f"^{told}$"):
        load_policy(run)
    world = build_world(run_config(run))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        load_policy(run, world=world)  # as at the end of its training


def test_a_changed_file_that_was_typed_is_used_with_a_warning(duck: tuple[Path, Path]) -> None:
    run, picture = duck
    Image.new("RGBA", (8, 8), "darkred").save(picture)
    moved = picture.rename(picture.with_name("moved.png"))
    place = [f"drawing.sprite={moved}"]
    with pytest.warns(UserWarning, match=r"^drawing\.sprite: its content differs"):
        assert load_policy(run, cfg=config_elsewhere(run, place), place=place).cfg.drawing.sprite == str(moved)


def test_another_file_of_the_place_that_was_typed_is_no_changed_one(duck: tuple[Path, Path]) -> None:
    run, picture = duck
    Image.new("RGBA", (8, 8), "darkred").save(other := picture.with_name("other.png"))
    cfg = run_config(run)
    cfg.drawing.sprite = str(other)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        load_policy(run, cfg=cfg, place=["scene=elsewhere"])


def test_a_scene_that_has_changed_since_the_training_is_mentioned(duck: tuple[Path, Path]) -> None:
    run, picture = duck
    faded = tiny_gaussians()
    faded.sh *= 0.9
    write_gaussians(picture.with_name("tiny.ply"), faded)
    with pytest.warns(UserWarning, match=r"^scene: its content differs from what the policy of .* was trained with"):
        load_policy(run, place=[])
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        load_policy(run, place=["scene=elsewhere"])


def test_a_missing_run_or_an_unknown_checkpoint_is_refused_by_name(run: Path, tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError, match=f"{tmp_path}: expected a run folder"):
        load_policy(tmp_path)
    with pytest.raises(ValueError, match=r"checkpoint: expected last or best, got '\.\./first'"):
        load_policy(run, "../first")


def test_a_policy_that_has_not_learned_yet_is_loaded_with_a_warning(run: Path, tmp_path: Path) -> None:
    world, run = build_world(run_config(run)), Path(shutil.copytree(run, tmp_path / "run"))
    path = run / "checkpoints/last.pt"
    save_checkpoint(path, torch.load(path, weights_only=True) | {"prepared": False})
    with pytest.warns(UserWarning, match=r"last\.pt: the training was stopped before .* as good as untrained"):
        load_policy(run, world=world)
    load_policy(run, "best", world=world)


def test_a_robot_with_other_actions_than_the_policy_is_refused_or_mentioned(run: Path, tmp_path: Path) -> None:
    folder, world = shutil.copytree(run, tmp_path / "run"), build_world(run_config(run))
    path, names = folder / "checkpoints" / "last.pt", list(world.task.motion.action_names)
    state = torch.load(path, weights_only=True)

    def trained_with(actions: object) -> None:
        save_checkpoint(path, {**state, "made_with": {"actions": actions}})

    trained_with(names)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        load_policy(folder, world=world)
    trained_with(["stop", *names[1:]])
    with pytest.warns(match=r"last\.pt were stop, back, .* in training, and now are forward, back, "):
        load_policy(folder, world=world)
    for other, told in (
        (names[1:], "back, "),
        ([[-0.25, -1.5708], [0.5, 1.5708]], r"\[-0.25, -1.57\] to \[0.5, 1.57\]"),
    ):
        trained_with(other)
        with pytest.raises(ValueError, match=rf"^robot, task.motion: expected .*last\.pt, whose actions are {told}"):
            load_policy(folder, world=world)
    trained_with(3)
    with pytest.raises(ValueError, match=r"last\.pt: expected the actions of a policy, got "):
        load_policy(folder, world=world)


def test_limits_of_actions_that_a_file_rounds_are_the_same_limits(tmp_path: Path) -> None:
    half = math.pi / 2
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        check_actions(tmp_path, [[-0.25, -1.5708], [0.5, 1.5708]], [[-0.25, -half], [0.5, half]])
    with pytest.warns(match=r"\[-0.25, -1.57\] to \[0.5, 1.57\] in training, and now are \[-0.25, -1.6\] to"):
        check_actions(tmp_path, [[-0.25, -1.6], [0.5, 1.6]], [[-0.25, -half], [0.5, half]])


def test_the_actions_of_a_policy_are_their_names_or_their_limits() -> None:
    assert actions_of(NavigateMotion(0.5)) == ["stop", "forward", "left", "right"]
    limits = torch.tensor(actions_of(DriveMotion(0.5, linear=(-0.25, 0.5), angular_deg=90.0)))
    torch.testing.assert_close(limits, torch.tensor([[-0.25, -math.pi / 2], [0.5, math.pi / 2]]))


def test_a_damaged_checkpoint_is_refused(run: Path, tmp_path: Path) -> None:
    (tmp_path / "checkpoints").mkdir()
    (tmp_path / "config.yaml").write_bytes((run / "config.yaml").read_bytes())
    (tmp_path / "checkpoints" / "last.pt").write_bytes((run / "checkpoints" / "last.pt").read_bytes()[:1000])
    with pytest.raises(ValueError, match=r"last\.pt"):
        load_policy(tmp_path)


def test_a_checkpoint_of_another_network_is_refused_by_name(run: Path, tmp_path: Path) -> None:
    (tmp_path / "checkpoints").mkdir()
    (tmp_path / "config.yaml").write_bytes((run / "config.yaml").read_bytes())
    path = tmp_path / "checkpoints" / "last.pt"
    for state in ({"ppo": {"model": {"other": torch.zeros(1)}}}, {"ppo": {}}, {"ppo": 3}):
        save_checkpoint(path, state)
        with pytest.raises(ValueError, match=r"last\.pt: expected the weights"):
            load_policy(tmp_path)
