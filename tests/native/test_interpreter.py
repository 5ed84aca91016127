"""The core within a Python interpreter: threads that cannot start, Ctrl-C, daemon threads at exit, and bad numbers."""

import copy
import os
import pickle
import signal
import sys
import time

import pytest
import torch

from splatrl import Box, Cameras
from splatrl.cameras import intrinsics
from splatrl.collision import NativeChecker, Occupancy
from splatrl.native import _core
from splatrl.native.threads import threads_of, usable_cores
from splatrl.renderers import LatticeRenderer, NativeRenderer, ReferenceRenderer
from tests.preloaded import Process, start
from tests.tiny import tiny_gaussians

LONG = """
import sys, threading, time, torch
from splatrl import Box
from splatrl.collision import NativeChecker, Occupancy
from splatrl.geometry import rigid, axis_rotations
checker = NativeChecker(Occupancy.from_boxes([[-2.0, -2.0, 0.0]], [[2.0, 2.0, 0.02]], 0.02), Box((0.5, 0.5, 0.5)))
count = {count}
start = torch.eye(4).repeat(count, 1, 1)
start[:, 2, 3] = 0.35  # so near that no distance tells whether it touches
end = start.clone()
end[:, :3, :3] = axis_rotations(0, torch.tensor(0.5))
end[:, 0, 3] = 0.1
def work():
    checker.free_fraction(start, end)
"""


def script(text: str, count: int = 500_000) -> Process:
    """Start a program that runs ``LONG`` and this text; ``work`` checks ``count`` moves, about a microsecond each."""
    return start("-c", LONG.format(count=count) + text)


def test_ctrl_c_ends_a_long_call() -> None:
    process = script("checker.threads = 1\nprint('begun', flush=True)\nwork()\nprint('done')", count=1_000_000)
    assert process.stdout is not None and process.stdout.readline() == "begun\n"
    time.sleep(0.2)
    process.send_signal(signal.SIGINT)
    output, _ = process.communicate(timeout=60)
    assert "KeyboardInterrupt" in output and "done" not in output
    assert process.returncode == -signal.SIGINT


STOPPED = """
import signal
from functools import partial
import numpy as np
from splatrl.native import _core
from splatrl.renderers.lod import gaussian_arrays
from tests.renderers.cases import random_gaussians
class Stop(Exception): pass
def stop(number, frame): raise Stop
signal.signal(signal.SIGALRM, stop)
arrays = gaussian_arrays(random_gaussians(0, 250_000))
means = arrays.pop("means")
levels = _core.build_levels(means, **arrays, degree=0)
drawn = dict(background=(0.0, 0.0, 0.0), antialiased=True)
pack, flat = partial(_core.pack_model, **arrays, degree=0, **drawn), partial(_core.flat_scene, **drawn, tolerance=0.0)
add = partial(_core.Renderer(True, (0.0, 0.0, 0.0), 0.0).add_model, 0, **arrays, degree=0)
all_of_it = dict(first=np.zeros((1, 3), int), end=np.full((1, 3), 400), extent=3.0)  # of a grid, by one Gaussian
fill = partial(
    _core.add_density, axes=np.eye(3)[None], scales=np.full((1, 3), 150.0), opacities=np.ones(1), **all_of_it,
    density=np.zeros((400, 400, 400), np.float32),
)
calls = {
    "add_model": (partial(add, levels=None), means), "add_model with levels": (partial(add, levels=levels), means),
    "pack_model": (partial(pack, levels=None), means), "pack_model with levels": (partial(pack, levels=levels), means),
    "flat_scene": (flat, pack(means, levels=levels)),
    "build_levels": (partial(_core.build_levels, **arrays, degree=0), means),
    "add_density": (fill, np.full((1, 3), 200.0)),
}
for name, (call, argument) in calls.items():
    done = []
    signal.setitimer(signal.ITIMER_REAL, 0.01)
    try:
        done.extend(map(call, [argument]))  # all in C: what returns is kept before Python answers a signal that waited
        print(name, "was never stopped")
    except Stop:
        print(name, "went on to its end" if done else "stopped")
"""


def test_long_calls_respond_to_signals_while_they_run() -> None:
    output, _ = (process := start("-c", STOPPED)).communicate(timeout=300)
    assert process.returncode == 0, output
    models = "add_model", "add_model with levels", "pack_model", "pack_model with levels", "flat_scene"
    assert output.splitlines() == [f"{name} stopped" for name in (*models, "build_levels", "add_density")]


def test_daemon_threads_in_the_core_end_with_the_interpreter() -> None:
    text = """
from splatrl.native.threads import usable_cores
places = torch.empty(count)  # torch's own waits for the lock are not what is tested
addresses = start.data_ptr(), end.data_ptr(), places.data_ptr()
def always():
    while True:
        checker._core.free_fraction(*addresses, count, usable_cores())
for _ in range(3):
    threading.Thread(target=always, daemon=True).start()
time.sleep(0.3)
print("ends", flush=True)
"""
    output, _ = (process := script(text, count=50_000)).communicate(timeout=60)
    assert process.returncode == 0, (process.returncode, output)
    assert "ends\n" in output and "terminate" not in output


def test_functions_that_run_at_exit_can_still_use_the_core() -> None:
    text = "import atexit\natexit.register(lambda: print(checker.free_fraction(start, end).mean()))"
    output, _ = (process := script(text, count=4096)).communicate(timeout=60)
    assert process.returncode == 0 and "tensor(" in output


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="needs /proc and a limit of the address space")
def test_the_core_does_without_threads_that_cannot_start() -> None:
    text = """
import resource
checker.threads = 64  # the core is asked for more threads than there are
some = (start, end)
expected = checker.free_fraction(*some)
held = int(open("/proc/self/statm").read().split()[0]) * resource.getpagesize()
resource.setrlimit(resource.RLIMIT_AS, (held + (24 << 20), held + (24 << 20)))
print(torch.equal(checker.free_fraction(*some), expected), flush=True)
try:
    threads = [threading.Thread(target=time.sleep, args=(1,)) for _ in range(64)]
    for thread in threads: thread.start()
except RuntimeError as error:
    print(error)
"""
    output, _ = (process := script(text, count=100_000)).communicate(timeout=60)
    assert process.returncode == 0, (process.returncode, output)
    assert "True\n" in output and "can't start new thread" in output  # so the limit did take effect


def test_a_child_forked_while_the_core_is_busy_exits_normally() -> None:
    text = """
import os, warnings
warnings.simplefilter("ignore")  # Python 3.12 and later warn about a fork beside threads
threading.Thread(target=work, daemon=True).start()
time.sleep(0.15)
if os.fork() == 0:
    work_small = checker.free_fraction(start[:8192], end[:8192])
    sys.exit(0)
print(os.wait()[1], flush=True)
os._exit(0)  # torch's own waits for the lock, as the daemon thread frees its tensors at exit, are not what is tested
"""
    output, _ = (process := script(text, count=300_000)).communicate(timeout=60)
    assert process.returncode == 0 and output == "0\n", output


def test_the_core_uses_no_more_threads_than_there_are_cores() -> None:
    assert threads_of(None) == threads_of(1000) == usable_cores()
    assert threads_of(1) == 1
    assert NativeRenderer(tiny_gaussians(), threads=1000).threads == usable_cores()
    for wrong in (0, -1, True, 2.0, "2"):
        with pytest.raises(ValueError, match="threads: expected a whole number of at least 1, or None for all cores"):
            threads_of(wrong)  # type: ignore[arg-type]


def test_an_environment_variable_limits_the_number_of_cores(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("SPLATRL_CORES", "1")
    assert usable_cores() == threads_of(None) == threads_of(8) == 1
    monkeypatch.setenv("SPLATRL_CORES", "1000000")
    assert usable_cores() <= (os.cpu_count() or 1)
    for wrong in ("0", "-1", "", "two", "1.5"):
        monkeypatch.setenv("SPLATRL_CORES", wrong)
        with pytest.raises(ValueError, match="SPLATRL_CORES: expected a whole number of at least 1"):
            usable_cores()


@pytest.mark.parametrize("place", [3.4e38, -3.4e38, 1e30, 1e-45])
@pytest.mark.parametrize("resolution", [1e-4, 1e3])
def test_extreme_coordinates_are_free_unless_they_are_close_to_the_voxels(place: float, resolution: float) -> None:
    occupancy = Occupancy.from_keys([[0, 0, 0], [3, 2, 1]], resolution)
    checker = NativeChecker(occupancy, Box((resolution, resolution, resolution)))
    points = torch.tensor([[place, 0.0, 0.0], [0.0, place, place], [place, -place, place]])
    assert (checker.clearance(points) >= 0).all()
    poses = torch.eye(4).repeat(3, 1, 1)
    poses[:, :3, 3] = points
    hits = checker.collides(poses)
    assert hits.all() if abs(place) < 1 else not hits.any()
    assert (checker.free_fraction(poses, poses.flip(0)) <= 1).all()


def test_the_core_refuses_lengths_that_it_cannot_count_in_voxels() -> None:
    occupancy = Occupancy.from_keys([[0, 0, 0]], 0.1)
    right = {
        "solid": occupancy.occupied, "distance": torch.zeros(1, 1, 1), "corner": (0.0, 0.0, 0.0), "resolution": 0.1,
        "half": (0.1, 0.1, 0.1), "half_length": 0.0, "radius": 0.0,
    }  # fmt: skip
    _core.Collider(**right)
    wrong = {"resolution": 1e-310}, {"resolution": 1e300}, {"resolution": float("nan")}, {"corner": (2.0**62, 0.0, 0.0)}
    for change in (*wrong, {"corner": (0.0, float("nan"), 0.0)}, {"half": (1e300, 1.0, 1.0)}, {"radius": float("inf")}):
        with pytest.raises(ValueError, match="Collider: resolution or lengths out of bounds"):
            _core.Collider(**{**right, **change})


def test_an_enormous_body_that_turns_hits_the_voxel_that_it_sweeps_over() -> None:
    occupancy = Occupancy.from_keys([[0, 0, 0]], 1e-4)
    checker = NativeChecker(occupancy, Box((1e6, 1e-3, 1e-3)))  # 10¹⁰ voxels long
    start, end = torch.eye(4).unsqueeze(0), torch.eye(4).unsqueeze(0)
    start[0, 1, 3] = end[0, 1, 3] = 10.0  # passes over the voxel as it turns
    end[0, :2, :2] = torch.tensor([[0.0, -1.0], [1.0, 0.0]])
    assert checker.sweeps(start, end).item() and checker.free_fraction(start, end).item() < 1


def test_negated_views_give_correct_results_and_numpy_arrays_are_refused() -> None:
    checker = NativeChecker(Occupancy.from_keys([[0, 0, 0]], 1.0), Box((0.5, 0.5, 0.5)))
    points = torch.tensor([[3.0, 0.5, 0.5], [-7.0, 0.5, 0.5]])
    torch.testing.assert_close(checker.clearance(torch._neg_view(points)), checker.clearance(-points))
    poses = torch.eye(4).repeat(2, 1, 1)
    mirrored = -poses
    assert torch.equal(checker.collides(torch._neg_view(mirrored)), checker.collides(poses))
    for call in (checker.clearance, checker.collides):
        with pytest.raises(ValueError, match=r"expected a torch\.Tensor, got ndarray"):
            call(points.numpy())
    renderer, K = NativeRenderer(tiny_gaussians()), intrinsics(1.0, 8, 6)
    seen = renderer.pixels(Cameras(poses, K, 8, 6))
    assert torch.equal(renderer.pixels(Cameras(torch._neg_view(mirrored), K, 8, 6)), seen)


BAD = {
    "orthonormal rotation": lambda pose, K: pose[:3, :3].mul_(2),
    "orthonormal": lambda pose, K: pose[:3, :3].zero_(),
    "not a reflection": lambda pose, K: pose[0, :3].neg_(),
    "bottom row": lambda pose, K: pose[3].fill_(7),
    "finite numbers": lambda pose, K: pose[0, 3].fill_(float("nan")),
    "no skew": lambda pose, K: K[0, 1].fill_(0.5),
    "K.1.: expected finite values, positive": lambda pose, K: K[0, 0].fill_(-1),
    "a last row of 0, 0, 1": lambda pose, K: K[2].fill_(1),
}


@pytest.mark.parametrize("renderer", [NativeRenderer, ReferenceRenderer])
@pytest.mark.parametrize("message", BAD)
def test_cameras_that_cannot_be_drawn_are_refused(renderer: type, message: str) -> None:
    poses, K = torch.eye(4).repeat(2, 1, 1), intrinsics(1.0, 8, 6).repeat(2, 1, 1)
    drawn = renderer(tiny_gaussians())
    drawn.pixels(Cameras(poses, K, 8, 6))
    BAD[message](poses[1], K[1])
    with pytest.raises(ValueError, match=rf"\[1\]: expected.*{message}|{message}"):
        drawn.pixels(Cameras(poses, K, 8, 6))


@pytest.mark.parametrize("size", [(2**31, 1), (0, 4), (4, 65537), (4.0, 4), (True, 4)])
def test_an_image_size_that_is_no_valid_number_of_pixels_is_refused(size: tuple[int, int]) -> None:
    with pytest.raises(ValueError, match="expected a whole number of pixels from 1 to 65536, got"):
        Cameras(torch.eye(4).unsqueeze(0), intrinsics(1.0, 8, 6), *size)


@pytest.mark.parametrize("renderer", [NativeRenderer, ReferenceRenderer])
@pytest.mark.parametrize(
    ("field", "value", "message"),
    [
        ("opacities", 2.0, r"opacities\[3\]: expected a number from 0 to 1, got 2\.0"),
        ("opacities", float("nan"), r"opacities\[3\]: expected a number from 0 to 1"),
        ("quats", 0.0, r"quats\[3\]: expected a unit quaternion, got \[0\.0, 0\.0, 0\.0, 0\.0\]"),
        ("scales", 0.0, r"scales\[3\]: expected positive, finite numbers of metres"),
        ("means", float("inf"), r"means\[3\]: expected finite coordinates in metres"),
        ("sh", float("nan"), r"sh\[3\]: expected finite values"),
    ],
)
def test_gaussians_that_cannot_be_drawn_are_refused(renderer: type, field: str, value: float, message: str) -> None:
    gaussians = tiny_gaussians().clone()
    getattr(gaussians, field)[3] = value
    with pytest.raises(ValueError, match=rf"gaussians\.{message}"):
        renderer(gaussians)


@pytest.mark.parametrize(
    "again", [copy.deepcopy, lambda one: pickle.loads(pickle.dumps(one))], ids=["copied", "pickled"]
)
def test_copied_and_pickled_renderers_draw_the_same(again: object) -> None:
    renderer = NativeRenderer(tiny_gaussians(), antialiased=False, background=(0.1, 0.2, 0.3), threads=1, tolerance=0.5)
    cameras = Cameras(torch.eye(4).unsqueeze(0), intrinsics(1.0, 8, 6), 8, 6)
    expected = renderer.pixels(cameras)
    for one in (renderer, LatticeRenderer(renderer)):
        twin = again(one)  # type: ignore[operator]
        assert torch.equal(twin.pixels(cameras), expected)
    assert twin.renderer.threads == 1
