"""The sim2real task: reach an object with a camera in an unsteady hand."""

from splatrl.envs.tasks.apple import Apple


class Sim2Real(Apple):
    """Walk up to an object while the camera shakes.

    Experiment IV of "Robotic Learning in your Backyard": the trained policy is shown frames of real walks and must name
    the direction that the person took. Noise on the camera's height, roll and pitch (``PoseNoise``) is on.

    Observation, action, reward, termination and state are those of ``Apple``, with steps of 0.05 m in bounds of ±2 m,
    a reach of two steps, and collision.
    Truncation: after 100 steps.

    In the published code the object is a red thing in the captured scene, found by a mean red channel above 0.6
    (``mean_red=0.6``), and collision is off (``collision=none``). Here it is the apple, so that any scene will do.

    Example:
        >>> import splatrl
        >>> env = splatrl.make_env(["task=sim2real"], batch_size=[2])
        >>> bool(env.reset()["camera_offset"].any())
        True
    """
