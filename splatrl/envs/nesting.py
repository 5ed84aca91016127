"""Nested envs: the base env and the transformed envs around it."""

from torchrl.envs import EnvBase, TransformedEnv


def layers(env: EnvBase) -> tuple[EnvBase, list[TransformedEnv]]:
    """The base env, and the transformed envs around it, the outermost first."""
    around = []
    while isinstance(env, TransformedEnv):
        around.append(env)
        env = env.base_env
    return env, around
