"""The sim2real task: reach an object with a camera held in an unsteady hand."""

from splatrl.envs.tasks.apple import Apple


class Sim2Real(Apple):
    """Walk up to an object while the camera shakes.

    Experiment IV of "Robotic Learning in your Backyard": the trained policy is shown frames of real walks and must name
    the direction in which the person went. Noise on the camera's height, roll and pitch (``PoseNoise``) is enabled.

    Observation, action, reward, termination and state are those of ``Apple``, with steps of 0.05 m, bounds of ±2 m, a
    reach of two steps, and collision enabled.
    Truncation: after 100 steps.

    In the published code the object is a red item in the captured scene, detected by a mean red channel above 0.6
    (``mean_red=0.6``), and collision is off (``collision=none``). Here the object is the apple, so any scene will do.

    Example:
        >>> import splatrl
        >>> env = splatrl.make_env(["task=sim2real"], batch_size=[2])
        >>> bool(env.reset()["camera_offset"].any())
        True
    """
