"""Ray-cast images of rooms with noise on their walls, and videos of them, for tests of capture."""

from functools import cache
from pathlib import Path

import av
import numpy as np
import torch

from splatrl.capture.base import Photos

WIDTH, HEIGHT = 320, 240
K = np.array([[260.0, 0, 163], [0, 260, 118], [0, 0, 1]])
HALF = np.array([2.5, 2.0, 1.3])
"""Half the side lengths of a room, metres."""


def room_image(
    camera_to_world: np.ndarray, seed: int = 0, K: np.ndarray = K, size: tuple[int, int] = (WIDTH, HEIGHT)
) -> np.ndarray:
    """Return the image that a camera inside a room sees.

    Args:
        camera_to_world: [4, 4], metres, OpenCV axes; the room's centre is the origin.
        seed: seed of the noise on the walls; each seed gives a different room.
        K: [3, 3] intrinsics, pixels.
        size: width and height of the image, pixels.

    Returns:
        [H, W, 3] uint8, cached and therefore read-only.
    """
    return _image(np.asarray(camera_to_world, float).tobytes(), seed, np.asarray(K, float).tobytes(), size)


@cache
def _image(camera: bytes, seed: int, intrinsics: bytes, size: tuple[int, int]) -> np.ndarray:
    camera_to_world, K = np.frombuffer(camera).reshape(4, 4), np.frombuffer(intrinsics).reshape(3, 3)
    rays, way = _cast(camera_to_world, K, size)
    axis = way.argmin(-1)
    hit = camera_to_world[:3, 3] + rays * np.take_along_axis(way, axis[..., None], -1)
    wall = 2 * axis + (np.take_along_axis(rays, axis[..., None], -1)[..., 0] > 0)
    u = np.where(axis == 0, hit[..., 1], hit[..., 0]) * 40
    v = np.where(axis == 2, hit[..., 1], hit[..., 2]) * 40
    image = _sampled(_walls(seed), wall, u, v)
    image.flags.writeable = False
    return image


def room_depth(camera_to_world: np.ndarray, K: np.ndarray, size: tuple[int, int]) -> np.ndarray:
    """Return the depth of the walls along a camera's axis, metres; arguments as for ``room_image``: [H, W]."""
    return _cast(camera_to_world, K, size)[1].min(-1)


def walk(count: int) -> np.ndarray:
    """Return poses of a camera that walks sideways, sways and looks into a corner: [N, 4, 4]."""
    poses = np.tile(np.eye(4), (count, 1, 1))
    for number, pose in enumerate(poses):
        t = number / 23
        turn = 0.75 + 0.25 * np.sin(3 * t)
        right = np.array([np.cos(turn), np.sin(turn), 0])
        forward = np.array([-np.sin(turn), np.cos(turn), 0])
        pose[:3, :3] = np.stack([right, np.cross(forward, right), forward], 1)
        pose[:3, 3] = [-0.8 + 1.6 * t, -0.6 + 0.3 * np.sin(4 * t), 0.2 * np.cos(5 * t)]
    return poses


def turning(count: int) -> np.ndarray:
    """Return poses of a camera that turns on the spot: [N, 4, 4]."""
    poses = walk(count)
    for number, pose in enumerate(poses):
        turn = 0.04 * number
        forward = np.array([-np.sin(turn), np.cos(turn), 0])
        right = np.array([np.cos(turn), np.sin(turn), 0])
        pose[:3, :3] = np.stack([right, np.cross(forward, right), forward], 1)
        pose[:3, 3] = [0.1, -0.2, 0.1]
    return poses


def photos_of(folder: Path, images: list[np.ndarray], seconds: list[float] | None = None) -> Photos:
    """Write images to a new folder and return them as photos; ``seconds`` are their capture times."""
    from PIL import Image

    folder.mkdir(parents=True)
    paths = [folder / f"{number:04}.png" for number in range(len(images))]
    for path, image in zip(paths, images, strict=True):
        Image.fromarray(image).save(path)
    times = torch.tensor(seconds if seconds else list(range(len(images))), dtype=torch.float64)
    files = () if seconds else tuple(path.name for path in paths)
    return Photos(paths, images[0].shape[1], images[0].shape[0], times, files=files)


QUARTER_TURN = (0, 1, -1, 0)
"""Display matrix of a video whose frames players rotate clockwise by 90°."""


def write_video(
    path: Path,
    images: list[np.ndarray],
    rate: int = 10,
    shown: tuple[int, int, int, int] = (1, 0, 0, 1),
    intra: bool = False,
    first: bool = False,
) -> None:
    """Write a video as H.264.

    Args:
        path: the file to write, in the container that its suffix names.
        images: [H, W, 3] uint8 each.
        rate: frames per second.
        shown: display matrix a, b, c, d, by which the file tells players to rotate or mirror the frames.
        intra: whether no frame refers to another.
        first: whether the index of an MP4 comes before its frames, as for the web.
    """
    with av.open(str(path), "w", options={"movflags": "faststart"} if first else {}) as container:
        stream = container.add_stream("h264", rate=rate)
        stream.height, stream.width = images[0].shape[:2]
        stream.pix_fmt, stream.options = "yuv420p", {"crf": "12"} | ({"g": "1"} if intra else {})
        for image in images:
            container.mux(stream.encode(av.VideoFrame.from_ndarray(image, format="rgb24")))
        container.mux(stream.encode())
    if shown != (1, 0, 0, 1):
        header = bytearray(path.read_bytes())
        matrix = np.array([0x10000, 0, 0, 0, 0x10000, 0, 0, 0, 0x40000000], ">i4").tobytes()
        a, b, c, d = (0x10000 * value for value in shown)
        turned = np.array([a, b, 0, c, d, 0, 0, 0, 0x40000000], ">i4").tobytes()
        place = header.index(matrix, header.index(b"tkhd"))
        header[place : place + len(matrix)] = turned
        path.write_bytes(header)


def damage_frame(path: Path, number: int) -> None:
    """Overwrite the data of one frame of a video, so that it cannot be decoded."""
    with av.open(str(path)) as container:
        packets = [packet for packet in container.demux(video=0) if packet.size]
    content = bytearray(path.read_bytes())
    content[packets[number].pos : packets[number].pos + packets[number].size] = b"\xff" * packets[number].size
    path.write_bytes(content)


def _cast(camera_to_world: np.ndarray, K: np.ndarray, size: tuple[int, int]) -> tuple[np.ndarray, np.ndarray]:
    """Return rays of depth 1 along the camera's axis, and the depths where they meet each pair of walls: [H, W, 3]."""
    x, y = np.meshgrid(np.arange(size[0]) + 0.5, np.arange(size[1]) + 0.5)
    rays = np.stack([(x - K[0, 2]) / K[0, 0], (y - K[1, 2]) / K[1, 1], np.ones_like(x)], -1) @ camera_to_world[:3, :3].T
    with np.errstate(divide="ignore"):
        return rays, (np.sign(rays) * HALF - camera_to_world[:3, 3]) / rays


@cache
def _walls(seed: int) -> np.ndarray:
    random = np.random.default_rng(seed)
    walls = np.zeros((6, 256, 256, 3))
    for cell in (4, 8, 16):
        coarse = random.normal(size=(6, 256 // cell, 256 // cell, 3)) * cell**0.7
        walls += np.repeat(np.repeat(coarse, cell, 1), cell, 2)
    return np.clip(128 + 22 * walls, 0, 255)


def _sampled(walls: np.ndarray, wall: np.ndarray, u: np.ndarray, v: np.ndarray) -> np.ndarray:
    """Sample the walls bilinearly: with nearest-neighbour samples, the texture would crawl between images."""
    left, top = np.floor(u).astype(int), np.floor(v).astype(int)
    a, b = (u - left)[..., None], (v - top)[..., None]
    corner = [[walls[wall, (left + i) % 256, (top + j) % 256] for j in (0, 1)] for i in (0, 1)]
    rows = [corner[i][0] * (1 - b) + corner[i][1] * b for i in (0, 1)]
    return (rows[0] * (1 - a) + rows[1] * a).astype(np.uint8)
