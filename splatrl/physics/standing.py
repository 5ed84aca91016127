"""The initial pose of an MJCF model, before anything moves."""

from typing import Any

from splatrl.physics.optional import needed


def at_home(model: Any) -> Any:
    """Return the ``MjData`` of a model at its first keyframe, or else in its default pose, with poses computed."""
    mujoco = needed()
    data = mujoco.MjData(model)
    if model.nkey:
        mujoco.mj_resetDataKeyframe(model, data, 0)
    mujoco.mj_kinematics(model, data)
    return data


def top_of(model: Any) -> float:
    """Return an upper bound on how high a standing model reaches, metres: the top of its geoms' bounding spheres."""
    data = at_home(model)
    return max((float(data.geom_xpos[geom, 2] + model.geom_rbound[geom]) for geom in range(model.ngeom)), default=0.0)
