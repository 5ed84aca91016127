"""Envs around envs: what stands at the bottom, and what around it."""

from torchrl.envs import EnvBase, TransformedEnv


def layers(env: EnvBase) -> tuple[EnvBase, list[TransformedEnv]]:
    """The env at the bottom, and those around it from the outermost."""
    around = []
    while isinstance(env, TransformedEnv):
        around.append(env)
        env = env.base_env
    return env, around
