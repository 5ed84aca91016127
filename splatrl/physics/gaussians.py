"""Converts the look of MuJoCo models to Gaussians: small discs on the surfaces of visible geoms."""

import math
from typing import Any, NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray

from splatrl.geometry import rotations_to_quats
from splatrl.physics.optional import needed
from splatrl.scenes.gaussians import Gaussians
from splatrl.spherical_harmonics import C0
from splatrl.values import require_number

SHOWN_GROUPS = 3
"""Geoms in groups below this one are visible, as in MuJoCo's viewer; the others are for collisions."""
OPACITY = 0.97
SPREAD = 0.45
"""Standard deviation of a disc along the surface, as a fraction of the distance between discs."""
THICKNESS = 0.001
"""Standard deviation of a disc across the surface, metres."""
LEAST = 12
"""Minimum number of discs per geom."""
CANDIDATES = 8
"""Candidate points per disc, from which the positions are chosen."""
AROUND = 32
"""Number of sides that approximate a round shape."""

Array = NDArray[np.float64]


class BodyGaussians(NamedTuple):
    """The Gaussians that show a body.

    Attributes:
        body: name of the body in the model.
        gaussians: Gaussians in the body's own frame, metres.
    """

    body: str
    gaussians: Gaussians


class Models(tuple[Gaussians, ...]):
    """Gaussians that renderers draw and nothing modifies, so that copies of their owner can share them."""

    def __deepcopy__(self, memo: dict[int, Any]) -> "Models":
        return self


class _Surface(NamedTuple):
    """Triangles of a surface: corners [F, 3, 3] in metres, and texture coordinates [F, 3, 2] if it has any."""

    corners: Array
    uv: Array | None = None


def gaussians_from_mjcf(model: Any, prefix: str = "", count: int = 800) -> list[BodyGaussians]:
    """Sample the visible geoms of a model into Gaussians, one set for each moving body.

    A body without joints belongs to the one that carries it. Colours are those of the geom, its material and its
    texture; a flat texture on anything but a mesh contributes its mean colour. Planes are not drawn, because the ground
    comes from the scene.

    Args:
        model: an ``MjModel``.
        prefix: prefix of the names of the bodies to sample.
        count: number of Gaussians per body, allotted to its geoms by area.

    Raises:
        ValueError: for a count out of range.
    """
    require_number("count", count, 1, 10**6, whole=True)
    mujoco = needed()
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    found: dict[int, list[Any]] = {}
    for number in range(1, model.nbody):
        if not model.body(number).name.startswith(prefix):
            continue
        root = int(model.body_weldid[number]) or number
        first, many = int(model.body_geomadr[number]), int(model.body_geomnum[number])
        geoms = range(first, first + many)
        shown = [geom for geom in geoms if model.geom_group[geom] < SHOWN_GROUPS and _rgba(model, geom)[3] > 0]
        found.setdefault(root, []).extend(shown)
    result = []
    for root, chosen in found.items():
        rotation, place = data.xmat[root].reshape(3, 3), data.xpos[root]
        surfaces = []
        for geom in chosen:
            surface = _surface(mujoco, model, geom)
            if surface is not None:
                turn = rotation.T @ data.geom_xmat[geom].reshape(3, 3)
                shift = rotation.T @ (data.geom_xpos[geom] - place)
                surfaces.append((geom, surface, turn, shift))
        if surfaces:
            result.append(BodyGaussians(model.body(root).name, _discs(mujoco, model, surfaces, count)))
    return result


def _discs(mujoco: Any, model: Any, surfaces: list[tuple[int, _Surface, Array, Array]], count: int) -> Gaussians:
    """Make the discs of one body, allotted to its surfaces by area."""
    areas = [float(_areas(surface.corners).sum()) for _, surface, _, _ in surfaces]
    columns: dict[str, list[Array]] = {"means": [], "axes": [], "rgb": [], "spread": []}
    for (geom, surface, turn, shift), area in zip(surfaces, areas, strict=True):
        own = max(LEAST, round(count * area / sum(areas)))
        points, normals, faces, shares = _spread_points(surface.corners, own)
        columns["means"].append(points @ turn.T + shift)
        columns["axes"].append(_frames(normals @ turn.T))
        columns["rgb"].append(_colours(mujoco, model, geom, surface, points, faces, shares))
        columns["spread"].append(np.full(own, SPREAD * math.sqrt(area / own)))
    means, axes, rgb, spread = (torch.from_numpy(np.concatenate(column)) for column in columns.values())
    return Gaussians(
        means=means.float(),
        quats=rotations_to_quats(axes).float(),
        scales=torch.stack([spread, spread, spread.clamp_max(THICKNESS)], 1).float(),
        opacities=torch.full((len(means),), OPACITY),
        sh=((rgb - 0.5) / C0).float().unsqueeze(1),
        batch_size=[len(means)],
    )


def _areas(corners: Array) -> Array:
    """Return the areas of triangles: [F, 3, 3] -> [F]."""
    cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    return np.asarray(0.5 * np.linalg.norm(cross, axis=1))


def _spread_points(corners: Array, count: int) -> tuple[Array, Array, NDArray[np.int64], Array]:
    """Choose points that cover triangles evenly, by farthest point sampling (Eldar et al. 1997) of many candidates.

    Returns:
        Points [N, 3], normals [N, 3], the triangle of each point [N], and its barycentric coordinates there [N, 3].
    """
    areas = _areas(corners)
    many = count * CANDIDATES
    number = np.arange(many)
    faces = np.searchsorted(np.cumsum(areas), (number + 0.5) / many * areas.sum()).clip(0, len(areas) - 1)
    a, b = (0.5 + number * 0.7548776662466927) % 1.0, (0.5 + number * 0.5698402909980532) % 1.0  # the R2 sequence
    root = np.sqrt(a)
    shares = np.stack([1 - root, root * (1 - b), root * b], 1)
    points = (corners[faces] * shares[:, :, None]).sum(1)
    chosen = np.zeros(count, np.int64)
    chosen[0] = ((points - points.mean(0)) ** 2).sum(1).argmax()
    columns = np.ascontiguousarray(points.T)
    away = _distances(columns, points[chosen[0]])
    for place in range(1, count):
        chosen[place] = away.argmax()
        np.minimum(away, _distances(columns, points[chosen[place]]), out=away)
    cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])[faces[chosen]]
    normals = cross / np.linalg.norm(cross, axis=1, keepdims=True).clip(1e-30)
    return points[chosen], normals, faces[chosen], shares[chosen]


def _distances(columns: Array, point: Array) -> Array:
    """Return the squared distances of points, stored as columns, from one point: [3, N], [3] -> [N]."""
    x, y, z = columns - point[:, None]
    return np.asarray(x * x + y * y + z * z)


def _frames(normals: Array) -> Array:
    """Return rotations whose third axis is the normal: [N, 3] -> [N, 3, 3]."""
    helper = np.eye(3)[np.abs(normals).argmin(1)]
    first = np.cross(helper, normals)
    first /= np.linalg.norm(first, axis=1, keepdims=True)
    return np.stack([first, np.cross(normals, first), normals], -1)


def _surface(mujoco: Any, model: Any, geom: int) -> _Surface | None:
    """Return the triangles of a geom in its own frame; None for a geom that is not drawn."""
    kinds, kind, size = mujoco.mjtGeom, int(model.geom_type[geom]), model.geom_size[geom]
    if kind == kinds.mjGEOM_MESH:
        return _mesh(model, int(model.geom_dataid[geom]))
    if kind == kinds.mjGEOM_BOX:
        return _Surface(_box(size))
    if kind in (kinds.mjGEOM_SPHERE, kinds.mjGEOM_ELLIPSOID):
        radii = np.full(3, size[0]) if kind == kinds.mjGEOM_SPHERE else size
        return _Surface(_turned(*_arc(0.0, 1.0)) * radii)
    if kind == kinds.mjGEOM_CAPSULE:
        return _Surface(_turned(*_arc(size[1], size[0])))
    if kind == kinds.mjGEOM_CYLINDER:
        return _Surface(_turned(np.array([0.0, size[0], size[0], 0.0]), size[1] * np.array([-1.0, -1.0, 1.0, 1.0])))
    return None


def _arc(half: float, radius: float) -> tuple[Array, Array]:
    """Return the profile of a capsule, or of a sphere if ``half`` is 0: radii and heights, from bottom to top."""
    angle = np.linspace(-0.5 * math.pi, 0.0, AROUND // 4 + 1)
    low, rise = radius * np.cos(angle), radius * np.sin(angle) - half
    radii, heights = np.concatenate([low, low[::-1]]), np.concatenate([rise, -rise[::-1]])
    return radii, heights


def _turned(radii: Array, heights: Array) -> Array:
    """Revolve a profile about z and return its triangles, facing outwards: [F, 3, 3]."""
    angle = np.arange(AROUND + 1) * (2 * math.pi / AROUND)
    rim = np.stack(
        [
            radii[:, None] * np.cos(angle),
            radii[:, None] * np.sin(angle),
            np.broadcast_to(heights[:, None], (len(radii), AROUND + 1)),
        ],
        -1,
    )
    a, b, c, d = rim[:-1, :-1], rim[:-1, 1:], rim[1:, 1:], rim[1:, :-1]
    corners = np.concatenate([np.stack([a, b, c], 2), np.stack([a, c, d], 2)]).reshape(-1, 3, 3)
    return corners[_areas(corners) > 0]


def _box(half: Array) -> Array:
    """Return the triangles of a box, facing outwards: [12, 3, 3]."""
    found = []
    for axis in range(3):
        for side in (-1.0, 1.0):
            u, v = np.eye(3)[(axis + 1) % 3], np.eye(3)[(axis + 2) % 3] * side
            middle = side * np.eye(3)[axis]
            square = np.array([middle - u - v, middle + u - v, middle + u + v, middle - u + v]) * half
            found += [square[[0, 1, 2]], square[[0, 2, 3]]]
    return np.stack(found)


def _mesh(model: Any, mesh: int) -> _Surface:
    """Return the triangles of a mesh, without those of zero area."""
    first, faces = (
        int(model.mesh_vertadr[mesh]),
        slice(int(model.mesh_faceadr[mesh]), int(model.mesh_faceadr[mesh] + model.mesh_facenum[mesh])),
    )
    corners = model.mesh_vert[first + model.mesh_face[faces]].astype(np.float64)
    kept = _areas(corners) > 0
    uv = None
    if model.mesh_texcoordadr[mesh] >= 0:
        start = int(model.mesh_texcoordadr[mesh])
        uv = model.mesh_texcoord[start + model.mesh_facetexcoord[faces]].astype(np.float64)[kept]
    return _Surface(corners[kept], uv)


def _rgba(model: Any, geom: int) -> Array:
    """Return the colour of a geom, or of its material if it has none of its own."""
    material, own = int(model.geom_matid[geom]), model.geom_rgba[geom]
    if material >= 0 and np.array_equal(own, np.array([0.5, 0.5, 0.5, 1.0], own.dtype)):
        own = model.mat_rgba[material]
    return np.asarray(own, np.float64)


def _colours(
    mujoco: Any, model: Any, geom: int, surface: _Surface, points: Array, faces: NDArray[np.int64], shares: Array
) -> Array:
    """Return the colour of each point of a geom: [N, 3] in [0, 1]."""
    rgb = np.repeat(_rgba(model, geom)[None, :3], len(points), 0)
    material = int(model.geom_matid[geom])
    texture = int(model.mat_texid[material, mujoco.mjtTextureRole.mjTEXROLE_RGB]) if material >= 0 else -1
    if texture < 0:
        return rgb
    high, wide, channels = (int(getattr(model, f"tex_{name}")[texture]) for name in ("height", "width", "nchannel"))
    first = int(model.tex_adr[texture])
    texels = model.tex_data[first : first + high * wide * channels].reshape(high, wide, channels) / 255.0
    texels = texels[..., :3] if channels >= 3 else np.repeat(texels[..., :1], 3, 2)
    if int(model.tex_type[texture]) == mujoco.mjtTexture.mjTEXTURE_CUBE:
        return rgb * _cube_texels(texels, points)
    if surface.uv is None:
        return rgb * texels.mean((0, 1))
    uv = (surface.uv[faces] * shares[:, :, None]).sum(1) * model.mat_texrepeat[material]
    column, row = (uv[:, 0] % 1.0 * wide).astype(int) % wide, (uv[:, 1] % 1.0 * high).astype(int) % high
    return rgb * texels[row, column]


def _cube_texels(texels: Array, points: Array) -> Array:
    """Look up directions in a cube map whose faces +x, −x, +y, −y, +z, −z are stacked vertically, as OpenGL does."""
    side = texels.shape[1]
    x, y, z = points.T
    axis = np.abs(points).argmax(1)
    face = 2 * axis + (points[np.arange(len(points)), axis] < 0)
    along = np.choose(face, [-z, z, x, x, x, -x])
    down = np.choose(face, [-y, -y, z, -z, -y, -y])
    largest = np.abs(points).max(1).clip(1e-12)
    column, row = (((one / largest + 1.0) / 2.0 * side).astype(int).clip(0, side - 1) for one in (along, down))
    return texels.reshape(-1, side, side, 3)[face % (len(texels) // side), row, column]
