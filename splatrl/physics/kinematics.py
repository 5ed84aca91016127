"""Batched forward kinematics in PyTorch: the poses of a state's bodies, bitwise the same in any batch.

The sensors of a step see the state before integration, so poses are computed from the state itself, as
``mj_kinematics`` does. All operations are element-wise in double precision, without matrix products, whose order of
summation may depend on the batch.
"""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from splatrl.geometry import multiply_quats, rigid
from splatrl.physics.optional import needed
from splatrl.physics.state_layout import StateLayout


class _Joints(NamedTuple):
    """Joints of one kind, each on a different body of a level."""

    kind: str
    rows: Tensor  # [J] int64, rows among the level's bodies
    first: Tensor  # [J] int64, first columns among the positions
    anchor: Tensor  # [J, 3], in the body's frame
    axis: Tensor  # [J, 3]
    rest: Tensor  # [J], joint positions at which bodies are placed as in their file

    def to(self, device: torch.device) -> "_Joints":
        """Copy to a device."""
        return _Joints(self.kind, *(part.to(device) for part in self[1:]))


class _Level(NamedTuple):
    """Bodies at one depth of the kinematic tree, whose poses follow from those of their parents."""

    bodies: Tensor  # [K] int64
    parents: Tensor  # [K] int64
    place: Tensor  # [M, K, 3], in the parent's frame, for each model; M is 1 if all models agree
    turn: Tensor  # [M, K, 4]
    joints: list[_Joints]  # in the order in which they apply to a body

    def to(self, device: torch.device) -> "_Level":
        """Copy to a device."""
        moved = [part.to(device) for part in (self.bodies, self.parents, self.place, self.turn)]
        return _Level(moved[0], moved[1], moved[2], moved[3], [joints.to(device) for joints in self.joints])


class Kinematics:
    """Computes the poses of bodies from states.

    Args:
        models: an ``MjModel``, or several that differ only in their numbers, such as where bodies without joints are; a
            state says which one it obeys.
        bodies: names of the requested bodies, in order; only these and their ancestors are computed.

    Raises:
        ValueError: for a body that the models lack.
    """

    def __init__(self, models: Any, bodies: Sequence[str]):
        mujoco = needed()
        each: list[Any] = list(models) if isinstance(models, Sequence) else [models]
        model = each[0]
        wanted: list[int] = []
        for name in bodies:
            number = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_BODY, name)
            if number < 0:
                known = [model.body(other).name for other in range(1, model.nbody)]
                raise ValueError(f"body: expected one of {', '.join(known)}, got {name!r}")
            wanted.append(number)
        self.layout, self.count = StateLayout(int(model.nq), int(model.nv)), int(model.nbody)
        self._wanted = torch.tensor(wanted, dtype=torch.int64)
        depth, needed_bodies = {0: 0}, {0}
        for number in wanted:
            while number not in needed_bodies:
                needed_bodies.add(number)
                number = int(model.body_parentid[number])
        for number in range(1, model.nbody):
            depth[number] = depth[int(model.body_parentid[number])] + 1
        levels = []
        for level in range(1, max((depth[number] for number in needed_bodies), default=0) + 1):
            numbers = [number for number in range(1, model.nbody) if depth[number] == level and number in needed_bodies]
            levels.append(self._level(mujoco, each, numbers))
        self._copies = {torch.device("cpu"): levels}

    @staticmethod
    def _level(mujoco: Any, models: list[Any], numbers: list[int]) -> _Level:
        model = models[0]
        kinds = {
            int(mujoco.mjtJoint.mjJNT_FREE): "free",
            int(mujoco.mjtJoint.mjJNT_BALL): "ball",
            int(mujoco.mjtJoint.mjJNT_SLIDE): "slide",
            int(mujoco.mjtJoint.mjJNT_HINGE): "hinge",
        }
        joints = []
        for order in range(max((int(model.body_jntnum[number]) for number in numbers), default=0)):
            for kind in ("free", "ball", "slide", "hinge"):
                chosen = [
                    (row, int(model.body_jntadr[number]) + order)
                    for row, number in enumerate(numbers)
                    if order < model.body_jntnum[number]
                    and kinds[int(model.jnt_type[model.body_jntadr[number] + order])] == kind
                ]
                if chosen:
                    rows, which = (torch.tensor(column) for column in zip(*chosen, strict=True))
                    first = torch.from_numpy(np.asarray(model.jnt_qposadr, np.int64))[which]
                    anchor = torch.from_numpy(model.jnt_pos.copy())[which]
                    axis = torch.from_numpy(model.jnt_axis.copy())[which]
                    rest = torch.from_numpy(model.qpos0.copy())[first]
                    joints.append(_Joints(kind, rows, first, anchor, axis, rest))
        bodies = torch.tensor(numbers, dtype=torch.int64)
        parents = torch.from_numpy(np.asarray(model.body_parentid, np.int64))[bodies]
        place, turn = (
            _of_models([getattr(one, name)[numbers] for one in models]) for name in ("body_pos", "body_quat")
        )
        return _Level(bodies, parents, place, turn, joints)

    def _levels(self, device: torch.device) -> list[_Level]:
        """Return the levels on a device, to which they are copied once."""
        if device not in self._copies:
            self._copies[device] = [level.to(device) for level in self._copies[torch.device("cpu")]]
        return self._copies[device]

    def __call__(self, state: Tensor) -> tuple[Tensor, Tensor]:
        """Return positions and orientations of the requested bodies.

        Args:
            state: [B, n] float64, in the layout of ``Physics``.

        Returns:
            [B, N, 3] float64 metres and [B, N, 4] float64 unit quaternions wxyz, world frame.
        """
        qpos = state[:, self.layout.positions]
        place = qpos.new_zeros(len(qpos), self.count, 3)
        turn = qpos.new_zeros(len(qpos), self.count, 4)
        turn[:, 0, 0] = 1.0
        for level in self._levels(state.device):
            above = turn[:, level.parents]
            x = place[:, level.parents] + rotated(above, self._of_rows(level.place, state))
            q = multiply_quats(above, self._of_rows(level.turn, state))
            for joints in level.joints:
                x[:, joints.rows], q[:, joints.rows] = _jointed(joints, qpos, x[:, joints.rows], q[:, joints.rows])
            place[:, level.bodies], turn[:, level.bodies] = x, normalised(q)
        wanted = self._wanted.to(state.device)
        return place[:, wanted], turn[:, wanted]

    def _of_rows(self, values: Tensor, state: Tensor) -> Tensor:
        """Return the values of the models that states obey: [M, K, 3] -> [B, K, 3], or [1, K, 3] if all agree."""
        return values if len(values) == 1 else values[self.layout.model_of(state, len(values))]

    def poses(self, state: Tensor) -> Tensor:
        """Return ``body_to_world`` of the requested bodies: [B, n] float64 -> [B, N, 4, 4] float32."""
        return self.as_poses(*self(state))

    @staticmethod
    def as_poses(place: Tensor, turn: Tensor) -> Tensor:
        """Convert positions [..., 3] and unit quaternions [..., 4] to poses [..., 4, 4] float32."""
        return rigid(matrices(turn), place).float()


def _of_models(values: list[NDArray[np.float64]]) -> Tensor:
    """Stack the values of models, [K, n] each, or keep one of them if all agree: [M, K, n]."""
    stacked = np.stack(values)
    return torch.from_numpy(stacked[:1] if (stacked == stacked[:1]).all() else stacked)


def _jointed(joints: _Joints, qpos: Tensor, x: Tensor, q: Tensor) -> tuple[Tensor, Tensor]:
    """Apply joints to positions and orientations of their bodies: [B, J, 3], [B, J, 4]."""
    kind, _, first, anchor, axis, rest = joints
    if kind == "free":
        place = torch.stack([qpos[:, first + i] for i in range(3)], -1)
        return place, normalised(torch.stack([qpos[:, first + 3 + i] for i in range(4)], -1))
    if kind == "slide":
        return x + rotated(q, axis) * (qpos[:, first] - rest).unsqueeze(-1), q
    hinge_at = x + rotated(q, anchor)
    if kind == "ball":
        turn = normalised(torch.stack([qpos[:, first + i] for i in range(4)], -1))
    else:
        half = 0.5 * (qpos[:, first] - rest)
        turn = torch.cat([half.cos().unsqueeze(-1), axis * half.sin().unsqueeze(-1)], -1)
    q = multiply_quats(q, turn)
    return hinge_at - rotated(q, anchor), q


def normalised(quats: Tensor) -> Tensor:
    """Scale quaternions [..., 4] to unit length."""
    w, x, y, z = quats.unbind(-1)
    return quats / (w * w + x * x + y * y + z * z).sqrt().unsqueeze(-1)


def turned_back(quats: Tensor) -> Tensor:
    """Return the inverses of unit quaternions: [..., 4] -> [..., 4]."""
    return quats * quats.new_tensor([1.0, -1.0, -1.0, -1.0])


def rotated(quats: Tensor, vectors: Tensor) -> Tensor:
    """Rotate vectors [..., 3] by unit quaternions [..., 4], with broadcasting."""
    w, x, y, z = quats.unbind(-1)
    a, b, c = vectors.unbind(-1)
    s, t, u = 2 * (y * c - z * b), 2 * (z * a - x * c), 2 * (x * b - y * a)
    return torch.stack([a + w * s + y * u - z * t, b + w * t + z * s - x * u, c + w * u + x * t - y * s], -1)


def matrices(quats: Tensor) -> Tensor:
    """Return the rotation matrices of unit quaternions: [..., 4] -> [..., 3, 3]."""
    eye = torch.eye(3, dtype=quats.dtype, device=quats.device)
    return torch.stack([rotated(quats, eye[axis]) for axis in range(3)], -1)
