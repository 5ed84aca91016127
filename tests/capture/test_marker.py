"""A printed marker gives the scale, and the page to print it on is A4."""

import io
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from PIL import Image

from splatrl.capture import marker
from splatrl.capture.marker import MARKER_SIDE, find_markers, scale_by_corners, scale_by_marker, write_marker_page
from splatrl.capture.world import place
from tests.capture.walks import HEIGHT, WIDTH, K, strewn, walk

CORNERS = np.array([[-0.08, 0.08, 0.5], [0.08, 0.08, 0.5], [0.08, -0.08, 0.5], [-0.08, -0.08, 0.5]])
"""Corners of a marker on a table in the middle of the yard, world frame, metres."""


def sightings(noise: float) -> dict[int, np.ndarray]:
    """Return where each camera of the walk sees the corners, pixels, with noise."""
    generator = np.random.default_rng(0)
    seen = {}
    for image, pose in enumerate(walk().camera_to_world.numpy()):
        local = (CORNERS - pose[:3, 3]) @ pose[:3, :3] @ K.numpy().T
        seen[image] = local[:, :2] / local[:, 2:] + noise * generator.normal(size=(4, 2))
    return seen


@pytest.mark.parametrize("seed", range(3))
def test_corners_in_many_images_give_the_scale(seed: int) -> None:
    lying, transform = strewn(seed)
    found = scale_by_corners(lying, {7: sightings(0.3)}, MARKER_SIDE)
    assert found is not None and (found.markers, found.views) == (1, 40)
    assert found.metres_per_unit * np.cbrt(np.linalg.det(transform[:3, :3])) == pytest.approx(1.0, abs=0.01)
    assert 0.0 < found.error < 0.05


def test_markers_that_are_not_square_or_are_rarely_seen_give_no_scale() -> None:
    seen = sightings(0.1)
    assert scale_by_corners(walk(), {7: {image: seen[image] for image in (0, 5)}}, MARKER_SIDE) is None
    assert scale_by_corners(walk(), {}, MARKER_SIDE) is None
    bent = {image: corners * [1.0, 1.0] + [[0, 0], [9, 0], [0, 0], [0, 0]] for image, corners in seen.items()}
    assert scale_by_corners(walk(), {7: bent}, MARKER_SIDE) is None
    wrong = {image: np.roll(corners, image, 0) for image, corners in seen.items()}
    assert scale_by_corners(walk(), {7: wrong}, MARKER_SIDE) is None


def test_an_outlier_view_of_the_marker_is_left_out() -> None:
    seen = sightings(0.1)
    seen[4] = seen[4] + 40.0
    found = scale_by_corners(walk(), {7: seen}, MARKER_SIDE)
    assert found is not None and found.metres_per_unit == pytest.approx(1.0, abs=0.01)


def paper(cv2: object, seen: np.ndarray, scale: int) -> np.ndarray:
    """Return a ``scale`` times larger image of a marker on white paper, with its corners at ``scale * seen``."""
    cells = np.full((80, 80), 255, np.uint8)
    cells[10:70, 10:70] = marker._dictionary(cv2).generateImageMarker(7, 60)  # type: ignore[attr-defined, arg-type]
    source = np.array([[10, 10], [70, 10], [70, 70], [10, 70]], np.float32) - 0.5
    turn = cv2.getPerspectiveTransform(source, (scale * seen - 0.5).astype(np.float32))  # type: ignore[attr-defined]
    large = cv2.warpPerspective(cells, turn, (scale * WIDTH, scale * HEIGHT), borderValue=120)  # type: ignore[attr-defined]
    return np.asarray(large)


def test_a_marker_is_found_in_images_and_gives_the_scale(tmp_path: Path) -> None:
    cv2 = pytest.importorskip("cv2")
    scale, paths = 6, []
    for image, seen in list(sightings(0.0).items())[:8]:
        paths.append(tmp_path / f"{image}.png")
        Image.fromarray(paper(cv2, seen, scale)).save(paths[-1])
    larger = K.clone()
    larger[:2] *= scale
    lying, transform = strewn(3)
    few = replace(
        lying, paths=paths, width=scale * WIDTH, height=scale * HEIGHT, K=larger,
        camera_to_world=lying.camera_to_world[:8], seen_by=lying.seen_by[:0], seen_point=lying.seen_point[:0],
    )  # fmt: skip
    found = find_markers(paths)
    assert list(found) == [7] and len(found[7]) == 8
    for image, corners in found[7].items():
        assert np.abs(corners - scale * sightings(0.0)[image]).max() < 1.0
    told: list[tuple[str, int, int]] = []
    placed = place(few, progress=lambda *far: told.append(far))
    assert placed.scale_from == "marker" and told == [("markers", number, 8) for number in range(8)]
    metres = np.cbrt(np.linalg.det(placed.world_from_capture.numpy()[:3, :3] @ transform[:3, :3]))
    assert metres == pytest.approx(1.0, abs=0.01)


def test_images_without_a_marker_give_no_scale(tmp_path: Path) -> None:
    pytest.importorskip("cv2")
    grain = np.random.default_rng(0).integers(0, 255, (HEIGHT, WIDTH), dtype=np.uint8)
    Image.fromarray(grain).save(tmp_path / "grain.png")
    assert scale_by_marker(replace(walk(), paths=[tmp_path / "grain.png"] * 3)) is None


def test_the_marker_page_is_a4_and_impossible_markers_are_refused(tmp_path: Path) -> None:
    pytest.importorskip("cv2")
    write_marker_page(tmp_path / "marker.pdf")
    content = (tmp_path / "marker.pdf").read_bytes()
    assert content.startswith(b"%PDF") and len(re.findall(rb"/Type /Page\b", content)) == 1
    box = content.split(b"/MediaBox [")[1].split(b"]")[0].split()
    assert [float(value) / 72 * 25.4 for value in box[2:]] == pytest.approx([210.0, 297.0], abs=0.2)
    with pytest.raises(ValueError, match="marker: expected a number from 0 to 49, got 50"):
        write_marker_page(tmp_path / "x.pdf", 50)
    with pytest.raises(ValueError, match=r"side: expected 0\.02 to 0\.18 m, so that it fits an A4 page, got 0\.5"):
        write_marker_page(tmp_path / "x.pdf", 0, 0.5)


@pytest.mark.parametrize(("number", "side"), [(0, MARKER_SIDE), (3, 0.05)])
def test_the_printed_marker_has_the_stated_side(number: int, side: float, tmp_path: Path) -> None:
    pytest.importorskip("cv2")
    write_marker_page(tmp_path / "marker.pdf", number, side)
    content = (tmp_path / "marker.pdf").read_bytes()
    page = Image.open(io.BytesIO(content[content.index(b"\xff\xd8\xff") :]))  # a JPEG that fills the page
    page.save(tmp_path / "page.png")
    ((found, seen),) = find_markers([tmp_path / "page.png"]).items()
    sides = np.linalg.norm(seen[0] - np.roll(seen[0], 1, 0), axis=1)
    assert found == number and sides * 0.210 / page.width == pytest.approx(side, abs=0.0005)


def test_the_error_without_opencv_says_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(__import__("sys").modules, "cv2", None)
    with pytest.raises(ImportError, match=r"pip install 'splatrl\[capture\]'"):
        place(walk())
    assert torch.isfinite(place(walk(), marker=None).reconstruction.points).all()
