"""Run policy.onnx, which lies beside this file, on a video or a camera: python run_policy.py walk.mp4 --fov 69

Prints the policy's action for each frame. Needs numpy, onnxruntime and opencv-python, but not splatrl. Any other
observation of the policy is held constant: --give pointgoal_with_gps_compass=2.5,0.3 or --give imagegoal=goal.png.
OpenCV shows films of high dynamic range (HDR), as recent iPhones make them, in wrong colours: export them as SDR first.
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
half, wide = (math.tan(math.radians(angle) / 2) for angle in (own, options.fov or own))  # of images at distance 1
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


def fitted(image: np.ndarray) -> np.ndarray:
    """Crop and shrink a camera's image to what the policy's camera would see, [H, W, 3]; its edges are repeated."""
    scale = image.shape[1] * half / wide / width  # pixels of the image along a side of the policy's
    cut, size, beyond = [], [], []
    for length, count in ((image.shape[0], height), (image.shape[1], width)):
        beyond.append(min(max(math.ceil((count - length / scale) / 2 - 0.1), 0), (count - 1) // 2))
        size.append(count - 2 * beyond[-1])
        part = min(max(round(size[-1] * scale), 1), length)
        cut.append(slice((length - part) // 2, (length + part) // 2))
    seen = cv2.resize(image[cut[0], cut[1]], size[::-1], interpolation=cv2.INTER_AREA)
    return cv2.copyMakeBorder(seen, beyond[0], beyond[0], beyond[1], beyond[1], cv2.BORDER_REPLICATE)


def lacking(image: np.ndarray) -> str:
    """Say which part of the policy's field of view an image shows; empty if it shows all of it."""
    tall, down = wide * image.shape[0] / image.shape[1], half * height / width
    if wide > half - 0.2 * half / width and tall > down - 0.2 * half / width:
        return ""
    shown, whole = (
        " × ".join(f"{2 * math.degrees(math.atan(side)):.0f}°" for side in sides)
        for sides in ((min(wide, half), min(tall, down)), (half, down))
    )
    taken = "" if options.fov else f" if it spans {own:g}° across, as the policy's camera does (--fov)"
    return f"{options.source} shows {shown} of the policy's {whole}{taken}; its edges are repeated beyond"


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
    if "pixels" in given:
        if number == 0 and (note := lacking(image)):
            print(note, file=sys.stderr)
        given["pixels"] = fitted(image)[None, :, :, ::-1].copy()  # OpenCV has BGR
    given |= {"begin": begin & (number == 0)} if "begin" in given else {}
    answer = {each.name: value for each, value in zip(session.get_outputs(), session.run(None, given), strict=True)}
    given |= {name.removeprefix("next_"): value for name, value in answer.items() if name.startswith("next_")}
    action = answer["action"][0]
    shares = [f"{share:.4f}" for share in answer["probabilities"][0]] if "probabilities" in answer else []
    print(number, names[action] if names else action, *shares, flush=True)
