"""Collision checking in plain torch on any device with float64: a slow, readable, exact twin of ``NativeChecker``."""

from collections.abc import Iterator
from typing import NamedTuple

import torch
from torch import Tensor

from splatrl.bodies import Body, Box, Capsule
from splatrl.collision.displacement import Displacement, checked_poses
from splatrl.collision.occupancy import Occupancy
from splatrl.collision.rays import ranges_by_formula
from splatrl.collision.voxel_grid import checked_points
from splatrl.geometry import quats_to_rotations, rotations_to_quats

_SLACK = 1e-9
"""Largest gap that counts as a touch, metres: about the rounding error of float64."""
_PARALLEL = 1e-7
"""Sine of the angle below which two edges count as parallel and span no face."""
_TURN = 0.2
"""Maximum distance that a point of a turning body travels within one part of a move, in voxels."""
_HALVINGS = 20
"""Bisections that locate a first contact within a part of a move."""
_PAIRS = 2**16
"""Body–voxel pairs tested at once; each takes less than two kilobytes."""


class Solid(NamedTuple):
    """All points within ``radius`` of a zonotope, centre + Σ s_i · edges_i with s_i in [-1, 1]."""

    center: Tensor  # [N, 3] float64, world, metres
    edges: Tensor  # [N, E, 3] half edges
    radius: Tensor  # [N]

    def at(self, rows: Tensor) -> "Solid":
        """Return the solids in some rows: a mask [N] bool or indices [R] int64."""
        return Solid(*(values[rows] for values in self))

    def swept(self, way: Tensor) -> "Solid":
        """Return the solid that this one sweeps along displacements [N, 3], world, metres, both ends included."""
        return Solid(self.center + 0.5 * way, torch.cat([self.edges, 0.5 * way[:, None]], 1), self.radius)


class TorchChecker:
    """Tests a box, a sphere or a capsule against the voxels around it, by formula and in float64.

    A box is tested on all separating axes (Gottschalk et al. 1996): 15, or 21 for the solid that it sweeps at a fixed
    orientation. For a sphere, a capsule and the solids that they sweep (a point, a segment or a parallelogram, grown by
    the radius), the distance to the voxel's box is computed. All of this is exact; a touch counts as a hit, and
    everything outside the grid is free. A move that turns is cut into parts in which no point travels more than a fifth
    of a voxel; in each, the body keeps the orientation at the middle of the part and is grown by the largest
    displacement that this causes, at most a tenth of a voxel. So the test never misses a hit, but may report one where
    the body passes within 0.3 voxels.

    Attributes:
        occupancy: the solid voxels.
        body: the body under test, in the body frame.
    """

    def __init__(self, occupancy: Occupancy, body: Body) -> None:
        self.occupancy = occupancy
        self.body = body

    def collides(self, body_to_world: Tensor) -> Tensor:
        """Return whether the body touches a solid voxel at each pose; see ``Checker.collides``."""
        poses = checked_poses("body_to_world", body_to_world).to(body_to_world.device)
        return self._touched(_solid(self.body, poses[:, :3, :3], poses[:, :3, 3], torch.zeros_like(poses[:, 0, 0])))

    def free_fraction(self, start: Tensor, end: Tensor) -> Tensor:
        """Return the free fraction of each move; see ``Checker.free_fraction``.

        It falls short of the first contact by less than 2⁻²⁰ of a part of the move, and never goes beyond it.
        """
        steps, row, part, solid, way = self._parts(start, end)
        hit = self._touched(solid.swept(way)).nonzero()[:, 0]
        first = torch.full_like(steps, len(row)).scatter_reduce(0, row[hit], hit, "amin")
        moves = (first < len(row)).nonzero()[:, 0]  # moves that hit something
        first = first[moves]  # the first part of each that hits
        solid, way = solid.at(first), way[first]
        free = torch.zeros(len(first), dtype=torch.float64, device=way.device)
        width = (~self._touched(solid)).double()  # 0 for a part that starts with a hit
        for _ in range(_HALVINGS):
            width = 0.5 * width
            clear = ~self._touched(solid.swept((free + width)[:, None] * way))
            free = torch.where(clear, free + width, free)
        share = (part[first] + free) / steps[moves]
        fraction = torch.ones(len(steps), device=way.device)
        fraction[moves] = torch.where(share.float() > share, share.float().nextafter(fraction[:1] * 0), share.float())
        return fraction

    def sweeps(self, start: Tensor, end: Tensor) -> Tensor:
        """Return whether each move hits anything, ends included: [B] bool."""
        steps, row, _, solid, way = self._parts(start, end)
        hits = torch.zeros(len(steps), dtype=torch.bool, device=way.device)
        hits[row[self._touched(solid.swept(way))]] = True
        return hits

    def clearance(self, points: Tensor) -> Tensor:
        """Return the exact distance, not only a bound, from points to the nearest solid voxel: [B] float32 metres."""
        places = torch.from_numpy(checked_points("points", points)).to(points.device)
        centers = (torch.from_numpy(self.occupancy.keys()).to(places) + 0.5) * self.occupancy.resolution
        nearest = torch.full((len(places),), torch.inf, dtype=torch.float64, device=places.device)
        for row in range(len(places) if len(centers) else 0):
            chunks = (
                _point_distances(some - places[row], 0.5 * self.occupancy.resolution) for some in centers.split(_PAIRS)
            )
            nearest[row] = torch.stack([distances.min() for distances in chunks]).min()
        metres = nearest.float()
        return torch.where(metres > nearest, metres.nextafter(torch.zeros_like(metres)), metres)

    def ranges(self, body_to_world: Tensor, beams: Tensor, reach: float) -> Tensor:
        """Cast beams by testing every solid voxel; see ``ranges_by_formula``."""
        return ranges_by_formula(self.occupancy, body_to_world, beams, reach)

    def _parts(self, start: Tensor, end: Tensor) -> tuple[Tensor, Tensor, Tensor, Solid, Tensor]:
        """Cut moves [B] into P parts.

        Returns:
            The number of parts of each move [B]; and for each part its move [P], its index within the move [P], the
            grown body at the part's start with its middle orientation, and the part's displacement [P, 3].
        """
        starts, ends = checked_poses("start", start), checked_poses("end", end)
        arm, longest = _arm(self.body), _TURN * self.occupancy.resolution
        move = Displacement(starts, ends, arm, longest)
        turns = arm * (starts - ends)[:, :3, :3].abs().amax((1, 2)) > 0.0
        cuts = move.steps
        row = torch.arange(len(cuts)).repeat_interleave(torch.where(turns, cuts, 1))
        steps = torch.where(turns, cuts, 1)
        part = torch.arange(len(row)) - (steps.cumsum(0) - steps)[row]
        before, after = move.at(row, part), move.at(row, torch.where(turns[row], part + 1, cuts[row]))
        first, last = (rotations_to_quats(poses[:, :3, :3]) for poses in (before, after))
        last = torch.where((first * last).sum(1, keepdim=True) < 0, -last, last)
        total = first + last
        middle = torch.where(turns[row, None, None], quats_to_rotations(total), before[:, :3, :3])
        # with θ the angle between the quaternions, the rotation is 2θ; half of it moves a point by 2 sin(θ/2) · arm
        grown = arm * torch.where(turns[row], (first - last).norm(dim=1), 0.0)
        solid = _solid(self.body, middle, before[:, :3, 3], grown)
        way = (after - before)[:, :3, 3]
        device = start.device
        solid = Solid(*(values.to(device) for values in solid))
        return steps.to(device), row.to(device), part.to(device), solid, way.to(device)

    def _touched(self, solid: Solid) -> Tensor:
        """Return whether each of N solids touches a solid voxel: [N]."""
        half = 0.5 * self.occupancy.resolution
        hits = torch.zeros(len(solid.center), dtype=torch.bool, device=solid.center.device)
        apart = _box_apart if isinstance(self.body, Box) else _round_apart
        for rows, offsets in self._near_voxels(solid):
            hits[rows[~apart(solid.at(rows), offsets, half)]] = True
        return hits

    def _near_voxels(self, solid: Solid) -> Iterator[tuple[Tensor, Tensor]]:
        """Yield pairs of a solid and a solid voxel within its bounding box.

        The cells of all boxes are numbered consecutively and taken in chunks, so no batch and no move is too large.

        Yields:
            Rows of the solids [P], and voxel centre minus the solid's centre [P, 3].
        """
        device = solid.center.device
        occupied = torch.from_numpy(self.occupancy.occupied).to(device)
        edge = self.occupancy.resolution
        origin = torch.tensor(self.occupancy.origin_key, device=device)
        reach = solid.edges.abs().sum(1) + solid.radius[:, None] + _SLACK
        shape = torch.tensor(occupied.shape, device=device, dtype=solid.center.dtype)
        low = ((solid.center - reach) / edge).ceil() - 1 - origin  # includes the voxel below a touched face
        high = ((solid.center + reach) / edge).floor() - origin
        # limited before the conversion, since places far away exceed int64
        low, high = torch.minimum(low.clamp(min=0), shape).long(), torch.minimum(high.clamp(min=-1), shape - 1).long()
        size = (high - low + 1).clamp(min=0)
        ends = size.prod(1).cumsum(0)
        for begin in range(0, int(ends[-1]) if len(ends) else 0, _PAIRS):
            cell = torch.arange(begin, min(begin + _PAIRS, int(ends[-1])), device=device)
            rows = torch.searchsorted(ends, cell, right=True)
            cell = cell - (ends - size.prod(1))[rows]
            _, y, z = size[rows].unbind(1)
            index = low[rows] + torch.stack([cell // (y * z), cell // z % y, cell % z], 1)
            solid_here = occupied[tuple(index.unbind(1))]
            rows, index = rows[solid_here], index[solid_here]
            yield rows, (index + origin + 0.5) * edge - solid.center[rows]


def _solid(body: Body, rotation: Tensor, center: Tensor, grown: Tensor) -> Solid:
    """Place a body at N poses and grow it by metres [N]; a box grows by at least that on all sides."""
    if isinstance(body, Box):
        half = 0.5 * torch.tensor(body.size, dtype=center.dtype, device=center.device)
        return Solid(center, rotation.mT * (half + grown[:, None])[..., None], torch.zeros_like(grown))
    if isinstance(body, Capsule):
        return Solid(center, 0.5 * body.length * rotation[:, None, :, 2], body.cap_radius + grown)
    return Solid(center, rotation[:, :0], body.radius + grown)


def _arm(body: Body) -> float:
    """Return the lever arm of a rotation: the farthest distance from the origin of a point that it moves, metres."""
    if isinstance(body, Box):
        return body.radius
    return 0.5 * body.length if isinstance(body, Capsule) else 0.0


def _box_apart(solid: Solid, offsets: Tensor, half: float) -> Tensor:
    """Return whether zonotopes without radius are apart from cubes at offsets [P, 3], by separating axes: [P].

    Two zonotopes are apart only if they are apart along the common normal of some pair of their edges.
    """
    cube = half * torch.eye(3, dtype=offsets.dtype, device=offsets.device).expand(len(offsets), 3, 3)
    edges = torch.cat([cube, solid.edges], 1)
    one, other = torch.triu_indices(edges.shape[1], edges.shape[1], 1, device=offsets.device)
    normals = torch.cross(edges[:, one], edges[:, other], dim=2)  # 0 for parallel edges, which never separates
    reach = (normals @ edges.mT).abs().sum(2) + _SLACK * normals.norm(dim=2)
    return ((normals @ offsets[..., None])[..., 0].abs() > reach).any(1)


def _round_apart(solid: Solid, offsets: Tensor, half: float) -> Tensor:
    """Return whether points, segments or parallelograms are beyond ``radius`` of cubes at offsets [P, 3]: [P]."""
    match solid.edges.shape[1]:
        case 0:
            distance = _point_distances(offsets, half)
        case 1:
            distance = _segment_distances(offsets, solid.edges[:, 0], half)
        case _:
            distance = _parallelogram_distances(solid, offsets, half)
    return distance > solid.radius + _SLACK


def _point_distances(offsets: Tensor, half: float) -> Tensor:
    """Return the distance from the origin to cubes at offsets [P, 3]: [P]."""
    return (offsets.abs() - half).clamp(min=0.0).norm(dim=1)


def _segment_distances(offsets: Tensor, tip: Tensor, half: float) -> Tensor:
    """Return the distance from segments between -tip and tip [P, 3] to cubes at offsets: [P].

    The squared distance at s · tip is convex and piecewise quadratic in s, with breaks where a coordinate enters or
    leaves the cube's extent; between breaks its derivative is linear, and is solved for 0.
    """
    faces = torch.stack([offsets - half, offsets + half], 2) / tip[..., None]
    breaks = faces.flatten(1).nan_to_num(1.0, 1.0, -1.0).clamp(-1.0, 1.0)
    ends = torch.ones_like(breaks[:, :1])
    s = torch.cat([-ends, breaks, ends], 1).sort(dim=1).values
    beyond = s[..., None] * tip[:, None] - offsets[:, None]  # [P, 8, 3]
    slope = ((beyond - beyond.clamp(-half, half)) * tip[:, None]).sum(2)
    below = ((slope[:, :-1] < 0).sum(1, keepdim=True) - 1).clamp(min=0)
    left, right = slope.gather(1, below), slope.gather(1, below + 1)
    share = (-left / (right - left).clamp(min=1e-300)).clamp(0.0, 1.0)
    at = torch.lerp(s.gather(1, below), s.gather(1, below + 1), share)
    return _point_distances(offsets - at * tip, half)


def _parallelogram_distances(solid: Solid, offsets: Tensor, half: float) -> Tensor:
    """Return the distance from parallelograms of two edges to cubes at offsets [P, 3]: [P].

    If they are apart, the nearest points are either on an edge of the parallelogram, or on its face and at a corner of
    the cube.
    """
    u, v = solid.edges.unbind(1)
    sides = ((offsets - v, u), (offsets + v, u), (offsets - u, v), (offsets + u, v))
    distance = torch.stack([_segment_distances(offset, tip, half) for offset, tip in sides]).amin(0)
    normal = torch.cross(u, v, dim=1)
    area = normal.norm(dim=1)
    flat = area <= _PARALLEL * u.norm(dim=1) * v.norm(dim=1)
    normal = normal / torch.where(flat, 1.0, area)[:, None]
    signs = torch.tensor([-half, half], dtype=offsets.dtype, device=offsets.device)
    corners = offsets[:, None] + torch.cartesian_prod(signs, signs, signs)  # [P, 8, 3]
    area = torch.where(flat, 1.0, area)[:, None]
    along_u = (torch.cross(corners, v[:, None].expand_as(corners), dim=2) * normal[:, None]).sum(2) / area
    along_v = (torch.cross(u[:, None].expand_as(corners), corners, dim=2) * normal[:, None]).sum(2) / area
    over = (along_u.abs() <= 1) & (along_v.abs() <= 1) & ~flat[:, None]
    height = (corners * normal[:, None]).sum(2).abs()
    distance = torch.minimum(distance, torch.where(over, height, torch.inf).amin(1))
    inside = ~_box_apart(Solid(solid.center, solid.edges, torch.zeros_like(solid.radius)), offsets, half)
    return torch.where(inside, 0.0, distance)
