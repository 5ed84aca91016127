"""The messages that visitors of the page receive: splats, layers, handles and keys."""

import threading
from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np
import pytest
import torch

from splatrl.collision.point_clouds import write_points
from splatrl.envs.tasks.base import Outcome
from splatrl.envs.world import World
from splatrl.scenes import Scene
from splatrl.scenes.description import read_description
from splatrl.viewer.driving import Driving
from splatrl.viewer.markdown import plain
from splatrl.viewer.page import Page
from splatrl.viewer.placing import Placing
from splatrl.viewer.robot import BLUE, tone, wedge
from splatrl.viewer.splats import BYTES, WIDER, Splats, parts_of
from splatrl.viewer.takes import Takes
from tests.tiny import tiny_gaussians
from tests.viewer.visitor import Visitor, until

Visit = Callable[[], Visitor]
VALUES = {
    "goal": [0.5, 1.0, 0.0],
    "object": [0.75, 1.0, 0.5],
    "walk": [[-1.0, -1.5], [1.0, 1.5]],
    "bounds": [[-1.7, -2.2, -0.1], [1.7, 2.2, 1.3]],
}


def test_each_visitor_is_sent_the_splats(page: Page, visit: Visit) -> None:
    for _ in range(2):
        visitor = visit()
        splats = visitor.find("GaussianSplatsMessage")
        assert splats["name"] == "/splats/0"
        until(lambda: visitor.bytes > BYTES * len(page.scene.gaussians), "all of the splats")  # noqa: B023
    assert page.bytes == BYTES * len(page.scene.gaussians)


def test_a_wider_render_is_requested_so_that_splats_hide_only_what_is_behind_them(visit: Visit) -> None:
    asked = visit().find("GetRenderRequestMessage")
    assert (asked["height"], asked["width"]) == (300, 400 + WIDER)


@pytest.mark.parametrize(
    ("size", "sky", "near", "far"),
    [
        (0.01, 1.0, 4.4e-5, 1000.0),
        (1.0, 1.0, 4.4e-3, 1000.0),
        (1000.0, 1.0, 0.01, 13200.0),
        (1.0, 2500.0, 4.4e-3, 7500),
    ],
)
def test_the_camera_sees_all_of_small_and_large_scenes(size: float, sky: float, near: float, far: float) -> None:
    gaussians = tiny_gaussians()
    gaussians.means *= size
    gaussians.means[0] = torch.tensor([0.0, 0.6, 0.8]) * sky
    (x, y, z), (far_x, far_y, far_z) = ((size * at for at in corner) for corner in VALUES["bounds"])
    page = Page(Scene("room", gaussians, ((x, y, z), (far_x, far_y, far_z))), port=0)
    camera = page.server.initial_camera
    assert (camera.near, camera.far) == pytest.approx((near, far), rel=1e-3)
    page.close()


def test_large_scenes_are_sent_in_parts(world: World, visit: Visit, page: Page) -> None:
    splats = Splats(page.server, parts_of(page.scene.gaussians, first=40))
    visitor = visit()
    for number in range(3):
        visitor.find("GaussianSplatsMessage", lambda m: m["name"] == f"/splats/{number}")  # noqa: B023
    assert splats.counts == [40, 120, len(page.scene.gaussians)]


def test_a_visitor_can_choose_to_draw_fewer_splats(visit: Visit, page: Page) -> None:
    page.splats = Splats(page.server, parts_of(page.scene.gaussians, first=40))
    page._offer_fewer()
    visitor = visit()
    visitor.find("GaussianSplatsMessage", lambda m: m["name"] == "/splats/2")
    visitor.click("splats drawn", "40")
    for number in (1, 2):
        visitor.find("RemoveSceneNodeMessage", lambda m: m["name"] == f"/splats/{number}")  # noqa: B023
    assert not [m for m in visitor.messages if m["type"] == "RemoveSceneNodeMessage" and m["name"] == "/splats/0"]
    before = len(visitor.messages)
    visitor.click("splats drawn", "120")
    again = until(lambda: [m for m in visitor.messages[before:] if m["type"] == "GaussianSplatsMessage"], "a part")
    assert [m["name"] for m in again] == ["/splats/1"]
    late = visit()
    late.find("GaussianSplatsMessage", lambda m: m["name"] == "/splats/1")
    assert not [m for m in late.messages if m.get("name") == "/splats/2"]


def test_a_slow_browser_gets_no_more_splats_until_it_asks(page: Page, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("splatrl.viewer.splats.SLOW", 0.0)
    page.splats = Splats(page.server, parts_of(page.scene.gaussians, first=40))  # beside those sent in one part
    page._offer_fewer()
    visitor = Visitor(page.address)
    until(lambda: len([m for m in visitor.messages if m["type"] == "GetRenderRequestMessage"]) == 4, "pictures")
    visitor.click("splats drawn", f"{len(page.scene.gaussians):,}")
    visitor.find("GaussianSplatsMessage", lambda m: m["name"] == "/splats/2")
    assert len([m for m in visitor.messages if m["type"] == "GetRenderRequestMessage"]) == 4
    visitor.close()


def test_layers_are_sent_on_request(page: Page, world: World, visit: Visit, tmp_path: Path) -> None:
    page.show_occupancy(world.occupancy)
    page.show_free(world.plan)
    page.show_path(tmp_path)
    write_points(tmp_path / "path.ply", np.array([[0, 0, 1], [1, 0, 1]], np.float32))
    page.show_path(tmp_path)
    visitor = visit()
    visitor.find("LineSegmentsMessage", lambda m: m["name"] == "/camera path")
    visitor.field("free space at the robot's height")
    assert not [m for m in visitor.messages if m["type"] in ("MeshMessage", "PointCloudMessage")]
    visitor.click("solid")
    assert visitor.find("MeshMessage")["name"] == "/solid"
    visitor.click("free space at the robot's height")
    assert visitor.find("PointCloudMessage")["name"] == "/free"
    visitor.click("solid", False)
    visitor.find("SetSceneNodeVisibilityMessage", lambda m: m["name"] == "/solid" and m["visible"] is False)


def test_a_key_moves_the_robot_and_shows_what_it_sees(page: Page, world: World, visit: Visit) -> None:
    driving = Driving(page, world, seed=2)
    visitor = visit()
    visitor.find("RunJavascriptMessage")
    before = driving.driver.state.clone()
    visitor.press("+spin")
    until(lambda: "step 1 · return -0.2 · running" in driving.status.content, "a step")
    assert (driving.driver.state - before)[0].abs().tolist()[:2] == [0, 0]
    assert not torch.equal(driving.driver.state, before)
    assert np.array_equal(driving.shown.frustum.image, driving.driver.pixels.numpy())
    assert driving.shown.frustum.scale == wedge(world.robot).max()
    visitor.click("restart from the same start (R)")
    until(lambda: torch.equal(driving.driver.state, before), "the start")


def test_the_page_says_how_an_episode_ended(page: Page, world: World) -> None:
    driving = Driving(page, world)
    while not driving.driver.done:
        assert driving.press("I")
    words = driving.driver.outcome.name.replace("_", " ").lower()
    assert f"**{words}**, any key starts another episode" in driving.status.content
    assert driving.driver.outcome in (Outcome.COLLISION, Outcome.OUT_OF_BOUNDS)
    assert driving.shown.body.color == tone(driving.driver.outcome) != BLUE
    assert driving.press("N") and "step 0" in driving.status.content


def test_key_presses_wait_for_the_robot_in_order_and_only_those_beyond_the_queue_are_dropped(
    page: Page, world: World
) -> None:
    driving, done = Driving(page, world), list[str]()
    keys = "UOUUOOUO"
    driving.keys = {key: partial(done.append, key) for key in keys}
    with driving._busy:  # as if the robot were moving
        waiting = [threading.Thread(target=driving.press, args=(key,)) for key in keys]
        for number, thread in enumerate(waiting, 1):
            thread.start()
            until(lambda: driving._waiting.qsize() == number, "the key that waits")  # noqa: B023
        assert not driving.press("O")
    for thread in waiting:
        thread.join(timeout=20.0)
    assert "".join(done) == keys


def test_driving_ends_once_enough_episodes_are_kept(page: Page, world: World, tmp_path: Path) -> None:
    takes = Takes(world, tmp_path, {})
    driving = Driving(page, world, 0, takes, 2)

    def show() -> None:
        while not driving.driver.done:
            best = world.plan.optimal(driving.driver.state)[0].nonzero()[0, 0]
            assert driving.press(list(driving.keys)[int(best)])

    show()
    assert len(takes.episodes) == 1 and "kept 1 of 2" in driving.status.content
    assert driving.press("X")  # discards the episode
    assert takes.episodes == [] and not driving.finished.is_set()
    show()
    assert driving.press("N")
    driving.press("U")
    assert driving.press("X")  # discards the running episode; the one before is kept
    assert len(takes.episodes) == 1
    while not driving.driver.done:
        assert driving.press("I")
    assert not driving.driver.succeeded
    assert driving.press("X")  # a failed episode was not kept, so there is nothing to discard
    assert len(takes.episodes) == 1 and driving.driver.steps == 0
    show()
    assert driving.finished.is_set() and len(takes.episodes) == 2
    assert driving.press("X")  # the recording has ended
    assert len(takes.episodes) == 2


def test_a_dragged_goal_is_saved(page: Page, world: World, visit: Visit, folder: Path) -> None:
    placing = Placing(page, world, VALUES, folder)
    visitor = visit()
    before = (folder / "scene.yaml").read_text()
    seen = placing.view.image.copy()
    visitor.drag("/place/goal", (-0.5, 1.25, 0.5), (0.7071068, 0.0, 0.0, 0.7071068))
    until(lambda: placing.values["goal"] == [-0.5, 1.25, 90.0], "the drag")
    until(lambda: not np.array_equal(placing.view.image, seen), "what is seen there")
    visitor.drag("/place/walk_1", (1.6, 1.5, 0.5))
    until(lambda: placing.values["walk"] == [[-1.0, -1.5], [1.5, 1.5]], "the drag")
    assert (folder / "scene.yaml").read_text() == before
    visitor.click("save to scene.yaml")
    until(lambda: placing.status.content == "saved goal, walk", "the file")
    expected = before.replace("[0.5, 1.0, 0.0]", "[-0.5, 1.25, 90.0]")
    assert (folder / "scene.yaml").read_text() == expected.replace("[1.0, 1.5]]", "[1.5, 1.5]]")
    assert placing.save() and placing.status.content == "nothing to save"


def test_a_typed_goal_moves_its_handle(page: Page, world: World, visit: Visit, folder: Path) -> None:
    placing = Placing(page, world, VALUES, folder)
    seen = placing.view.image.copy()
    visit().click("goal: x, y (m), yaw (°)", "-0.25, 0.5, 180")
    until(lambda: placing.values["goal"] == [-0.25, 0.5, 180.0], "the goal")
    assert placing.controls["goal"].position.tolist() == [-0.25, 0.5, 0.5]
    until(lambda: not np.array_equal(placing.view.image, seen), "what is seen there")


def test_corners_are_typed_beside_their_handles(page: Page, world: World, visit: Visit, folder: Path) -> None:
    placing, visitor = Placing(page, world, VALUES, folder), visit()
    assert not placing.fields["bounds 0"].visible
    visitor.click("move bounds")
    until(lambda: placing.fields["bounds 0"].visible and placing.controls["bounds 0"].visible, "the handle")
    assert not placing.fields["walk 0"].visible
    visitor.click("bounds 0: x, y, z (m)", "-0.5 -2.2 -0.1")
    until(lambda: placing.values["bounds"][0] == [-0.5, -2.2, -0.1], "the corner")
    assert placing.controls["bounds 0"].position.tolist() == [-0.5, -2.2, -0.1]
    assert page._bounds.points[..., 0].min() == -0.5


def test_a_dragged_handle_is_followed_by_its_field(page: Page, world: World, visit: Visit, folder: Path) -> None:
    placing = Placing(page, world, VALUES, folder)
    visit().drag("/place/goal", (-0.5, 1.25, 0.5), (0.7071068, 0.0, 0.0, 0.7071068))
    until(lambda: placing.fields["goal"].value == "-0.5, 1.25, 90", "the field")


def test_a_text_that_cannot_be_read_stays_while_it_is_typed_and_is_not_saved(
    page: Page, world: World, visit: Visit, folder: Path
) -> None:
    placing, visitor = Placing(page, world, VALUES, folder), visit()
    before = (folder / "scene.yaml").read_text()
    visitor.click("goal: x, y (m), yaw (°)", "-0,5")  # as 0.5 is written in many countries
    until(lambda: placing.values["goal"] != VALUES["goal"] or "expected" in placing.status.content, "an answer")
    assert placing.status.content == plain("goal: expected 3 numbers such as -0.5, 1.25, 90, got -0,5")
    assert placing.fields["goal"].value == "-0,5"
    assert not placing.save()
    assert placing.status.content.startswith(f"**not saved**: {plain('goal: expected 3 numbers')}")
    assert (folder / "scene.yaml").read_text() == before


def test_invalid_values_are_reported_and_not_saved(page: Page, world: World, folder: Path) -> None:
    from splatrl.viewer.place import Handle

    def refuse(stated: object) -> None:
        raise ValueError("task.goal: expected a point in the walkable area")

    placing = Placing(page, world, VALUES, folder, refuse)
    before = (folder / "scene.yaml").read_text()
    placing.drag(Handle("goal", (0.0, 0.0, 0.5)))
    assert "a robot would collide at the goal" in placing.status.content
    assert not placing.save()
    assert placing.status.content == f"**not saved**: {plain('task.goal: expected a point in the walkable area')}"
    placing.drag(Handle("bounds 1", (-5.0, 2.0, 1.0)))
    assert not placing.save() and "expected lower below upper along x" in placing.status.content
    assert (folder / "scene.yaml").read_text() == before
    assert read_description(folder)["goal"] == [0.5, 1.0, 0.0]


def test_changes_by_others_in_the_meantime_are_not_overwritten(page: Page, world: World, folder: Path) -> None:
    from splatrl.viewer.place import Handle

    placing, path = Placing(page, world, VALUES, folder), folder / "scene.yaml"
    placing.drag(Handle("goal", (0.25, 1.0, 0.5)))
    assert placing.save()
    placing.drag(Handle("goal", (0.0, 1.0, 0.5)))
    path.write_text(path.read_text().replace("[0.25, 1.0, 0.0]", "[-0.5, 1.0, 0.0]"))
    assert not placing.save()
    told = "scene.yaml has been changed in the meantime (goal: [-0.5, 1.0, 0.0]); start splatrl-view"
    assert plain(told) in placing.status.content
    assert read_description(folder)["goal"] == [-0.5, 1.0, 0.0]


def test_a_drag_to_a_position_that_is_not_finite_is_ignored(page: Page, world: World, folder: Path) -> None:
    from splatrl.viewer.place import Handle

    placing = Placing(page, world, VALUES, folder)
    for name in ("goal", "walk 0"):
        placing.drag(Handle(name, (float("nan"), float("inf"), 0.0)))
    assert placing.values == placing.saved


def test_without_a_folder_nothing_is_saved(page: Page, world: World) -> None:
    placing = Placing(page, world, VALUES)
    assert placing.button.disabled and not placing.save()
    assert "Only scenes in a folder" in placing.status.content
