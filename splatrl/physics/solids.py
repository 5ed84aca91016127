"""Casts rays at what bodies consist of: how far a lidar's beams go before they enter a thing.

A thing is solid where MuJoCo's contacts take it to be, so every geom is convex, a mesh being its convex hull. A ray is
inside a convex shape along one span. All operations are element-wise in double precision, so that ranges are bitwise
the same in any batch.
"""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
import torch
from torch import Tensor

from splatrl.geometry import multiply_quats
from splatrl.physics.kinematics import Kinematics, rotated, turned_back
from splatrl.physics.optional import needed

TINY = 1e-300
"""Takes the place of 0 as a divisor: the quotient is then far beyond any distance, with the right sign."""
PAIRS = 2**18
"""Maximum number of pairs of rays and faces that are computed at once: few enough for a processor's cache."""

Vectors = Sequence[Tensor]
"""The coordinates of vectors, one tensor each."""


class Span(NamedTuple):
    """Where rays are inside convex shapes, [B, K, R] each, in units of the rays' lengths.

    If a ray misses a shape, near is not less than far.
    """

    near: Tensor
    far: Tensor

    def both(self, other: "Span") -> "Span":
        """Return where rays are inside two shapes at once."""
        return Span(torch.maximum(self.near, other.near), torch.minimum(self.far, other.far))

    def either(self, other: "Span") -> "Span":
        """Return where rays are inside at least one of two shapes whose union is convex."""
        one, two = self._or_nowhere(), other._or_nowhere()
        return Span(torch.minimum(one.near, two.near), torch.maximum(one.far, two.far))

    def _or_nowhere(self) -> "Span":
        missed = ~(self.near <= self.far)  # as is NaN
        return Span(self.near.masked_fill(missed, torch.inf), self.far.masked_fill(missed, -torch.inf))


class _Shapes(NamedTuple):
    """K geoms of one kind.

    Attributes:
        kind: ball, box, capsule, cylinder or hull.
        body: [K] int64, index of each geom's body among those of ``Solids.kinematics``.
        place: [K, 3] float64, where geoms are in the frames of their bodies, metres.
        turn: [K, 4] float64, unit quaternions wxyz.
        size: [K, 3] float64, lengths along the geoms' axes, metres; by them, a shape is scaled to unit size.
        rise: [K] float64, half the height of boxes, cylinders and the straight parts of capsules, in units of ``size``.
        faces: [F, 4] float64, the outer normals of a hull's faces and minus their distances from the origin, in metres.
    """

    kind: str
    body: Tensor
    place: Tensor
    turn: Tensor
    size: Tensor
    rise: Tensor
    faces: Tensor

    def to(self, device: torch.device) -> "_Shapes":
        """Copy to a device."""
        return _Shapes(self.kind, *(part.to(device) for part in self[1:]))


class Solids:
    """The solid geoms of some bodies and of all bodies that they carry.

    A geom is solid if it can touch others: those that are only drawn are not. Planes and height fields are left out, as
    they are from images.

    Args:
        models: an ``MjModel``, or several that differ only in their numbers; see ``Kinematics``.
        tops: names of the bodies, which the world carries.
    """

    def __init__(self, models: Any, tops: Sequence[str]):
        model = models[0] if isinstance(models, Sequence) else models
        roots, paired = {model.body(name).id for name in tops}, {*model.pair_geom1.tolist(), *model.pair_geom2.tolist()}
        kinds = needed().mjtGeom
        named = {
            int(kinds.mjGEOM_SPHERE): "ball",
            int(kinds.mjGEOM_ELLIPSOID): "ball",
            int(kinds.mjGEOM_BOX): "box",
            int(kinds.mjGEOM_CAPSULE): "capsule",
            int(kinds.mjGEOM_CYLINDER): "cylinder",
            int(kinds.mjGEOM_MESH): "hull",
        }
        chosen: dict[tuple[str, int], list[int]] = {}  # geoms, by kind and, for hulls, by mesh
        for geom in range(model.ngeom):
            kind = named.get(int(model.geom_type[geom]))
            touches = model.geom_contype[geom] or model.geom_conaffinity[geom] or geom in paired
            if kind is not None and touches and int(model.body_rootid[model.geom_bodyid[geom]]) in roots:
                mesh = int(model.geom_dataid[geom]) if kind == "hull" else -1
                chosen.setdefault((kind, mesh), []).append(geom)
        bodies = sorted({int(model.geom_bodyid[geom]) for geoms in chosen.values() for geom in geoms})
        self.kinematics = Kinematics(models, [model.body(number).name for number in bodies])
        shapes = [_collected(kind, model, mesh, geoms, bodies) for (kind, mesh), geoms in chosen.items()]
        self._copies = {torch.device("cpu"): shapes}

    def ranges(self, state: Tensor, body_to_world: Tensor, beams: Tensor, reach: float) -> Tensor:
        """Cast beams from a body's origin and return how far each goes before it enters a solid geom.

        Args:
            state: [B, n] float64, in the layout of ``Physics``.
            body_to_world: [B, 4, 4], metres.
            beams: [R, 3] unit vectors, body frame.
            reach: maximum range, metres.

        Returns:
            [B, R] float32, metres: 0 where a beam begins inside a geom, ``reach`` where it enters none.
        """
        shapes = self._shapes(state.device)
        if not shapes:
            return body_to_world.new_full((len(state), len(beams)), reach, dtype=torch.float32)
        most = max(shape.body.numel() * max(len(shape.faces), 3) for shape in shapes)
        rows = max(PAIRS // (most * len(beams)), 1)
        split = zip(state.split(rows), body_to_world.double().split(rows), strict=True)
        found = [self._nearest(shapes, some, poses, beams.double()) for some, poses in split]
        return torch.cat(found).clamp(0.0, reach).float()

    def _nearest(self, shapes: list[_Shapes], state: Tensor, pose: Tensor, beams: Tensor) -> Tensor:
        """Return where beams first are inside a shape, at 0 or beyond, infinite where nowhere: [B, R] float64."""
        axes = pose[:, :3, :3].mT  # [B, 3, 3], those of the body, in the world
        place, turn = self.kinematics(state)
        nearest = pose.new_full((len(pose), len(beams)), torch.inf)
        for shape in shapes:
            above = turn[:, shape.body]  # [B, K, 4]
            at = place[:, shape.body] + rotated(above, shape.place)
            back = turned_back(multiply_quats(above, shape.turn))
            start = rotated(back, pose[:, None, :3, 3] - at) / shape.size
            own = rotated(back.unsqueeze(2), axes.unsqueeze(1)) / shape.size.unsqueeze(1)  # [B, K, 3, 3]
            near, far = _inside(shape, start.unsqueeze(-1).unbind(2), _along(beams, own))
            entered = torch.where((near < far) & (far > 0.0), near.clamp_min(0.0), torch.inf)
            nearest = torch.minimum(nearest, entered.amin(1))
        way = _along(beams, axes)
        return nearest * _dot(way, way).sqrt()

    def _shapes(self, device: torch.device) -> list[_Shapes]:
        """Return the shapes on a device, to which they are copied once."""
        if device not in self._copies:
            self._copies[device] = [shape.to(device) for shape in self._copies[torch.device("cpu")]]
        return self._copies[device]


def _collected(kind: str, model: Any, mesh: int, geoms: list[int], bodies: list[int]) -> _Shapes:
    """Collect geoms of one kind, and of one mesh if they are hulls."""
    size, faces = model.geom_size[geoms].copy(), np.zeros((0, 4))
    rise = np.ones(len(geoms))
    if kind == "hull":
        size, faces = np.ones_like(size), _faces(model, mesh)
    elif kind == "capsule":
        size, rise = np.repeat(size[:, :1], 3, 1), size[:, 1] / size[:, 0]
    elif kind == "cylinder":
        size = size[:, [0, 0, 1]]
    elif kind == "ball":  # a sphere has a single size
        size = np.where(size > 0.0, size, size[:, :1])
    body = torch.tensor([bodies.index(int(model.geom_bodyid[geom])) for geom in geoms])
    place, turn = model.geom_pos[geoms].copy(), model.geom_quat[geoms].copy()
    return _Shapes(kind, body, *(torch.from_numpy(values) for values in (place, turn, size, rise, faces)))


def _faces(model: Any, mesh: int) -> Any:
    """Return the faces of a mesh's convex hull: [F, 4] float64, see ``_Shapes``."""
    from scipy.spatial import ConvexHull  # slow to import, and few things are meshes

    first, count = int(model.mesh_vertadr[mesh]), int(model.mesh_vertnum[mesh])
    hull = ConvexHull(model.mesh_vert[first : first + count].astype(np.float64))
    return np.unique(hull.equations, axis=0)


def _along(beams: Tensor, axes: Tensor) -> Vectors:
    """Return the directions of beams [R, 3] in a frame that has the body's axes [..., 3, 3] as rows: [..., R] each."""
    x, y, z = (axes[..., axis, :, None] * beams[:, axis] for axis in range(3))
    return (x + y + z).unbind(-2)


def _inside(shape: _Shapes, start: Vectors, way: Vectors) -> Span:
    """Return where rays are inside shapes of unit size, in whose frames they start and go: [B, K, 1] and [B, K, R]."""
    if shape.kind == "ball":
        return _round(start, way)
    if shape.kind == "hull":
        return _hull(start, way, shape.faces)
    rise = shape.rise.unsqueeze(1)
    upright = _slab(start[2], way[2], rise)
    if shape.kind == "box":
        return _slab(start[0], way[0], 1.0).both(_slab(start[1], way[1], 1.0)).both(upright)
    straight = _round(start[:2], way[:2]).both(upright)
    if shape.kind == "cylinder":
        return straight
    x, y, z = start
    return straight.either(_round((x, y, z - rise), way)).either(_round((x, y, z + rise), way))


def _slab(start: Tensor, way: Tensor, half: Tensor | float) -> Span:
    """Return where one coordinate of rays is between -half and half."""
    way = torch.where(way == 0.0, TINY, way)
    one, other = (-half - start) / way, (half - start) / way
    return Span(torch.minimum(one, other), torch.maximum(one, other))


def _round(start: Vectors, way: Vectors) -> Span:
    """Return where rays are within 1 of the origin, in two or three coordinates."""
    a, b, c = _dot(way, way), _dot(start, way), _dot(start, start) - 1.0
    a = torch.where(a == 0.0, TINY, a)
    root = (b * b - a * c).sqrt()  # NaN for a miss, which no comparison finds
    return Span((-b - root) / a, (-b + root) / a)


def _dot(one: Vectors, other: Vectors) -> Tensor:
    """Return the dot products of vectors, summed in order."""
    first, *others = (a * b for a, b in zip(one, other, strict=True))
    for product in others:
        first = first + product
    return first


def _hull(start: Vectors, way: Vectors, faces: Tensor) -> Span:
    """Return where rays are behind all faces, [F, 4]."""
    *normal, offset = faces.unbind(1)
    out = _dot([each.unsqueeze(-1) for each in way], normal)  # [B, K, R, F]
    cross = -(_dot([each.unsqueeze(-1) for each in start], normal) + offset) / torch.where(out == 0.0, TINY, out)
    near = torch.where(out < 0.0, cross, -torch.inf).amax(-1)
    return Span(near, torch.where(out < 0.0, torch.inf, cross).amin(-1))
