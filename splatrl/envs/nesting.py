"""Nested envs: the base env and the transformed envs around it."""

from torchrl.envs import EnvBase, FrameSkipTransform, Transform, TransformedEnv


def layers(env: EnvBase) -> tuple[EnvBase, list[TransformedEnv]]:
    """The base env, and the transformed envs around it, the outermost first."""
    around = []
    while isinstance(env, TransformedEnv):
        around.append(env)
        env = env.base_env
    return env, around


def check_layers(env: EnvBase) -> None:
    """Refuse an env under a transform with which it does not work; see ``refuse_frame_skip``."""
    for around in layers(env)[1]:
        refuse_frame_skip(around.transform)


def refuse_frame_skip(transform: Transform) -> None:
    """Refuse TorchRL's frame skip, which steps again from the state before the step.

    Raises:
        ValueError: names the transform that takes its place.
    """
    if any(isinstance(part, FrameSkipTransform) for part in transform.modules()):
        raise ValueError(
            "FrameSkipTransform: expected splatrl.envs.transforms.FrameSkip in its place, since TorchRL's repeats the "
            "same step in an env that keeps its state in the TensorDict"
        )
