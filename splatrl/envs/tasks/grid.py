"""The grid task: walk on a lattice to the pose from which the object is seen."""

from splatrl.envs.tasks.pose_goal import PoseGoal


class Grid(PoseGoal):
    """Reach a goal pose by steps along the world's axes and turns on the spot.

    The task of "Robotic Learning in your Backyard", with its actions and rewards.

    Observation: ``pixels`` [B, H, W, 3] uint8, the ego view.
    Action: [B] int64, one of +x, −x, +y, −y, +spin, −spin (``LatticeMotion``).
    Reward: [B, 1] float32; −0.2 per step, replaced by +50 at the goal, −10 on a collision, −10 out of bounds.
    Termination: collision, out of bounds or goal, in this order of precedence. The goal is reached if |dx| ≤ one step,
        |dy| ≤ one step and |dyaw| ≤ one angle step, each judged separately. A blocked robot stays at its previous
        lattice pose.
    Truncation: after ``max_steps`` steps.
    State: [B, 3] int64, lattice indices of x, y and heading.

    The published code lets a robot at the edge move outwards, but only once, and compares Euler angles without wrapping
    them; here the bounds are inclusive and angles wrap.

    Example:
        >>> import splatrl
        >>> env = splatrl.make_env(["task=grid"], batch_size=[4])
        >>> env.rollout(3, break_when_any_done=False)["next", "reward"].shape
        torch.Size([4, 3, 1])
    """
