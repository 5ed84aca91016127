"""The tiny room as a world, a page that shows it, and visitors that open the page without a browser."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

if TYPE_CHECKING:
    from splatrl.envs.world import World
    from splatrl.viewer.page import Page
    from tests.viewer.visitor import Visitor


@pytest.fixture(scope="session")
def make_world(tmp_path_factory: pytest.TempPathFactory) -> Callable[..., World]:
    """A function that builds the room for a task."""
    from functools import cache

    from splatrl.building import build_world
    from splatrl.configuration import load_config
    from tests.tiny import tiny_overrides

    @cache
    def make(task: str = "grid") -> World:
        return build_world(load_config(tiny_overrides(tmp_path_factory.mktemp("room"), task)))

    return make


@pytest.fixture
def world(make_world: Callable[..., World]) -> World:
    """The room with the grid task."""
    return make_world()


@pytest.fixture
def page(world: World) -> Iterator[Page]:
    """A page that shows the room, on a free port."""
    pytest.importorskip("viser", reason="needs the extra view")
    from splatrl.viewer.page import Page

    opened = Page(world.scene, port=0)
    yield opened
    opened.close()


@pytest.fixture
def visit(page: Page) -> Iterator[Callable[[], Visitor]]:
    """A function that opens the page as a browser would."""
    from tests.viewer.visitor import Visitor

    visitors: list[Visitor] = []

    def open_page() -> Visitor:
        visitors.append(Visitor(page.address))
        return visitors[-1]

    yield open_page
    for visitor in visitors:
        visitor.close()


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """The room as a scene folder."""
    from splatrl.scenes import write_gaussians
    from tests.tiny import tiny_gaussians

    write_gaussians(tmp_path / "splat.ply", tiny_gaussians())
    (tmp_path / "scene.yaml").write_text(SCENE)
    return tmp_path


SCENE = """\
# mine
splat: "splat.ply"  # the splat file in this folder
name: "room"
bounds: [[-1.7, -2.2, -0.1], [1.7, 2.2, 1.3]]  # what counts
robot_height: 0.5
walk: [[-1.0, -1.5], [1.0, 1.5]]
step: 0.5
goal: [0.5, 1.0, 0.0]  # looks at the red thing
object:
  - 0.75
  - 1.0
  - 0.5
quality:
  psnr: 30.0
"""
