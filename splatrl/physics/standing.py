"""How a model of MJCF stands before anything moves."""

from typing import Any

from splatrl.physics.optional import needed


def at_home(model: Any) -> Any:
    """The ``MjData`` of a model at its first keyframe, or as its bodies are written down, with poses computed."""
    mujoco = needed()
    data = mujoco.MjData(model)
    if model.nkey:
        mujoco.mj_resetDataKeyframe(model, data, 0)
    mujoco.mj_kinematics(model, data)
    return data


def top_of(model: Any) -> float:
    """How high a model reaches where it stands, metres: at most the top of the spheres around its geoms."""
    data = at_home(model)
    return max((float(data.geom_xpos[geom, 2] + model.geom_rbound[geom]) for geom in range(model.ngeom)), default=0.0)
