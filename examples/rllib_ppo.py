"""PPO with RLlib on single-robot envs: pip install 'ray[rllib]' && python examples/rllib_ppo.py --iterations 50

RLlib makes its own copies of an env, so each worker holds a scene; one batch in one process is faster.
"""

import argparse

import gymnasium
import ray
from ray.rllib.algorithms.ppo import PPOConfig
from ray.rllib.core.rl_module.default_model_config import DefaultModelConfig
from ray.tune.registry import register_env

CONVOLUTIONS = [[16, 8, 4], [32, 3, 2]]
"""Channels, kernel size and stride of each layer."""


def make(settings: dict[str, object]) -> gymnasium.Env:
    """Make an env with one robot, whose pixels are floats in [0, 1]."""
    env = gymnasium.make("splatrl:splatrl/Grid-v0", **settings)
    space = gymnasium.spaces.Box(0.0, 1.0, env.observation_space.shape, "float32")
    return gymnasium.wrappers.TransformObservation(env, lambda view: (view / 255).astype("float32"), space)


def main() -> None:
    """Train, and print the mean return."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--iterations", type=int, default=50)
    parser.add_argument("--runners", type=int, default=1, help="worker processes; 0 collects in this process")
    parser.add_argument("--batch", type=int, default=1024, help="frames per iteration")
    options = parser.parse_args()
    ray.init(include_dashboard=False)
    register_env("splatrl", make)
    config = (
        PPOConfig()
        .environment("splatrl", env_config={"scene": "backyard"})
        .env_runners(num_env_runners=options.runners, num_envs_per_env_runner=4)
        .training(train_batch_size_per_learner=options.batch, minibatch_size=128, gamma=0.97, lr=1e-3)
        .rl_module(model_config=DefaultModelConfig(conv_filters=CONVOLUTIONS, head_fcnet_hiddens=[128]))
    )
    algorithm = config.build_algo()
    for iteration in range(options.iterations):
        found = algorithm.train()["env_runners"]
        print(f"{iteration + 1}: mean return {found.get('episode_return_mean', float('nan')):.2f}")
    algorithm.stop()
    ray.shutdown()


if __name__ == "__main__":
    main()
