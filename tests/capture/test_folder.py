"""A capture's folder is a scene that is ready for training, written completely or not at all, with a report."""

import re
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from PIL import Image

from splatrl.building import build_trainer, build_world
from splatrl.capture import folder as folder_module
from splatrl.capture.area import survey_area
from splatrl.capture.base import CaptureError
from splatrl.capture.check import Quality
from splatrl.capture.folder import problems, write_scene
from splatrl.capture.suggestions import NOTHING, seen_by_cameras, seen_in_splat, suggest, thing_size
from splatrl.capture.walkable import walkable_area
from splatrl.capture.world import Placed
from splatrl.collision.occupancy import Occupancy
from splatrl.collision.point_clouds import read_points
from splatrl.configuration import load_config
from splatrl.scenes import read_scene
from splatrl.scenes.description import PATH, read_description
from splatrl.scenes.scene import Scene, robust_bounds
from tests.capture.rooms import ABOVE, CAMERAS, HAZE, tiny_capture, with_haze
from tests.scenes.places import place
from tests.tiny import tiny_gaussians

HELD_OUT = range(3, CAMERAS, 8)
FILES = {"splat.ply", "scene.yaml", "report.html", "held_out.png", "map.png", "goals.png", "cameras.png", "path.ply"}
SMALL = [
    "device=cpu",
    "robot.image_width=16",
    "robot.image_height=12",
    "network.pool=1",
    "robot.body.size=[0.2,0.2,0.2]",
    "collector.total_frames=256",
    "collector.frames_per_batch=128",
    "env.num_envs=16",
    "logger.video=false",
    "logger.num_test_episodes=8",
]


@pytest.fixture(scope="module")
def written(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Placed, Quality]:
    """The folder of a good capture, the capture itself, and its quality."""
    folder = tmp_path_factory.mktemp("written")
    placed = replace(tiny_capture(folder / "images"), scale_error=0.1234, up_error_deg=6.585204)
    return folder / "garden", placed, write_scene(folder / "garden", tiny_gaussians(), placed, HELD_OUT)


def test_a_policy_trains_in_a_written_folder_without_further_scene_settings(
    written: tuple[Path, Placed, Quality], tmp_path: Path
) -> None:
    folder, _, quality = written
    assert {file.name for file in folder.iterdir()} == FILES
    assert quality.path_free == 1.0
    stated = read_description(folder)
    assert stated["metric"] is True and stated["robot_height"] == ABOVE and stated["quality"]["psnr"] > 50
    np.testing.assert_allclose(read_scene(folder).gaussians.means, tiny_gaussians().means, atol=1e-6)
    cfg = load_config([f"scene={folder}/", *SMALL])
    world = build_world(cfg)
    assert len(world.plan.start_rows) > 50, "most free poses lead to the goal"
    build_trainer(cfg, world, tmp_path / "run").fit()
    assert (tmp_path / "run" / "checkpoints" / "last.pt").is_file()


def test_a_written_folder_holds_the_path_of_the_camera(written: tuple[Path, Placed, Quality]) -> None:
    folder, placed, _ = written
    walk = placed.reconstruction.camera_to_world[:, :3, 3]
    np.testing.assert_allclose(read_points(folder / PATH), walk, atol=1e-6)


def test_haze_is_listed_in_the_folder_and_is_not_solid_to_robots(tmp_path: Path) -> None:
    folder = tmp_path / "hazy"
    write_scene(folder, with_haze(), tiny_capture(tmp_path / "images"), HELD_OUT)
    assert {file.name for file in folder.iterdir()} == FILES | {"free.ply"}
    assert read_description(folder)["free"] == "free.ply"
    place = torch.tensor([HAZE])
    assert not build_world(load_config([f"scene={folder}/", *SMALL])).occupancy.contains(place).any()
    stated = (folder / "scene.yaml").read_text().replace('free: "free.ply"', "free: null")
    (folder / "scene.yaml").write_text(stated)
    assert build_world(load_config([f"scene={folder}/", *SMALL])).occupancy.contains(place).all()


def test_suggested_goals_are_free_walkable_and_face_near_things_and_the_object_is_free(tmp_path: Path) -> None:
    placed = tiny_capture(tmp_path)
    area = survey_area(tiny_gaussians(), placed)
    found = suggest(seen_by_cameras(placed), area)
    assert 1 <= len(found.goals) <= 4 and found.thing is not None
    places = torch.tensor([[x, y, area.robot_height] for x, y, _ in found.goals] + [list(found.thing)])
    assert not area.occupancy.contains(places).any()
    (x0, y0), (x1, y1) = area.walk
    assert all(x0 <= x <= x1 and y0 <= y <= y1 for x, y, _ in found.goals)
    for x, y, yaw in found.goals:
        away = placed.reconstruction.points.numpy()[:, :2] - [x, y]
        turns = np.degrees(np.arctan2(*away.T[::-1])) - yaw
        near = np.linalg.norm(away, axis=1) < 2.5
        ahead, behind = (near & (np.abs((turns - back + 180) % 360 - 180) < 35) for back in (0, 180))
        assert ahead.sum() > 2 * behind.sum()
        colors = placed.reconstruction.colors.numpy()
        assert colors[ahead].std(0).sum() > colors[behind].std(0).sum()
    for (low, high), first, last in zip(zip(*area.walk, strict=True), *area.bounds, strict=False):
        assert first < low < high < last
        assert (high - low) / 0.2 == pytest.approx(round((high - low) / 0.2))


def test_a_scale_and_an_upward_direction_of_unknown_error_are_reported(tmp_path: Path) -> None:
    placed = replace(tiny_capture(tmp_path / "images"), scale_from="camera_height", scale_error=None)
    placed = replace(placed, up_from="cameras", up_error_deg=None)
    quality = write_scene(tmp_path / "garden", tiny_gaussians(), placed, HELD_OUT)
    assert any(problem.startswith("Its scale may be far off") for problem in quality.problems)
    assert any("because neither floor nor walls tell it clearly: it may be off by any" in p for p in quality.problems)
    stated = read_description(tmp_path / "garden")["quality"]
    assert stated["scale_error"] is None and stated["up_error_deg"] is None
    page = (tmp_path / "garden" / "report.html").read_text(encoding="utf-8")
    assert "camera height, error unknown" in page and "cameras, error unknown" in page


def test_no_goal_is_suggested_where_nothing_is_free(tmp_path: Path) -> None:
    placed = tiny_capture(tmp_path / "images")
    solid = survey_area(tiny_gaussians(), placed).occupancy.with_boxes([[-2.0, -2.0, 0.0]], [[2.0, 2.0, 1.0]])
    found = suggest(seen_by_cameras(placed), replace(survey_area(tiny_gaussians(), placed), occupancy=solid))
    assert found.goals == [] and found.thing is None


def test_the_report_is_one_static_page_that_says_what_went_wrong(tmp_path: Path) -> None:
    placed = replace(tiny_capture(tmp_path / "images"), scale_from="unknown", scale_error=None, up_from="cameras")
    folder = tmp_path / "a <b> & c"
    write_scene(folder, tiny_gaussians(), placed, notes=["The end of the video broke off."])
    page = (folder / "report.html").read_text(encoding="utf-8")
    for words in (
        "It is not metric",
        "The up direction comes from how",
        "No image was held out",
        "The end of the video broke off.",
    ):
        assert words in page
    assert "a &lt;b&gt; &amp; c" in page and "<b>" not in page and "<script" not in page
    pictures = re.findall(r'src="([^"]+)"', page)
    assert pictures == ["map.png", "goals.png", "cameras.png"] and all((folder / file).is_file() for file in pictures)
    with pytest.warns(UserWarning, match="not metric"):
        assert read_scene(folder).name == "a <b> & c"


@pytest.mark.usefixtures("bare_report")
def test_moving_things_are_pictured_and_mentioned_in_the_report(tmp_path: Path) -> None:
    folder, placed = tmp_path / "garden", tiny_capture(tmp_path / "images")
    moving = torch.zeros(CAMERAS, 32, 48, dtype=torch.bool)
    moving[5, 8:24, 12:36] = True  # a quarter of one image of 24
    few = write_scene(folder, tiny_gaussians(), placed, HELD_OUT, moving=moving)
    assert "1 % of the image area shows moving things and was masked out" in (folder / "report.html").read_text()
    page = np.asarray(Image.open(folder / "moving.png")).astype(int)
    assert page.shape[0] == 320, "the picture has one image, the only one with a moving thing"
    red = (page[..., 0] > page[..., 1] + 60).reshape(page.shape[0], 2, -1).mean((0, 2))
    assert red.max() > 0.02 and red.min() < 0.005
    moving[1:8] = moving[5]
    many = write_scene(folder, tiny_gaussians(), placed, HELD_OUT, force=True, moving=moving)
    told = [[problem for problem in quality.problems if "move fill" in problem] for quality in (few, many)]
    assert not told[0] and "move fill 7.3 % of the image area" in told[1][0]
    write_scene(folder, tiny_gaussians(), placed, HELD_OUT, force=True)
    assert not (folder / "moving.png").exists()


def test_the_report_on_a_good_capture_lists_no_problems(written: tuple[Path, Placed, Quality]) -> None:
    page = (written[0] / "report.html").read_text(encoding="utf-8")
    assert "Problems and notes" not in page and "recorded, within 12 %" in page and "recorded, within 6.6°" in page
    stated = read_description(written[0])["quality"]
    assert (stated["scale_error"], stated["up_error_deg"]) == (0.12, 6.6)


def test_images_that_are_rendered_poorly_are_mentioned_by_the_figure_that_decides(
    written: tuple[Path, Placed, Quality],
) -> None:
    _, placed, quality = written
    poor = replace(quality, psnr=17.6, psnr_corrected=18.58)
    assert any("at only 18.6 dB, colours corrected:" in problem for problem in problems(placed, NOTHING, poor))


def test_gps_positions_that_do_not_give_the_scale_are_mentioned(written: tuple[Path, Placed, Quality]) -> None:
    _, placed, quality = written
    for gps, told in ((None, False), (torch.zeros(2, 2), True)):
        without = replace(placed, scale_from="unknown", reconstruction=replace(placed.reconstruction, gps=gps))
        assert any("GPS" in problem for problem in problems(without, NOTHING, quality)) == told


def test_a_scale_that_is_hardly_carried_on_is_the_first_problem(written: tuple[Path, Placed, Quality]) -> None:
    _, placed, quality = written
    ways = torch.full((CAMERAS,), 0.05, dtype=torch.float64)
    film = replace(placed.reconstruction, seconds=torch.arange(CAMERAS, dtype=torch.float64), carried=ways)
    assert "may differ in scale" in problems(replace(placed, reconstruction=film), NOTHING, quality)[0]


def test_a_folder_is_written_completely_or_not_at_all(
    written: tuple[Path, Placed, Quality], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    placed, folder = written[1], tmp_path / "garden"
    broken = replace(placed, reconstruction=replace(placed.reconstruction, width=1))
    with pytest.raises(CaptureError):
        write_scene(folder, tiny_gaussians(), broken, HELD_OUT)
    assert list(tmp_path.iterdir()) == []
    shutil.copytree(written[0], folder)
    before = {file.name: file.read_bytes() for file in folder.iterdir()}
    with pytest.raises(FileExistsError, match=r"scene\.yaml: already exists"):
        write_scene(folder, tiny_gaussians(), placed, HELD_OUT)

    def stop(*_: object, **__: object) -> None:
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr(folder_module, "write_description", stop)
        with pytest.raises(KeyboardInterrupt):
            write_scene(folder, tiny_gaussians(), placed, HELD_OUT, force=True)
    assert {file.name: file.read_bytes() for file in folder.iterdir()} == before
    (folder / "mine.txt").write_text("kept")
    write_scene(folder, tiny_gaussians(), placed, HELD_OUT, force=True)
    after = {file.name: file.read_bytes() for file in folder.iterdir()}
    assert after == {**before, "mine.txt": b"kept"}, "the same bytes again, and other files are kept"
    assert [file.name for file in tmp_path.iterdir()] == ["garden"]


def test_a_compressed_splat_replaces_the_uncompressed_one(
    written: tuple[Path, Placed, Quality], tmp_path: Path
) -> None:
    placed, folder = written[1], shutil.copytree(written[0], tmp_path / "garden")
    quality = write_scene(folder, tiny_gaussians(), placed, HELD_OUT, force=True, splat="splat.spz")
    assert {file.name for file in folder.iterdir()} == FILES - {"splat.ply"} | {"splat.spz"}
    assert quality.psnr is not None and 25 < quality.psnr < 50, "the quality is that of the rounded splat"
    scene = read_scene(folder)
    np.testing.assert_allclose(scene.gaussians.means, tiny_gaussians().means, atol=2**-12)
    assert read_description(folder)["quality"]["psnr"] == pytest.approx(quality.psnr, abs=0.01)


def test_a_large_place_gets_larger_steps_and_voxels(tmp_path: Path) -> None:
    placed = tiny_capture(tmp_path)
    larger = replace(placed.reconstruction)
    larger.camera_to_world[:, :2, 3] *= 10
    larger.points[:, :2] *= 10
    area = survey_area(tiny_gaussians(), replace(placed, reconstruction=larger))
    assert area.step is not None and area.occupancy.resolution > 0.05
    sides = np.subtract(area.walk[1], area.walk[0])
    assert sides / area.step == pytest.approx(np.round(sides / area.step)) and (sides / area.step).max() <= 41


def test_no_picture_of_a_capture_is_blank(written: tuple[Path, Placed, Quality]) -> None:
    for file in written[0].glob("*.png"):
        with Image.open(file) as image:
            assert np.asarray(image.convert("L"), float).std() > 10, file.name


def test_in_a_splat_without_cameras_robots_walk_around_the_most_open_place(tmp_path: Path) -> None:
    gaussians = place("courtyard", spacing=0.6)
    scene = Scene("yard", gaussians, robust_bounds(gaussians))
    coarse = Occupancy.from_gaussians(gaussians, 0.25)
    area = walkable_area(scene, coarse, 0.0, 1.2)
    assert area is not None and area.robot_height == 1.2 and area.step == 0.4
    lower, upper = np.array(area.walk)
    assert ((upper - lower) > 8.0).all() and (np.abs([lower, upper]) < [20.0, 15.0]).all()
    found = suggest(seen_in_splat(gaussians), area)
    assert found.goals and found.thing is not None and thing_size(area) == 0.64
    for x, y, _ in found.goals:
        assert (lower <= [x, y]).all() and (upper >= [x, y]).all()
    assert walkable_area(scene, Occupancy.empty(0.25), 0.0, 1.2) is None  # no floor


def test_the_report_says_how_much_of_the_floor_steps_do_not_reach(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("splatrl.capture.lattice.FEW", -1.0)  # even nothing is much
    quality = write_scene(tmp_path / "garden", tiny_gaussians(), tiny_capture(tmp_path / "images"))
    assert quality.problems[-1].startswith("0 % of the free floor cannot be reached in steps of 0.2 m")
    assert quality.problems[-1] in (tmp_path / "garden" / "report.html").read_text(encoding="utf-8")
