"""Envs under transforms fulfil the contract of an env."""

import torch
from torchrl.envs import EnvBase

from tests.envs.contract import EnvContract
from tests.envs.transforms.views import transformed


class TransformedContract(EnvContract):
    """The env contract under transforms: ``TransformedEnv.state_dict`` holds only theirs, so the env's is saved too."""

    steps = 16

    def test_a_robot_that_begins_anew_takes_nothing_over_from_its_last_episode(self) -> None:
        mask, begun = torch.tensor([[True], [False], [True]]), []
        for hands_over in (True, False):
            env = self.make((3,))
            torch.manual_seed(0)
            last = env.step_mdp(env.rollout(4, break_when_any_done=False)[:, -1].clone())
            last = last.exclude("camera_offset") if hands_over else last.empty()  # ``PoseNoise`` keeps a given one
            begun.append(env.reset(last.set("_reset", mask), set_state=False)[mask.flatten()])
        for key in env.observation_spec.keys(True, True):
            assert torch.equal(begun[0][key], begun[1][key]), key


class TestAllTransforms(TransformedContract):
    """An observation depends on ``camera_offset`` and ``appearance``, and on what the step draws."""

    def make(self, batch_size: tuple[int], seed: int = 0) -> EnvBase:
        return transformed(batch_size, seed)

    def test_an_episode_can_begin_at_a_given_state(self) -> None:
        env = transformed((3,), 0, ("PoseNoise",))
        given = env.reset().select("state", "pixels", "camera_offset").clone()
        env.rollout(4, break_when_any_done=False)
        again = env.reset(given.select("state", "camera_offset"), set_state=True)
        for key in ("state", "pixels", "camera_offset"):
            assert torch.equal(again[key], given[key]), key
        elsewhere = env.reset(given.select("state"), set_state=True)
        assert torch.equal(elsewhere["state"], given["state"])
        assert not torch.equal(elsewhere["camera_offset"], given["camera_offset"])
        assert not torch.equal(elsewhere["pixels"], given["pixels"])

    def test_a_robot_does_not_depend_on_the_others(self) -> None:
        """The random draws of a robot do depend on the others, so they are given."""
        batch, alone = (transformed((count,), 0, ("PoseNoise",)) for count in (5, 1))
        together = batch.reset()
        for row in range(5):
            start = alone.reset(together[row : row + 1].select("state", "camera_offset"), set_state=True)
            for key in ("pixels", "sprite_share"):
                assert torch.equal(start[key], together[key][row : row + 1]), key
