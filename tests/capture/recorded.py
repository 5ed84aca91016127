"""Recordings of a room with noise on its walls, in the formats of apps for phones with a depth sensor.

The phone is held upright, so the images lie on their side as stored; autofocus and image stabilisation change the
intrinsics from image to image.
"""

import csv
import json
import zipfile
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from PIL import Image
from scipy.spatial.transform import Rotation

from splatrl.capture.base import Photos
from tests.capture.ray_cast import HEIGHT, QUARTER_TURN, WIDTH, room_depth, room_image, walk, write_video

SENSOR = (64, 48)
"""Width and height of the depth images, pixels."""
ARKIT_FROM_ROOM = np.array([[1.0, 0, 0, 0.3], [0, 0, 1, -0.2], [0, -1, 0, 0.1], [0, 0, 0, 1]])
"""Transform from the room (z up) to ARKit's world (+y up)."""
OPENGL = np.diag([1.0, -1.0, -1.0, 1.0])
UNTRUSTED = (slice(0, 5), slice(0, 7))
"""Rows and columns of the depth images that have low confidence and wrong depth."""


@dataclass(frozen=True)
class Taken:
    """One image and the data that the phone stores with it.

    Attributes:
        pose: [4, 4] camera_to_world in the room, OpenCV axes.
        K: [3, 3] intrinsics, pixels.
        image: [H, W, 3] uint8, as stored.
        depth: [48, 64] uint16, millimetres.
        confidence: [48, 64] uint8, 0 to 2.
    """

    pose: np.ndarray
    K: np.ndarray
    image: np.ndarray
    depth: np.ndarray
    confidence: np.ndarray

    @property
    def arkit(self) -> np.ndarray:
        """The pose in ARKit's world, OpenCV axes."""
        return ARKIT_FROM_ROOM @ self.pose


def taken(count: int, steady: bool = False) -> list[Taken]:
    """Return images of a walk through the room, the phone held so that the right edge of a stored image is up.

    Args:
        count: number of images.
        steady: whether all images have the same intrinsics.
    """
    rolled = np.eye(4)
    rolled[:2, :2] = [[0, 1], [-1, 0]]
    result = []
    for number, upright in enumerate(walk(count)):
        pose = upright @ rolled
        wave = 0.0 if steady else np.sin(2 * number)
        K = np.array([[260 + 0.9 * wave, 0, 163 + 2 * wave], [0, 260 + 0.9 * wave, 118 - wave], [0, 0, 1]])
        scaled = np.diag([SENSOR[0] / WIDTH, SENSOR[1] / HEIGHT, 1]) @ K
        depth = np.round(1000 * room_depth(pose, scaled, SENSOR)).astype(np.uint16)
        confidence = np.full(depth.shape, 2, np.uint8)
        confidence[UNTRUSTED], depth[UNTRUSTED] = 0, 77
        result.append(Taken(pose, K, room_image(pose, K=K).copy(), depth, confidence))
    return result


def as_seen(photos: Photos, number: int, world_from_room: np.ndarray) -> tuple[float, float]:
    """Return an image's mean error against its camera's view, and the least after a shift by a pixel, grey levels."""
    assert photos.K is not None and photos.camera_to_world is not None
    pose = np.linalg.inv(world_from_room) @ photos.camera_to_world[number].numpy()
    expected = room_image(pose, K=photos.K.numpy(), size=(photos.width, photos.height)).astype(float)
    shown = np.asarray(Image.open(photos.paths[number])).astype(float)
    moves = [(0, 0), (0, 1), (0, -1), (1, 0), (-1, 0)]
    off = [np.abs(np.roll(shown, move, (0, 1)) - expected)[8:-8, 8:-8].mean() for move in moves]
    return off[0], min(off[1:])


def write_polycam(folder: Path, images: list[Taken], corrected: bool = False) -> Path:
    """Write Polycam's raw data; ``corrected`` uses the folder names of its corrected images and cameras."""
    keyframes, names = folder / "keyframes", ("images", "cameras", "depth", "confidence")
    names = tuple(f"corrected_{name}" if corrected and name in names[:2] else name for name in names)
    for name in names:
        (keyframes / name).mkdir(parents=True)
    for number, one in enumerate(images):
        stem = str(998_000_000 + number * 10_000_000)  # microseconds, with varying numbers of digits
        Image.fromarray(one.image).save(keyframes / names[0] / f"{stem}.jpg", quality=97, subsampling=0)
        pose = one.arkit @ OPENGL
        camera = {f"t_{i}{j}": pose[i, j] for i in range(3) for j in range(4)}
        camera |= {"fx": one.K[0, 0], "fy": one.K[1, 1], "cx": one.K[0, 2], "cy": one.K[1, 2]}
        camera |= {"width": WIDTH, "height": HEIGHT, "blur_score": 90.0}
        (keyframes / names[1] / f"{stem}.json").write_text(json.dumps(camera))
        Image.fromarray(one.depth).save(keyframes / "depth" / f"{stem}.png")
        Image.fromarray(np.array([0, 127, 255], np.uint8)[one.confidence]).save(
            keyframes / "confidence" / f"{stem}.png"
        )
    return folder


def write_stray(folder: Path, images: list[Taken]) -> Path:
    """Write a recording of Stray Scanner; its video tells players to rotate the frames."""
    for name in ("depth", "confidence"):
        (folder / name).mkdir(parents=True)
    write_video(folder / "rgb.mp4", [one.image for one in images], shown=QUARTER_TURN)
    (folder / "camera_matrix.csv").write_text("262.0, 0.0, 160.0\n0.0, 262.0, 120.0\n0.0, 0.0, 1.0")
    with (folder / "odometry.csv").open("w", newline="") as stream:
        table = csv.writer(stream)
        columns = "timestamp frame x y z qx qy qz qw fx fy cx cy distortion_center_x"
        table.writerow([f" {name}" for name in columns.split()])
        for number, one in enumerate(images):
            place, quat = one.arkit[:3, 3], Rotation.from_matrix(one.arkit[:3, :3]).as_quat()
            K = one.K[0, 0], one.K[1, 1], one.K[0, 2], one.K[1, 2]
            values = 65764.2 + number / 10, f"{number:06}", *place, *quat, *K, ""
            table.writerow([f" {value}" for value in values])
            Image.fromarray(one.depth).save(folder / "depth" / f"{number:06}.png")
            Image.fromarray(one.confidence).save(folder / "confidence" / f"{number:06}.png")
    return folder


def write_record3d(folder: Path, images: list[Taken], **changes: object) -> Path:
    """Write the folder of a Record3D recording; ``changes`` replace entries of its metadata, None removes them."""
    import imagecodecs

    (folder / "rgbd").mkdir(parents=True)
    poses = [one.arkit @ OPENGL for one in images]
    K = images[0].K
    metadata: dict[str, object] = {
        "w": WIDTH,
        "h": HEIGHT,
        "dw": SENSOR[0],
        "dh": SENSOR[1],
        "fps": 10,
        "K": K.T.ravel().tolist(),
        "poses": [[*Rotation.from_matrix(pose[:3, :3]).as_quat(), *pose[:3, 3]] for pose in poses],
        "initPose": [0, 0, 0, 1, 0, 0, 0],
        "frameTimestamps": [number / 10 for number in range(len(images))],
        "perFrameIntrinsicCoeffs": [[one.K[0, 0], one.K[1, 1], one.K[0, 2], one.K[1, 2]] for one in images],
    }
    metadata |= changes
    (folder / "metadata").write_text(json.dumps({key: value for key, value in metadata.items() if value is not None}))
    for number, one in enumerate(images):
        Image.fromarray(one.image).save(folder / "rgbd" / f"{number}.jpg", quality=97, subsampling=0)
        metres = (one.depth / 1000).astype("<f4")
        metres[-1, -1] = np.nan
        (folder / "rgbd" / f"{number}.depth").write_bytes(imagecodecs.lzfse_encode(metres.tobytes()))
        (folder / "rgbd" / f"{number}.conf").write_bytes(imagecodecs.lzfse_encode(one.confidence.tobytes()))
    return folder


def write_r3d(path: Path, images: list[Taken]) -> Path:
    """Write a Record3D recording as a single .r3d file."""
    folder = write_record3d(path.with_suffix(""), images)
    with zipfile.ZipFile(path, "w") as archive:
        for file in sorted(file for file in folder.rglob("*") if file.is_file()):
            archive.write(file, file.relative_to(folder))
    return path


def write_nerfstudio(folder: Path, images: list[Taken]) -> Path:
    """Write what nerfstudio makes of Polycam's raw data: one camera per image, z up, depth as large as the images."""
    for name in ("images", "depth"):
        (folder / name).mkdir(parents=True)
    frames = []
    for number, one in enumerate(images):
        Image.fromarray(one.image).save(folder / "images" / f"frame_{number:05}.png")
        large = Image.fromarray(one.depth).resize((WIDTH, HEIGHT), Image.Resampling.NEAREST)
        large.save(folder / "depth" / f"frame_{number:05}.png")
        frames.append(
            {
                "file_path": f"./images/frame_{number:05}.png",
                "depth_file_path": f"./depth/frame_{number:05}.png",
                "transform_matrix": (one.pose @ OPENGL).tolist(),
                "fl_x": one.K[0, 0],
                "fl_y": one.K[1, 1],
                "cx": one.K[0, 2],
                "cy": one.K[1, 2],
                "w": WIDTH,
                "h": HEIGHT,
            }
        )
    (folder / "transforms.json").write_text(
        json.dumps({"camera_model": "OPENCV", "orientation_override": "none", "frames": frames})
    )
    return folder


KINDS: dict[str, Callable[[Path, list[Taken]], Path]] = {
    "polycam": write_polycam,
    "stray": write_stray,
    "record3d": write_record3d,
    "r3d": lambda path, images: write_r3d(path.with_suffix(".r3d"), images),
}
"""Writers of the formats that record depth and gravity, by name."""
