"""Run policy.onnx, which lies beside this file, on a video or a camera: python run_policy.py walk.mp4 --fov 69

Prints the policy's action for each frame. Needs numpy, onnxruntime and opencv-python, but not splatrl. Any other
observation of the policy is held constant: --give pointgoal_with_gps_compass=2.5,0.3 or --give imagegoal=goal.png.
A picture of depth is grey, with 8 or 16 bits: black is the nearest depth of the policy's camera, white the farthest.
"""

import argparse
import json
import math
import os
import sys
from pathlib import Path

import cv2
import numpy as np
import onnxruntime

parser = argparse.ArgumentParser(description=__doc__)
parser.add_argument("source", help="a video file, or the number of a camera")
parser.add_argument("--fov", type=float, help="horizontal field of view, degrees; by default that of the policy")
parser.add_argument("--give", action="append", default=[], metavar="NAME=NUMBERS", help="or NAME=IMAGE; see above")
options = parser.parse_args()
if options.fov is not None and not 0 < options.fov < 180:
    parser.error(f"--fov: expected degrees between 0 and 180, got {options.fov}")
session = onnxruntime.InferenceSession(str(Path(__file__).with_name("policy.onnx")))
facts = session.get_modelmeta().custom_metadata_map
width, height, own = int(facts["image_width"]), int(facts["image_height"]), float(facts["fov_deg"])
wide = math.tan(math.radians(own) / 2) / math.tan(math.radians(options.fov or own) / 2)  # as a fraction of the camera's
if wide > 1:
    print(f"--fov: the video shows {options.fov:g}° of the policy's {own:g}°", file=sys.stderr)
kinds = {"tensor(uint8)": np.uint8, "tensor(float)": np.float32, "tensor(bool)": np.bool_}
given: dict[str, np.ndarray] = {
    each.name: np.zeros([1, *each.shape[1:]], kinds[each.type]) for each in session.get_inputs()
}
sensors = json.loads(facts["sensors"])
observed = [name for name in sensors if name in given]
told = dict(one.partition("=")[::2] for one in options.give)
if missing := [name for name in [*observed, *told] if (name in told) != (name in observed)]:
    parser.error(f"--give: expected {' and '.join(observed) or 'nothing'} for this policy; check {missing[0]}")


def read(value: str, like: np.ndarray, sensor: dict[str, float]) -> np.ndarray:
    """Read numbers, or an image file where the observation is an image, [1, H, W, C]; raises ValueError for others."""
    if like.ndim != 4 or not os.path.isfile(value):
        return np.array(value.split(","), np.float32).reshape(like.shape)
    color = cv2.IMREAD_GRAYSCALE if like.shape[3] == 1 else cv2.IMREAD_COLOR
    image = cv2.imread(value, color if like.dtype == np.uint8 else color | cv2.IMREAD_ANYDEPTH)
    if image is None:
        raise ValueError(value)
    image = cv2.resize(image, like.shape[2:0:-1], interpolation=cv2.INTER_AREA).reshape(like.shape)[..., ::-1]  # BGR
    if like.dtype == np.uint8:
        return image
    low, high = (0, 1) if sensor.get("normalize", True) else (sensor["nearest"], sensor["farthest"])
    return low + (high - low) * (image / np.iinfo(image.dtype.name).max)


for name, value in told.items():
    try:
        given[name] = read(value, given[name], sensors[name]).astype(given[name].dtype)
    except ValueError:
        kind = "numbers or an image file" if given[name].ndim == 4 else "numbers"
        parser.error(f"--give {name}: expected {given[name].size} {kind}, got {value:.60}")
begin, names = np.ones(1, np.bool_), json.loads(facts["actions"])
camera = cv2.VideoCapture(int(options.source) if options.source.isdigit() else options.source)
if not camera.isOpened():
    parser.error(f"{options.source}: expected a video file or the number of a camera, which cannot be opened")
for number in range(10**9):
    found, image = camera.read()
    if not found:
        break
    scale = min(image.shape[1] * min(wide, 1.0) / width, image.shape[0] / height)  # camera pixels per policy pixel
    rows, columns = max(round(scale * height), 1), max(round(scale * width), 1)
    top, left = (image.shape[0] - rows) // 2, (image.shape[1] - columns) // 2
    view = cv2.resize(image[top : top + rows, left : left + columns], (width, height), interpolation=cv2.INTER_AREA)
    given |= {"pixels": view[None, :, :, ::-1].copy()} if "pixels" in given else {}  # OpenCV has BGR
    given |= {"begin": begin & (number == 0)} if "begin" in given else {}
    answer = {each.name: value for each, value in zip(session.get_outputs(), session.run(None, given), strict=True)}
    given |= {name.removeprefix("next_"): value for name, value in answer.items() if name.startswith("next_")}
    action = answer["action"][0]
    shares = [f"{share:.4f}" for share in answer["probabilities"][0]] if "probabilities" in answer else []
    print(number, names[action] if names else action, *shares, flush=True)
