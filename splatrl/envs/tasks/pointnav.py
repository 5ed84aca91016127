"""The pointnav task: go to a goal that is given by its distance and direction."""

from splatrl.envs.tasks.navigation import NavigationTask


class PointNav(NavigationTask):
    """Point-goal navigation (Anderson et al. 2018): the goal is given by its distance and direction.

    Observation: ``pointgoal_with_gps_compass`` [B, 2] float32, rho in metres and phi in radians, and whatever else
        ``sensors`` returns. A stop within 0.2 m is a success, as in the Habitat Challenge of 2019.
    Everything else: see ``NavigationTask``.

    Example:
        >>> import splatrl
        >>> env = splatrl.make_env(["task=pointnav"], batch_size=[4])
        >>> env.rollout(3, break_when_any_done=False)["pointgoal_with_gps_compass"].shape
        torch.Size([4, 3, 2])
    """
