"""The page in a real Chromium, which draws in software: ``pytest -m slow tests/viewer/test_browser.py``.

Needs ``pip install playwright`` and a Chromium: that of the system, or ``playwright install chromium``.
"""

import io
import os
import shutil
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from numpy.typing import NDArray
from PIL import Image

from splatrl.envs.world import World
from splatrl.scenes import Scene
from splatrl.scenes.description import read_description
from splatrl.viewer.driving import Driving
from splatrl.viewer.markdown import plain
from splatrl.viewer.page import Page
from splatrl.viewer.placing import Placing
from tests.viewer.test_page import VALUES
from tests.viewer.visitor import until

if TYPE_CHECKING:
    from playwright.sync_api import Page as Tab

playwright = pytest.importorskip("playwright.sync_api", reason="needs playwright")
pytestmark = pytest.mark.slow
SOFTWARE = ["--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--ignore-gpu-blocklist"]
PATIENCE = 120_000
"""Timeout in milliseconds for a browser without a GPU on a busy machine."""


@pytest.fixture(scope="module")
def chromium() -> Iterator[Any]:
    with playwright.sync_playwright() as running:
        own = os.environ.get("SPLATRL_CHROMIUM") or shutil.which("chromium") or shutil.which("google-chrome")
        try:
            browser = running.chromium.launch(executable_path=own, args=SOFTWARE)
        except playwright.Error as error:
            pytest.skip(f"needs a Chromium: {str(error).splitlines()[0]}")
        yield browser
        browser.close()


@pytest.fixture
def tab(chromium: Any) -> Iterator["Tab"]:
    opened = chromium.new_page(viewport={"width": 900, "height": 560})
    opened.set_default_timeout(PATIENCE)
    yield opened
    opened.close()


def picture(tab: "Tab") -> NDArray[np.int64]:
    """Take a screenshot of the page without its panel and notes: [H, W, 3]."""
    image = Image.open(io.BytesIO(tab.screenshot(timeout=PATIENCE))).convert("RGB")
    return np.asarray(image, np.int64)[220:, :480]


def wait(tab: "Tab", holds: Callable[[], Any], what: str) -> Any:
    """Wait for a result that is true, while the browser keeps running, and return it."""

    def now() -> Any:
        tab.wait_for_timeout(100)
        return holds()

    return until(now, what, PATIENCE / 1000)


def drawn(tab: "Tab") -> NDArray[np.int64]:
    """Wait until the page is not blank, and return a screenshot."""
    wait(tab, lambda: picture(tab).std() > 20, "a picture that is not blank")
    return picture(tab)


def test_the_page_draws_the_splats(tab: "Tab", page: Page) -> None:
    tab.goto(page.address)
    before = drawn(tab)
    assert len(np.unique(before.reshape(-1, 3), axis=0)) > 1000
    tab.get_by_label("splats", exact=True).uncheck()
    wait(tab, lambda: picture(tab).std() < before.std() / 2, "a picture without splats")


def test_an_object_in_front_of_the_splats_is_visible(tab: "Tab", page: Page) -> None:
    page.server.scene.add_icosphere("/ball", 0.3, (255, 0, 255), position=(0.0, 0.0, 1.5))
    tab.goto(page.address)
    drawn(tab)
    wait(tab, lambda: ((picture(tab) - (230, 30, 230)).__abs__().max(-1) < 60).sum() > 200, "a ball over the splats")


def test_a_key_an_arrow_and_a_button_move_the_robot(tab: "Tab", page: Page, world: World) -> None:
    driving = Driving(page, world, seed=2)
    tab.goto(page.address)
    tab.get_by_text("step 0").wait_for()
    for act in (
        lambda: tab.keyboard.press("u"),
        lambda: tab.keyboard.press("o"),
        lambda: tab.get_by_role("button", name="+spin (U)").click(),
    ):
        steps = driving.driver.steps
        act()
        wait(tab, lambda: driving.driver.steps == steps + 1, "a step")  # noqa: B023
        tab.get_by_text(f"step {steps + 1}").wait_for()
    tab.get_by_label("bounds", exact=True).check()
    steps = driving.driver.steps
    tab.keyboard.press("u")
    wait(tab, lambda: driving.driver.steps == steps + 1, "a step with a ticked box")
    before, camera = driving.driver.state.clone(), page.server.get_clients()
    places = [client.camera.position.tolist() for client in camera.values()]
    tab.keyboard.press("ArrowUp")
    wait(tab, lambda: driving.driver.steps == steps + 2, "a step by an arrow")
    assert driving.driver.done or driving.driver.state.tolist() != before.tolist()
    assert [client.camera.position.tolist() for client in camera.values()] == places  # arrows move only the robot


def test_numbers_typed_key_by_key_are_saved(tab: "Tab", page: Page, world: World, folder: Path) -> None:
    placing = Placing(page, world, VALUES, folder)
    tab.goto(page.address)
    tab.get_by_label("move bounds", exact=True).check()
    tab.get_by_text("bounds 0: x, y, z (m)").wait_for()
    texts = tab.locator("input.mantine-TextInput-input:visible")
    for name, typed in (("goal", "-0.5, 0.005, -.25"), ("bounds 0", "-1.05, -0.5, 0")):
        field = texts.nth([name for name, field in placing.fields.items() if field.visible].index(name))
        field.press("Control+a")
        field.press_sequentially(typed, delay=50)
        field.press("Tab")
        wait(tab, lambda: placing.fields[name].value == typed, "the text")  # noqa: B023
        assert field.input_value() == typed
    tab.get_by_role("button", name="save to scene.yaml").click()
    tab.get_by_text("saved goal, bounds").wait_for()
    stated = read_description(folder)
    assert stated["goal"] == [-0.5, 0.005, -0.25] and stated["bounds"][0] == [-1.05, -0.5, 0.0]


def test_a_message_is_shown_with_its_angle_brackets(tab: "Tab", page: Page) -> None:
    told = "a_b *c*: expected [x](y), type scene=<folder> or <img src='http://127.0.0.1:9/x.png'> & `k` \\ {1+1} #"
    requests: list[str] = []
    tab.on("request", lambda request: requests.append(request.url))
    page.server.gui.add_markdown(plain(told))
    tab.goto(page.address)
    tab.get_by_text(told, exact=True).wait_for()
    assert not [url for url in requests if "x.png" in url]


def test_splats_farther_than_a_kilometre_are_drawn(tab: "Tab", world: World) -> None:
    gaussians = world.scene.gaussians.clone()
    gaussians.means, gaussians.scales = 1000 * gaussians.means, 1000 * gaussians.scales.clamp(max=0.2)
    lower, upper = (tuple(1000 * at for at in corner) for corner in world.scene.bounds)
    page = Page(Scene("room", gaussians, (lower, upper)), port=0)
    tab.goto(page.address)
    drawn(tab)
    page.close()


def test_a_drag_with_the_pointer_changes_the_yaml(tab: "Tab", page: Page, world: World, folder: Path) -> None:
    placing = Placing(page, world, VALUES, folder)
    camera = page.server.initial_camera
    camera.position, camera.look_at, camera.up = (0.5, 1.0, 4.0), (0.5, 1.0, 0.5), (0.0, 1.0, 0.0)
    tab.goto(page.address)
    drawn(tab)
    tab.get_by_role("button", name="save to scene.yaml").wait_for()
    before = (folder / "scene.yaml").read_text()
    view = tab.locator("canvas").first.bounding_box()
    assert view is not None
    x, y = view["x"] + view["width"] / 2, view["y"] + view["height"] / 2  # the goal's handle, where its axes begin
    for away in (14, 22, 30, 38, 46, 54, 62):  # along the handle's axis, whose length on the screen is not known
        tab.mouse.move(x + away, y)
        tab.mouse.down()
        tab.mouse.move(x + away + 40, y, steps=4)
        tab.mouse.up()
        tab.wait_for_timeout(1000)
        if placing.values["goal"] != VALUES["goal"]:
            break
    goal = placing.values["goal"]
    assert goal[0] > 0.5 and goal[1:] == pytest.approx([1.0, 0.0], abs=0.02)
    tab.get_by_role("button", name="save to scene.yaml").click()
    tab.get_by_text("saved goal").wait_for()
    changed = (folder / "scene.yaml").read_text()
    assert changed == before.replace("[0.5, 1.0, 0.0]", str(placing.values["goal"]))
