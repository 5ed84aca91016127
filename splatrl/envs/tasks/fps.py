"""The fps task: walk and turn, as in a first-person game, to the pose from which the object is seen."""

from splatrl.envs.tasks.pose_goal import PoseGoal


class Fps(PoseGoal):
    """Reach a goal pose by steps along the heading and turns on the spot, not bound to a lattice.

    Experiment II of "Robotic Learning in your Backyard", with its actions and rewards.

    Observation: ``pixels`` [B, H, W, 3] uint8, the ego view.
    Action: [B] int64, one of forward, back, left, right (``ForwardMotion``: 0.1 m, 10°).
    Reward: [B, 1] float32; −0.2 per step, replaced by +50 at the goal, −10 on a collision, −10 out of bounds.
    Termination: collision, out of bounds or goal, in this order of precedence. The goal is reached if |dx| ≤ one step,
        |dy| ≤ one step and |dyaw| ≤ one angle step, each judged separately. A blocked robot stays where it was.
    Truncation: after ``max_steps`` steps.
    State: [B, 3] float32, x and y in metres and yaw in radians.

    The body is the 0.01 m cube of the publication. The published code drops only the component of a step that would
    leave the bounds along one axis; here such a step ends the episode.

    Example:
        >>> import splatrl
        >>> env = splatrl.make_env(["task=fps"], batch_size=[4])
        >>> env.rollout(3, break_when_any_done=False)["next", "reward"].shape
        torch.Size([4, 3, 1])
    """
