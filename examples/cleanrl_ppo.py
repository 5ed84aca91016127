"""PPO in one file, in the style of CleanRL, on Gymnasium's vector env: python examples/cleanrl_ppo.py --frames 60000

All robots form one batch in one scene. A robot whose episode ends starts the next one in the same step.
"""

import argparse
import math

import gymnasium
import numpy as np
import torch
from torch import Tensor, nn
from torch.distributions import Categorical

import splatrl  # registers the tasks

GAMMA, LAMBDA, CLIP, ENTROPY, EPOCHS, MINIBATCH, SCALE = 0.97, 0.9, 0.2, 0.01, 10, 128, 0.1


class Agent(nn.Module):
    """An actor and a critic over one convolutional trunk."""

    def __init__(self, actions: int):
        super().__init__()
        layers = [nn.AvgPool2d(2), nn.Conv2d(3, 16, 8, 4), nn.ReLU(), nn.Conv2d(16, 32, 3), nn.ReLU(), nn.Flatten()]
        self.trunk = nn.Sequential(*layers, nn.LazyLinear(128), nn.ReLU())
        self.actor, self.critic = nn.Linear(128, actions), nn.Linear(128, 1)
        nn.init.orthogonal_(self.actor.weight, 0.01)

    def forward(self, pixels: Tensor) -> tuple[Categorical, Tensor]:
        """Return the action distribution and the value for views [B, H, W, 3] uint8."""
        features = self.trunk(pixels.permute(0, 3, 1, 2).float() / 255)
        return Categorical(logits=self.actor(features)), self.critic(features).squeeze(1)


def main() -> None:
    """Train, and print the success rate of the last hundred episodes."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--task", default="splatrl/Grid-v0")
    parser.add_argument("--robots", type=int, default=32)
    parser.add_argument("--steps", type=int, default=32, help="steps per robot between updates")
    parser.add_argument("--frames", type=int, default=60_000, help="rounded up to whole updates")
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    torch.manual_seed(options.seed)
    envs = gymnasium.make_vec(options.task, num_envs=options.robots)
    agent = Agent(int(envs.single_action_space.n))
    ended: list[bool] = []
    seen = torch.from_numpy(envs.reset(seed=options.seed)[0])
    agent(seen)  # gives the lazy layer its size
    optimizer = torch.optim.Adam(agent.parameters(), lr=1e-3, eps=1e-5)
    for update in range(math.ceil(options.frames / (options.robots * options.steps))):
        shape = (options.steps, options.robots)
        views = torch.zeros(shape + seen.shape[1:], dtype=torch.uint8)
        actions, chances, values, rewards, dones = (torch.zeros(shape) for _ in range(5))
        for step in range(options.steps):
            with torch.no_grad():
                policy, value = agent(seen)
            action = policy.sample()
            views[step], actions[step], chances[step], values[step] = seen, action, policy.log_prob(action), value
            now, reward, terminated, truncated, info = envs.step(action.numpy())
            done = terminated | truncated
            rewards[step], dones[step] = torch.from_numpy(SCALE * reward), torch.from_numpy(done).float()
            if done.any():
                ended += info["final_info"]["success"][done].astype(bool).tolist()
            seen = torch.from_numpy(now)
        with torch.no_grad():
            following = agent(seen)[1]
        advantages, later = torch.zeros(shape), torch.zeros(options.robots)
        for step in reversed(range(options.steps)):  # generalised advantage estimation
            going = 1 - dones[step]
            surprise = rewards[step] + GAMMA * going * following - values[step]
            advantages[step] = later = surprise + GAMMA * LAMBDA * going * later
            following = values[step]
        batch = [part.flatten(0, 1) for part in (views, actions, chances, advantages, advantages + values)]
        for _ in range(EPOCHS):
            for rows in torch.randperm(len(batch[0])).split(MINIBATCH):
                view, action, chance, advantage, target = (part[rows] for part in batch)
                policy, value = agent(view)
                ratio = (policy.log_prob(action) - chance).exp()
                advantage = (advantage - advantage.mean()) / (advantage.std() + 1e-8)
                gain = torch.min(ratio * advantage, ratio.clamp(1 - CLIP, 1 + CLIP) * advantage).mean()
                loss = -gain + 0.5 * (value - target).square().mean() - ENTROPY * policy.entropy().mean()
                optimizer.zero_grad()
                loss.backward()
                nn.utils.clip_grad_norm_(agent.parameters(), 0.5)
                optimizer.step()
        frames = (update + 1) * options.robots * options.steps
        print(
            f"{frames:,} frames, success {np.mean(ended[-100:] or [0]):.2f} over the last {len(ended[-100:])} episodes"
        )
    envs.close()


if __name__ == "__main__":
    assert splatrl
    main()
