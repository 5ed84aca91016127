"""Rigid transforms, rotations and the geometric conventions that all of splatrl follows.

World frame: right-handed, z up, metres.
Camera frame: OpenCV axes, x right, y down, z forward; a camera's pose is ``camera_to_world``.
Body frame: x forward, y left, z up; a robot's pose is ``body_to_world``.
Pixels: the pixel in column i and row j has its centre at (i + 0.5, j + 0.5).
Yaw: about world +z, counter-clockwise, 0 along +x. Angles are in radians.
Quaternions: wxyz, of unit length from the file readers onwards.
A transform is named ``<from>_to_<to>`` and maps column vectors: ``p_world = body_to_world @ p_body``.
"""

import math

import torch
from torch import Tensor

CAMERA_TO_BODY = torch.tensor(
    [[0.0, 0.0, 1.0, 0.0], [-1.0, 0.0, 0.0, 0.0], [0.0, -1.0, 0.0, 0.0], [0.0, 0.0, 0.0, 1.0]], dtype=torch.float32
)
"""[4, 4] float32: pose of a camera at the body's origin that looks along the body's +x."""
ORTHONORMAL = 1e-3
"""Tolerance, per element, for R Rᵀ to differ from the identity in a rigid transform."""


def rigid(rotation: Tensor, translation: Tensor) -> Tensor:
    """Build 4×4 transforms from rotations and translations.

    Args:
        rotation: [..., 3, 3].
        translation: [..., 3].

    Returns:
        [..., 4, 4], same dtype and device as ``rotation``.
    """
    shape, other = rotation.shape[:-2], translation.shape[:-1]
    if shape != other:
        shape = torch.broadcast_shapes(shape, other)  # slow, so only if needed
    transform = rotation.new_zeros(*shape, 4, 4)
    transform[..., :3, :3] = rotation
    transform[..., :3, 3] = translation
    transform[..., 3, 3] = 1.0
    return transform


def invert_rigid(transform: Tensor) -> Tensor:
    """Invert rigid transforms exactly by transposing the rotation.

    Args:
        transform: [..., 4, 4], rotation orthonormal.

    Returns:
        [..., 4, 4].
    """
    rotation = transform[..., :3, :3].transpose(-1, -2)
    return rigid(rotation, -(rotation @ transform[..., :3, 3:]).squeeze(-1))


def first_not_rigid(transforms: Tensor) -> tuple[int, str] | None:
    """Find the first transform that is not rigid.

    Args:
        transforms: [N, 4, 4].

    Returns:
        Its row and what was expected of it; None if all are rigid.
    """
    rotation = transforms[:, :3, :3]
    error = (rotation @ rotation.mT - torch.eye(3).to(rotation)).abs().amax((1, 2))
    volume = (torch.linalg.cross(rotation[:, 0], rotation[:, 1]) * rotation[:, 2]).sum(1)
    bottom = (transforms[:, 3] - torch.tensor([0.0, 0.0, 0.0, 1.0]).to(rotation)).abs().amax(1)
    faults = {
        "finite numbers": ~transforms.isfinite().flatten(1).all(1),
        "an orthonormal rotation": ~(error <= ORTHONORMAL),
        "a rotation, not a reflection": ~(volume > 0),
        "a bottom row of 0, 0, 0, 1": ~(bottom <= ORTHONORMAL),
    }
    bad = torch.stack(list(faults.values()))
    if not bad.any():
        return None
    row = int(bad.any(0).int().argmax())
    return row, list(faults)[int(bad[:, row].int().argmax())]


def quats_to_rotations(quats: Tensor) -> Tensor:
    """Turn wxyz quaternions of any non-zero length into rotation matrices.

    Args:
        quats: [..., 4].

    Returns:
        [..., 3, 3].
    """
    w, x, y, z = torch.nn.functional.normalize(quats, dim=-1).unbind(-1)
    rows = [
        1 - 2 * (y * y + z * z),
        2 * (x * y - w * z),
        2 * (x * z + w * y),
        2 * (x * y + w * z),
        1 - 2 * (x * x + z * z),
        2 * (y * z - w * x),
        2 * (x * z - w * y),
        2 * (y * z + w * x),
        1 - 2 * (x * x + y * y),
    ]
    return torch.stack(rows, -1).unflatten(-1, (3, 3))


def yaw_quat(yaw: float) -> tuple[float, float, float, float]:
    """Return the unit wxyz quaternion of a yaw, radians."""
    return math.cos(0.5 * yaw), 0.0, 0.0, math.sin(0.5 * yaw)


def multiply_quats(a: Tensor, b: Tensor) -> Tensor:
    """Multiply wxyz quaternions (Hamilton product): rotate by ``b`` first, then by ``a``.

    Args:
        a: [..., 4].
        b: [..., 4], broadcast against ``a``.

    Returns:
        [..., 4].
    """
    aw, ax, ay, az = a.unbind(-1)
    bw, bx, by, bz = b.unbind(-1)
    return torch.stack(
        [
            aw * bw - ax * bx - ay * by - az * bz,
            aw * bx + ax * bw + ay * bz - az * by,
            aw * by - ax * bz + ay * bw + az * bx,
            aw * bz + ax * by - ay * bx + az * bw,
        ],
        -1,
    )


def rotations_to_quats(rotations: Tensor) -> Tensor:
    """Turn rotation matrices into unit wxyz quaternions with w ≥ 0.

    The other components are computed from the largest one, so no rotation loses precision (Shepperd's method).

    Args:
        rotations: [..., 3, 3], orthonormal.

    Returns:
        [..., 4].
    """
    m = rotations
    xx, yy, zz = m[..., 0, 0], m[..., 1, 1], m[..., 2, 2]
    squares = torch.stack([1 + xx + yy + zz, 1 + xx - yy - zz, 1 - xx + yy - zz, 1 - xx - yy + zz], -1)  # 4 q_i²
    wx, wy, wz = m[..., 2, 1] - m[..., 1, 2], m[..., 0, 2] - m[..., 2, 0], m[..., 1, 0] - m[..., 0, 1]
    xy, xz, yz = m[..., 0, 1] + m[..., 1, 0], m[..., 0, 2] + m[..., 2, 0], m[..., 1, 2] + m[..., 2, 1]
    products = torch.stack(  # 4 q_i q_j, row i
        [
            torch.stack([squares[..., 0], wx, wy, wz], -1),
            torch.stack([wx, squares[..., 1], xy, xz], -1),
            torch.stack([wy, xy, squares[..., 2], yz], -1),
            torch.stack([wz, xz, yz, squares[..., 3]], -1),
        ],
        -2,
    )
    largest = squares.argmax(-1)[..., None, None].expand(*squares.shape[:-1], 1, 4)
    quats = torch.nn.functional.normalize(products.gather(-2, largest).squeeze(-2), dim=-1)
    return torch.where(quats[..., :1] < 0, -quats, quats)


def planar_of(body_to_world: Tensor) -> Tensor:
    """Return position and heading of poses.

    Args:
        body_to_world: [N, 4, 4].

    Returns:
        [N, 3] float64, x and y in metres, and the yaw of the body's x axis in radians in [-π, π].
    """
    x_axis, place = body_to_world[:, :2, 0], body_to_world[:, :2, 3]
    return torch.cat([place, azimuths(x_axis).unsqueeze(1)], 1).double()


def quat_yaws(quats: Tensor) -> Tensor:
    """Return the yaws of the x axes that unit wxyz quaternions turn: [..., 4] -> [...] radians in [-π, π]."""
    w, x, y, z = quats.unbind(-1)
    return atan2(2 * (w * z + x * y), w * w + x * x - y * y - z * z)


def atan2(y: Tensor, x: Tensor) -> Tensor:
    """Return the angles from the x axis to points, [...] radians in [-π, π], with the same bytes in any batch.

    On a CPU, ``torch.atan2`` rounds differently in the last few elements of a tensor, which are not vectorised;
    ``torch.atan`` does not. The angle of the origin is 0.
    """
    steep = y.abs() > x.abs()
    ratio = torch.where(steep, x, y) / torch.where(steep, y, x)
    angle = torch.where((x == 0) & (y == 0), 0.0, ratio).atan()
    half, whole = (torch.full_like(angle, turn).copysign(y) for turn in (0.5 * math.pi, math.pi))
    return torch.where(steep, half - angle, torch.where(x < 0, whole + angle, angle))


def wrapped(angles: Tensor) -> Tensor:
    """Wrap angles, radians, to [-π, π]: [...] -> [...]."""
    return (angles - math.tau * (angles / math.tau).round()).clamp(-math.pi, math.pi)


def azimuths(vectors: Tensor) -> Tensor:
    """Return the directions of vectors seen from above, as a yaw: [..., 2 or 3] -> [...] radians in [-π, π]."""
    return atan2(vectors[..., 1], vectors[..., 0])


def along_heading(vectors: Tensor, yaw: Tensor) -> Tensor:
    """Express horizontal vectors by their parts ahead and to the left of headings.

    Args:
        vectors: [..., 2], x and y, world.
        yaw: [...] headings, radians.

    Returns:
        [..., 2].
    """
    x, y = vectors.unbind(-1)
    cos, sin = yaw.cos(), yaw.sin()
    return torch.stack([x * cos + y * sin, y * cos - x * sin], -1)


def axis_rotations(axis: int, angles: Tensor) -> Tensor:
    """Return right-handed rotations about one coordinate axis.

    Args:
        axis: 0, 1 or 2 for x, y or z.
        angles: [...] radians.

    Returns:
        [..., 3, 3].
    """
    cos, sin = angles.cos(), angles.sin()
    rotations = torch.zeros(*angles.shape, 3, 3, dtype=angles.dtype, device=angles.device)
    i, j = (axis + 1) % 3, (axis + 2) % 3
    rotations[..., axis, axis] = 1.0
    rotations[..., i, i], rotations[..., i, j] = cos, -sin
    rotations[..., j, i], rotations[..., j, j] = sin, cos
    return rotations
