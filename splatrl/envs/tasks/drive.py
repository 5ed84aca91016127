"""The drive task: steer a mobile robot with continuous control to the pose from which the object is seen."""

from splatrl.envs.tasks.pose_goal import PoseGoal


class Drive(PoseGoal):
    """Reach a goal pose with a differential drive.

    Observation: ``pixels`` [B, H, W, 3] uint8, the ego view.
    Action: [B, 2] float32, linear velocity in metres per second and angular velocity in radians per second, within the
        limits of ``DriveMotion``, held for its time step.
    Reward: [B, 1] float32; −0.2 per step, replaced by +50 at the goal, −10 on a collision, −10 out of bounds.
    Termination: collision, out of bounds or goal, in this order of precedence. The goal is reached if |dx| and |dy| are
        at most the distance that the robot drives in a time step at full speed, and |dyaw| is at most the angle that it
        turns in one. A blocked robot stays where it was.
    Truncation: after ``max_steps`` steps.
    State: [B, 3] float32, x and y in metres and yaw in radians.

    Example:
        >>> import splatrl
        >>> env = splatrl.make_env(["task=drive"], batch_size=[4])
        >>> env.rollout(3, break_when_any_done=False)["action"].shape
        torch.Size([4, 3, 2])
    """
