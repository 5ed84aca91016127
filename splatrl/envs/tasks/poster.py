"""The poster task: the fps task with the published example's goal format, for any indoor scene."""

from collections.abc import Sequence

from splatrl.envs.tasks.fps import Fps
from splatrl.envs.tasks.rewards import PUBLISHED, Rewards
from splatrl.motions import ForwardMotion
from splatrl.values import are_numbers


class Poster(Fps):
    """Walk to the pose in front of a poster; an ``Fps`` task whose goal is written as six numbers.

    The published example gives the goal as x, y, z, roll, pitch and yaw of an OpenGL camera, which looks along +y when
    its yaw is 0 and is level when its roll is 90°. Hence the robot's yaw is the published one plus 90°. z and roll only
    restate the robot's height and its level camera, and pitch is ignored, too; all six are accepted so that the
    example's line can be pasted.

    Observation, action, reward, termination, truncation and state are those of ``Fps``.

    Example:
        >>> import splatrl
        >>> env = splatrl.make_env(["task=poster"], batch_size=[2])
        >>> env.task.goal.shape
        torch.Size([3])

    Args:
        motion: how the robots move, as for ``Fps``.
        goal: x, y, z in metres and roll, pitch, yaw in degrees, as published.
        rewards: reward of each outcome.
        max_steps: an episode is truncated after this many steps.

    Raises:
        ValueError: for a goal that is not six finite numbers.
    """

    def __init__(
        self, motion: ForwardMotion, goal: Sequence[float], rewards: Rewards = PUBLISHED, max_steps: int = 200
    ):
        if not are_numbers(goal, 6):
            raise ValueError(f"task.goal: expected finite x, y, z (metres), roll, pitch and yaw (degrees), got {goal}")
        x, y, _, _, _, yaw_deg = goal
        super().__init__(motion, [x, y, yaw_deg + 90.0], rewards, max_steps)
