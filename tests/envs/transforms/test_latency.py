"""Latency: delayed views and actions."""

from typing import Any

import pytest
import torch
from tensordict import TensorDict
from torch.utils._python_dispatch import TorchDispatchMode
from torchrl.envs import Compose, EnvBase, TransformedEnv

from splatrl.building import build_one_world
from splatrl.configuration import load_config
from splatrl.curriculum import Curriculum
from splatrl.envs import SplatEnv
from splatrl.envs.drawing import DepthDrawing, SceneDrawing
from splatrl.envs.sensors import Depth
from splatrl.envs.transforms import FrameSkip, Latency, Weather
from tests.envs.transforms.test_contract import TransformedContract
from tests.envs.transforms.views import renderer, seeing_env
from tests.tiny import BlockChecker, tiny_overrides, tiny_plan, tiny_robot, tiny_task


def late(camera: tuple[int, int], action: tuple[int, int], batch: int = 3, seed: int = 0) -> TransformedEnv:
    return TransformedEnv(seeing_env((batch,), seed), Compose(Latency(camera, action)))


class WholeViews(TorchDispatchMode):
    """Refuses operations that select the bytes of images one by one."""

    def __torch_dispatch__(self, func: Any, types: Any, args: Any = (), kwargs: Any = None) -> Any:
        out = func(*args, **(kwargs or {}))
        one_by_one = func.overloadpacket in (torch.ops.aten.where, torch.ops.aten.index)
        assert not (one_by_one and isinstance(out, torch.Tensor) and out.dtype is torch.uint8 and out.ndim > 2), func
        return out


class TestLatency(TransformedContract):
    def make(self, batch_size: tuple[int], seed: int = 0) -> EnvBase:
        return late((0, 2), (0, 2), batch_size[0], seed)

    def test_a_robot_does_not_depend_on_the_others(self) -> None:
        """A robot's delays are drawn along with the others', so they are given, as is what is still delayed."""
        batch, alone = self.make((5,)), self.make((1,))
        together = batch.rollout(4, break_when_any_done=False)
        known = ("state", "latency", "late_pixels", "late_action", "pixels")
        for row in range(5):
            mine = together[row : row + 1, 3]
            start = alone.reset(mine.select(*known), set_state=True)
            for key in known:
                assert torch.equal(start[key], mine[key]), key
            after = alone.step(start.set("action", mine["action"]))["next"]
            for key in (*known, "reward", "done"):
                assert torch.equal(after[key], mine["next", key]), key

    def test_an_episode_can_begin_at_a_given_state(self) -> None:
        env = self.make((3,))
        given = env.reset().select("state", "pixels").clone()
        again = env.reset(given.select("state"), set_state=True)
        assert torch.equal(again["state"], given["state"]) and torch.equal(again["pixels"], given["pixels"])


@pytest.mark.parametrize("delayed", [False, True])
def test_steps_and_resets_of_some_robots_move_views_as_a_whole(delayed: bool) -> None:
    env = seeing_env((3,), 0)
    env = env.append_transform(Latency((0, 2), (0, 2))) if delayed else env
    td, only = env.reset(), torch.tensor([[True], [False], [True]])
    for given in (False, True):
        with WholeViews():
            td = env.step_mdp(env.step(env.rand_action(td)))
            before = td.clone()
            begun = env.reset(td.set("_reset", only), set_state=given)
        assert begun is td and "_reset" not in td
        kept = [torch.equal(td[key][1], before[key][1]) for key in env.observation_spec.keys(True, True)]
        assert all(kept) and not td["step_count"][only].any()


def test_views_are_those_of_earlier_steps_and_at_first_the_first_view() -> None:
    now, then = seeing_env((3,)), late((2, 2), (0, 0))
    start = now.reset().select("state").clone()
    plain, delayed = now.reset(start.clone(), set_state=True), then.reset(start.clone(), set_state=True)
    seen, late_views = [plain["pixels"]], [delayed["pixels"]]
    for number in range(4):
        action = torch.full((3,), 4 + number % 2)  # they turn, so that each view differs
        plain = now.step(plain.set("action", action.clone()))["next"]
        delayed = then.step(delayed.set("action", action.clone()))["next"]
        assert torch.equal(plain["state"], delayed["state"]) and torch.equal(plain["reward"], delayed["reward"])
        seen.append(plain["pixels"])
        late_views.append(delayed["pixels"])
    for step, view in enumerate(late_views):
        assert torch.equal(view, seen[max(step - 2, 0)]), step
    assert not torch.equal(seen[1], seen[0])


def fogged(camera: tuple[int, int]) -> EnvBase:
    """Make an env with a depth sensor, whose views come late and are in dense fog."""
    robot = tiny_robot()
    drawing = DepthDrawing(SceneDrawing(renderer()), robot.image_height, robot.image_width)
    curriculum = Curriculum(tiny_plan(), None)
    env = SplatEnv(drawing, BlockChecker(), robot, tiny_task(8), curriculum, [3], sensors={"depth": Depth()})
    weather = Weather(fog=2.0, dusk=0.0, sun=0.0, rain=0.0, snow=0.0, wet=0.0, often=1.0)
    return TransformedEnv(env, Compose(Latency(camera, (0, 0)), weather))


def test_depth_and_the_fog_that_depends_on_it_are_as_late_as_the_image() -> None:
    now, then = fogged((0, 0)), fogged((2, 2))
    start = now.reset().select("state", "weather").clone()
    plain, delayed = (env.reset(start.clone(), set_state=True) for env in (now, then))
    on_time = [plain]
    for step in range(1, 5):
        action = torch.full((3,), 4 + step % 2)  # they turn, so that each view differs
        plain, delayed = (
            env.step(td.set("action", action.clone()))["next"] for env, td in ((now, plain), (then, delayed))
        )
        on_time.append(plain)
        for key in ("pixels", "depth"):
            assert torch.equal(delayed[key], on_time[max(step - 2, 0)][key]), (step, key)
    assert not torch.equal(on_time[1]["depth"], on_time[0]["depth"])
    again = then.reset(delayed.clone(), set_state=True)
    for key in ("late_pixels", "late_depth", "late_view_depth", "depth", "pixels"):
        assert torch.equal(again[key], delayed[key]), key


def test_actions_are_those_of_earlier_steps_and_at_first_the_first_action() -> None:
    now, then = seeing_env((3,)), late((0, 0), (2, 2))
    start = now.reset().select("state").clone()
    plain, delayed = now.reset(start.clone(), set_state=True), then.reset(start.clone(), set_state=True)
    chosen = [4, 5, 5, 4, 5]
    carried_out = [4, 4, 4, 5, 5]
    for told, done in zip(chosen, carried_out, strict=True):
        plain = now.step(plain.set("action", torch.full((3,), done)))["next"]
        step = then.step(delayed.set("action", torch.full((3,), told)))
        assert (step["action"] == told).all()  # the policy learns from the action that it chose
        delayed = step["next"]
        assert torch.equal(plain["state"], delayed["state"]) and torch.equal(plain["pixels"], delayed["pixels"])


def test_each_episode_draws_its_own_delays_within_their_ranges() -> None:
    drawn = late((1, 3), (0, 2), 200).reset()["latency"]
    assert set(drawn[:, 0].tolist()) == {1, 2, 3} and set(drawn[:, 1].tolist()) == {0, 1, 2}
    assert len(drawn.unique(dim=0)) == 9


def test_without_delays_nothing_changes() -> None:
    now, then = seeing_env((3,)), late((0, 0), (0, 0))
    start = now.reset().select("state").clone()
    plain, delayed = now.reset(start.clone(), set_state=True), then.reset(start.clone(), set_state=True)
    action = torch.full((3,), 4)
    for key, value in now.step(plain.set("action", action))["next"].items():
        assert torch.equal(then.step(delayed.set("action", action))["next", key], value), key


def test_yaml_adds_latency_to_continuous_actions(tmp_path) -> None:  # type: ignore[no-untyped-def]
    changes = ["transforms/latency=varied", "transforms.latency.action=[1,1]", "transforms.latency.camera=[0,0]"]
    world = build_one_world(load_config([*tiny_overrides(tmp_path, "drive"), *changes]))
    env = world.env(2)
    td = env.reset()
    assert td["late_action"].shape == (2, 1, 2)
    first = env.step(td.set("action", torch.tensor([[0.1, 0.0]] * 2)))
    after = env.step(first["next"].clone().set("action", torch.tensor([[-0.1, 0.5]] * 2)))["next"]
    assert torch.equal(after["late_action"][:, 0], torch.tensor([[-0.1, 0.5]] * 2))
    assert torch.equal(after["state"][:, 2], first["state"][:, 2])  # the turn is still to come


def test_under_frame_skip_delays_count_env_steps() -> None:
    env = TransformedEnv(seeing_env((2,)), Compose(Latency((0, 0), (1, 1)), FrameSkip(2)))
    td = env.reset()
    first = env.step(td.set("action", torch.full((2,), 4)))["next"]
    assert (first["late_action"] == 4).all()
    second = env.step(first.clone().set("action", torch.full((2,), 5)))["next"]
    turned = (second["state"][:, 2] - first["state"][:, 2]) % 8
    assert (turned == 0).all()  # once by the previous action, and once back


@pytest.mark.parametrize(
    ("camera", "action", "message"),
    [
        ((2, 1), (0, 0), r"latency\.camera: expected lowest ≤ highest, got \[2, 1\]"),
        ((0, 0), (0, 65), r"latency\.action: expected .* got 65"),
        ((0,), (0, 0), r"latency\.camera: expected the lowest and the highest delay, got \(0,\)"),
        (2, (0, 0), r"latency\.camera: expected the lowest and the highest delay, got 2"),
    ],
)
def test_invalid_delays_are_refused(camera: Any, action: tuple[int, ...], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        Latency(camera, action)


def test_recorded_views_are_left_alone() -> None:
    frames = TensorDict({"pixels": torch.zeros(2, 4, 4, 3, dtype=torch.uint8)}, [2])
    assert Latency()(frames) is frames
