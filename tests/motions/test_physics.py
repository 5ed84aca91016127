"""The motion of a robot with physics."""

import math
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import torch

from splatrl.bodies import Box
from splatrl.building import build_world, places
from splatrl.collision import Occupancy
from splatrl.collision.nothing import NoChecker
from splatrl.configuration import load_config
from splatrl.curriculum.field import Moves, cost_field
from splatrl.geometry import wrapped
from splatrl.motions import DriveMotion, PhysicsMotion, Site, StridesMotion, WalkMotion
from splatrl.motions.twin import TwinMotion
from splatrl.physics import Terrain, Variation
from splatrl.physics.robots import FOLDER, mjcf_path
from splatrl.scenes import Scene, write_gaussians
from tests.tiny import BlockChecker, bare_site, tiny_gaussians, tiny_overrides
from tests.two_rooms import in_both

WALL = torch.tensor([[0.6, 0.0, 0.2, 0.1, 1.0, 0.2]], dtype=torch.float64)
LEVEL = torch.tensor([0.0, 0.0, 1.0, 0.02], dtype=torch.float64)
NOTHING: Any = NoChecker.__new__(NoChecker)


CART = """<mujoco><worldbody><body name="cart" pos="0 0 0.06"><freejoint/><camera name="eye"/>
<geom type="box" size="0.1 0.07 0.03" mass="1"/><site name="s"/>{wheels}</body></worldbody>
<actuator>{motors}</actuator></mujoco>"""


def cart(folder: Path, text: str) -> PhysicsMotion:
    """Write a robot and make its motion."""
    path = folder / "robot.xml"
    path.write_text(text)
    return PhysicsMotion(path, "eye", **SPEEDS)


def wheels(**settings: Any) -> PhysicsMotion:
    """Make the motion of a robot on wheels with a ball that it may push."""
    own = {"path": "wheels", "things": {"ball": "ball"}, "pushed": ["ball"], "threads": 1}
    return PhysicsMotion(camera="eye", **{**own, **settings})


def driven(motion: PhysicsMotion, state: torch.Tensor, action: tuple[float, float], steps: int) -> torch.Tensor:
    """Return the states after repeating an action."""
    for _ in range(steps):
        state = motion.move(state, torch.tensor([action]).expand(len(state), 2), NOTHING).state
    return state


@pytest.mark.parametrize("action", [(0.4, 0.0), (0.3, 0.8), (-0.2, 0.0), (0.0, 1.2)])
def test_wheels_follow_the_commanded_velocities(action: tuple[float, float]) -> None:
    motion = wheels(things=None, pushed=())
    state = driven(motion, motion.placed(torch.tensor([[0.2, -0.1, 0.5]])), action, 5)
    before = motion.planar(state)
    after = motion.planar(driven(motion, state, action, 5))
    ideal = DriveMotion(0.0, 0.5, (-0.25, 0.5), 90.0).advance(before.float(), torch.tensor([action]))
    assert (after - ideal)[0, :2].norm() < 0.02
    assert abs((after - ideal)[0, 2].sin()) < 0.06


def test_a_placed_robot_stands_still_on_the_ground_even_on_a_slope() -> None:
    normal = torch.tensor([math.sin(0.05), 0.0, math.cos(0.05)], dtype=torch.float64)
    for plane in (LEVEL, torch.cat([normal, torch.tensor([0.1], dtype=torch.float64)])):
        motion = wheels(things=None, pushed=())
        motion.stand_on(Terrain(plane, WALL[:0]))
        planar = torch.tensor([[0.0, 0.0, 0.0], [0.4, -0.3, 2.0], [-0.5, 0.2, 5.0]], dtype=torch.float64)
        state = motion.placed(planar)
        torch.testing.assert_close(motion.planar(state), planar, atol=2e-3, rtol=0)
        after = driven(motion, state, (0.0, 0.0), 5)
        moved = motion.body_to_world(after)[:, :3, 3] - motion.body_to_world(state)[:, :3, 3]
        assert moved.norm(dim=1).max() < 0.02
        up = motion.body_to_world(state)[:, :3, 2]
        torch.testing.assert_close(up, plane[:3].float().expand(3, 3), atol=1e-6, rtol=0)


TURNED = CART.format(wheels="", motors='<general site="s" ctrlrange="-1 1"/>').replace(
    'pos="0 0 0.06"', 'pos="1 2 0.06" euler="{} {} {}"'
)
KEYED = TURNED.format(0, 0, 0).replace("</mujoco>", '<keyframe><key qpos="3 4 0.06 0.6 0 0 0.8"/></keyframe></mujoco>')
HEADED = TURNED.format(0, 0, 90).replace(
    '<camera name="eye"/>',
    '<body pos="0.05 0.02 0.1" euler="0 20 30"><geom size="0.01" mass="0.01"/><camera name="eye"/></body>',
)
SPEEDS: dict[str, Any] = {"linear": (-0.4, 0.4), "angular_deg": 900.0, "threads": 1, "headings": 4, "spacing": 0.5}
SPEEDS |= {"lower": (-0.5, -0.5), "upper": (0.5, 0.5)}


@pytest.mark.parametrize(
    "make",
    [
        lambda _: wheels(),
        lambda _: PhysicsMotion("car", "eye", **SPEEDS),
        lambda _: PhysicsMotion("quadrotor", "eye", **SPEEDS),
        lambda _: StridesMotion(path="quadruped", camera="eye", threads=1),
        lambda _: WalkMotion(path="quadruped", camera="eye", threads=1, gait=None),
        lambda folder: cart(folder, TURNED.format(0, 0, 0)),
        lambda folder: cart(folder, TURNED.format(0, 0, 90)),
        lambda folder: cart(folder, TURNED.format(20, -35, 200)),
        lambda folder: cart(folder, KEYED),
        lambda folder: cart(folder, HEADED),
    ],
)
def test_a_placed_robot_has_the_asked_position_and_heading(make: Callable[[Path], TwinMotion], tmp_path: Path) -> None:
    motion = make(tmp_path)
    planar = torch.tensor([[0.3, -0.2, 1.0], [0.0, 0.0, 6.0], [-0.5, 0.1, 0.0]], dtype=torch.float64)
    found = motion.planar(motion.placed(planar))
    torch.testing.assert_close(found[:, :2], planar[:, :2])
    torch.testing.assert_close(wrapped(found - planar)[:, 2], torch.zeros(3).double(), atol=1e-12, rtol=0)
    found = motion.planar_of(motion.body_to_world(motion.placed(planar)))  # of the body that carries the camera
    torch.testing.assert_close(wrapped(found - planar), torch.zeros(3, 3).double(), atol=1e-5, rtol=0)


def test_the_same_robot_turned_in_its_file_has_the_same_plan(tmp_path: Path) -> None:
    plain, *turned = (cart(tmp_path, text) for text in (TURNED.format(0, 0, 0), TURNED.format(0, 0, 90), KEYED))
    states, checker = plain.states(), BlockChecker(reach=0.2)

    def reached(state: torch.Tensor) -> torch.Tensor:
        return (plain.planar(state) - torch.tensor([0.4, 0.0, 1.0])).norm(dim=1) < 0.3

    costs = cost_field(Moves(plain, checker, reached)).cost_to_go
    for motion in turned:
        poses = motion.body_to_world(motion.states())
        torch.testing.assert_close(poses, plain.body_to_world(states), atol=1e-6, rtol=0)
        torch.testing.assert_close(cost_field(Moves(motion, checker, reached)).cost_to_go, costs, atol=1e-3, rtol=1e-4)


DRIVEN = '<{0} name="forward" site="s" gear="1 0 0 0 0 0" {1} ctrlrange="-0.2 0.4"/>'
DRIVEN += '<{0} name="turn" site="s" gear="0 0 0 0 0 1" {1} ctrlrange="-1 1"/>'
FORCES = DRIVEN.format("motor", "")
BOOM = '<body pos="0.4 0 0.1" euler="0 0 90"><geom size="0.02"/><camera name="boom"/></body>'


@pytest.mark.parametrize("text", [CART.format(wheels=BOOM, motors=FORCES), KEYED.replace("</body>", f"{BOOM}</body>")])
def test_a_robot_with_a_camera_on_a_boom_begins_where_all_of_it_is_clear(
    text: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path, tried = tmp_path / "robot.xml", list[torch.Tensor]()
    path.write_text(text)
    motion = PhysicsMotion(path, "boom", ground="level", **SPEEDS)
    monkeypatch.setattr(motion, "clear", lambda state: tried.append(state) or torch.ones(len(state)).bool())
    fits = motion.settle(bare_site(), lambda poses: torch.ones(len(poses)).bool())
    states = motion.placed(torch.tensor([[0.3, -0.2, 1.0], [0.0, 0.1, 3.0]]))
    assert fits(motion.body_to_world(states)).all()
    torch.testing.assert_close(tried[0], states, atol=1e-6, rtol=0)


@pytest.mark.parametrize(("pitch", "way"), [(-90, "up"), (88, "down")])
def test_a_robot_that_points_up_or_down_is_refused(tmp_path: Path, pitch: float, way: str) -> None:
    with pytest.raises(ValueError, match=rf"robot\.xml: expected a first body whose x axis .* points {way}; put"):
        cart(tmp_path, TURNED.format(0, pitch, 0))


def test_the_free_fraction_ends_where_a_wall_is_first_touched() -> None:
    motion = wheels()
    motion.stand_on(Terrain(LEVEL, WALL))
    start = motion.placed(torch.tensor([[0.2, 0.5, 0.0], [-0.5, 0.5, 0.0], [0.28, -0.6, 0.0]]))
    start[:, motion.thing("ball")][:, 1] = 5.0
    state, fractions = start, []
    for _ in range(4):
        move = motion.move(state, torch.tensor([[0.5, 0.0]]).expand(3, 2), NOTHING)
        state = move.state
        fractions.append(move.free_fraction)
    found = torch.stack(fractions)
    assert (found[:, 1] == 1).all(), "far from the wall"
    touching = found[:, 0] < 1
    assert touching.any() and not touching[0]
    assert found[touching.int().argmax(), 0] > 0, "it touched within the action"
    assert (motion.planar(state)[[0, 2], 0] < 0.5).all(), "the wall holds it"
    assert motion.clear(start).tolist() == [True, True, True]
    inside = motion.placed(torch.tensor([[0.5, 0.5, 0.0]]))
    assert motion.clear(inside).tolist() == [False]


@pytest.mark.parametrize(
    ("leeway", "settings", "body", "walls"),
    [
        (0.0, {}, 0.1, False),  # wheels reach 0.22 m, and the walls are half a metre beyond the bounds
        (0.4, {}, 0.1, True),
        (0.0, {"path": "quadruped", "linear": (0.0, 0.5), "angular_deg": 45.0}, 0.1, True),  # reaches 0.4 m
        (0.0, {}, 0.9, True),
        (0.0, {"things": {"ball": "ball"}, "pushed": ["ball"]}, 0.1, True),
    ],
)
def test_physics_knows_everything_solid_that_robots_and_pushed_things_can_reach(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    leeway: float,
    settings: dict[str, Any],
    body: float,
    walls: bool,
) -> None:
    monkeypatch.setenv("SPLATRL_CACHE", str(tmp_path))
    scene = Scene("room", tiny_gaussians(), ((-1.5, -2.0, 0.0), (1.5, 2.0, 1.2)))
    occupancy, shape = Occupancy.from_gaussians(scene.gaussians), Box((body, body, 0.1))
    motion = wheels(**{"things": None, "pushed": (), "lower": (-1.0, -1.5), "upper": (1.0, 1.5), **settings})
    motion.settle(Site(scene, occupancy, NOTHING, shape, True, leeway), lambda poses: torch.ones(len(poses)).bool())
    boxes = motion.terrain.boxes
    assert len(boxes) and ((boxes[:, 0] + boxes[:, 3]).max() > 1.4).item() is walls


def test_grass_that_physics_takes_as_ground_does_not_keep_a_low_robot_from_starting(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(places, "plan", lambda motion, checker, reached, farthest, fits, *_: (motion, checker, fits))
    monkeypatch.setattr(places, "warn_of_cut_off", lambda scene, paths: None)
    monkeypatch.setattr(places, "warn_of_far_starts", lambda scene, paths: None)
    monkeypatch.setattr(places, "warn_of_no_floor", lambda scene, paths, occupancy: None)
    path = tmp_path / "cart.xml"
    path.write_text(CART.format(wheels="", motors='<general site="s" ctrlrange="-1 1"/>'))
    low = ["robot=mjcf", f"robot.path={path}", "robot.body.size=[0.2,0.2,0.02]", "motion@task.motion=physics"]
    low += ["task.motion.linear=[-0.4,0.4]", "task.motion.angular_deg=90", "task.motion.headings=4"]
    grass = "collision.occupancy.add=[[[-1.4,-1.9,0.0],[1.4,1.9,0.09]]]"
    cfg = load_config([*tiny_overrides(tmp_path, "drive"), *low, grass])
    (place,) = places.build_places([cfg], torch.device("cpu"), ["room"])
    motion, checker, fits = place.plan
    poses = motion.body_to_world(motion.states())
    assert place.checker.collides(poses).all()
    free = ~checker.collides(poses)
    assert 0.3 < free.double().mean() < 1.0 and torch.equal(fits(poses), free)


def test_pushable_things_are_not_obstacles_and_other_things_are() -> None:
    for pushed, free in ((["ball"], True), ([], False)):
        motion = wheels(pushed=pushed)
        state = motion.placed(torch.tensor([[0.0, 0.0, 0.0]]))
        ball = motion.thing("ball")
        state[:, ball][:, 0] = 0.35
        fractions = []
        for _ in range(6):
            move = motion.move(state, torch.tensor([[0.5, 0.0]]), NOTHING)
            state = move.state
            fractions.append(float(move.free_fraction))
        assert float(state[0, ball][0]) > 0.45, "it rolls"
        assert (min(fractions) == 1.0) is free


def test_rows_of_a_batch_move_as_they_do_alone() -> None:
    motion = wheels()
    state = motion.placed(torch.rand(5, 3, generator=torch.Generator().manual_seed(0)))
    action = torch.rand(5, 2, generator=torch.Generator().manual_seed(1))
    together = motion.move(state, action, NOTHING)
    for row in range(5):
        alone = motion.move(state[row : row + 1], action[row : row + 1], NOTHING)
        for one, all_rows in zip(alone, together, strict=True):
            assert torch.equal(one[0], all_rows[row])


def test_actions_are_clamped_to_the_range_of_the_actuators() -> None:
    motion = wheels()
    state = motion.placed(torch.zeros(1, 3))
    assert motion.action_spec.space.high.tolist() == pytest.approx([0.5, 1.5708])
    wild, most = (motion.move(state, torch.tensor([[v, 0.0]]), NOTHING).state for v in (50.0, 0.5))
    assert torch.equal(wild, most)


def test_paths_are_planned_as_for_a_drive_with_the_robots_speeds() -> None:
    motion = wheels(spacing=0.5, headings=4, time_step=0.2)
    twin = DriveMotion(0.27, 0.2, (-0.25, 0.5), math.degrees(1.5708), spacing=0.5, headings=4)
    states = motion.states()
    torch.testing.assert_close(motion.planar(states).float(), twin.states())
    action = motion.actions()[0].expand(len(states), 2)
    ahead = twin.advance(twin.states(), action)
    torch.testing.assert_close(motion.planar(motion.advance(states, action)).float(), ahead, atol=1e-5, rtol=0)
    torch.testing.assert_close(motion.taps(states).node, twin.taps(twin.states()).node)
    assert motion.inside(states).all() and motion.step == pytest.approx(0.1)


def test_each_episode_uses_one_of_the_varied_models() -> None:
    motion = wheels(variation=Variation(4, friction=(0.5, 2.0)))
    state = motion.placed(torch.zeros(64, 3))
    drawn = motion.varied(state, torch.Generator().manual_seed(0))
    assert drawn[:, 0].unique().tolist() == [0, 1, 2, 3]
    assert torch.equal(drawn[:, 1:], state[:, 1:])
    assert motion.state_spec.is_in(drawn[0]) and not motion.state_spec.is_in(drawn[0] * math.nan)


def test_ranges_of_a_variation_need_variants_unless_the_task_makes_its_own() -> None:
    site = bare_site()
    motion = wheels(ground="level", variation=Variation(friction=(0.1, 0.1)))
    message = r"^task\.motion\.variation\.models: expected more than 1 for ranges other than \[1, 1\], got 1$"
    with pytest.raises(ValueError, match=message):
        motion.settle(site, lambda poses: torch.ones(len(poses)).bool())
    motion.settle(site._replace(varies=False), lambda poses: torch.ones(len(poses)).bool())


def test_links_and_things_are_drawn_where_the_state_puts_them() -> None:
    motion = wheels()
    state = motion.placed(torch.tensor([[0.3, 0.2, 0.0], [0.0, 0.0, 1.0]]))
    parts = motion.parts(state)
    assert parts.model.tolist() == [[0, 1, 2, 3, 4]] * 2 and len(motion.models) == 4
    assert torch.equal(parts.model_to_world[:, 0], torch.eye(4).expand(2, 4, 4))
    assert torch.equal(parts.model_to_world[:, 1], motion.body_to_world(state))
    assert torch.equal(parts.model_to_world[:, 4, :3, 3], state[:, motion.thing("ball")][:, :3].float())


def test_a_thing_can_look_like_a_given_splat_and_moves_with_the_state(tmp_path: Path) -> None:
    look = tiny_gaussians()[:7]
    write_gaussians(tmp_path / "ball.ply", look)
    plain, other = wheels(), wheels(looks={"ball": tmp_path / "ball.ply"})
    assert len(other.models) == len(plain.models)
    assert torch.allclose(other.models[-1].means, look.means) and len(plain.models[-1].means) > 7
    assert torch.equal(other.models[0].means, plain.models[0].means)
    state = driven(other, other.placed(torch.tensor([[0.2, 0.1, 0.4]])), (0.4, 0.2), 5)
    state[:, other.thing("ball")][:, 0] += 0.3
    assert torch.equal(other.parts(state).model_to_world, plain.parts(state).model_to_world)
    with pytest.raises(ValueError, match=r"task\.motion\.looks: expected names from task\.motion\.things, got box"):
        wheels(looks={"box": tmp_path / "ball.ply"})
    with pytest.raises(FileNotFoundError):
        wheels(looks={"ball": tmp_path / "none.ply"})


FREE = "<freejoint/>"
THING = """<mujoco><worldbody><body pos="0 0 {height}">{joint}<geom type="box" size="0.06 0.06 0.06" {more}/></body>
</worldbody></mujoco>"""


@pytest.mark.parametrize(
    ("height", "joint", "more", "message"),
    [
        (0.06, FREE, "", None),
        (0.07, FREE, "", None),
        (0.5, "", "", None),  # fixed in the air
        (0.06, FREE, 'contype="0" conaffinity="0"', r"rests on z = 0 .* falls by 20\.\d cm within 0\.2 s;"),
        (0.2, FREE, "", r"falls by 1\d\.\d cm within"),
        (0.0, FREE, "", r"rises by \S+ cm within"),
        (0.06, FREE, 'group="3"', r"geoms that are drawn .* got none; .* task\.motion\.looks\.egg$"),
        (0.06, "", 'rgba="1 0 0 0"', r"geoms that are drawn .* got none"),
    ],
)
def test_things_that_are_not_drawn_or_do_not_rest_are_refused(
    tmp_path: Path, height: float, joint: str, more: str, message: str | None
) -> None:
    path = tmp_path / "egg.xml"
    path.write_text(THING.format(height=height, joint=joint, more=more))
    things = {"egg": str(path), "ball": "ball"}  # both at the place of the robot
    if message is None:
        assert wheels(things=things).things.paths["egg"] == path
        return
    with pytest.raises(ValueError, match=rf"^task\.motion\.things: \S+egg\.xml: expected .*{message}") as caught:
        wheels(things=things)
    assert "\n" not in str(caught.value)


def test_a_hidden_thing_with_a_look_is_drawn(tmp_path: Path) -> None:
    path, look = tmp_path / "egg.xml", tmp_path / "egg.ply"
    path.write_text(THING.format(height=0.06, joint=FREE, more='group="3"'))
    write_gaussians(look, tiny_gaussians()[:7])
    assert len(wheels(things={"egg": str(path)}, pushed=["egg"], looks={"egg": look}).models[-1].means) == 7


@pytest.mark.parametrize(("scale", "size"), [(30.0, "5.5"), (2.5, None), (0.4, None), (0.3, "0.055")])
def test_a_look_of_another_size_than_the_geoms_is_warned_of(tmp_path: Path, scale: float, size: str | None) -> None:
    look = tmp_path / "ball.ply"
    ball = wheels().models[-1].clone()
    ball.means = scale * ball.means
    ball.means[0] = 1e3  # a floater
    write_gaussians(look, ball)
    motion = wheels(looks={"ball": look}, ground="level")
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        motion.settle(bare_site()._replace(varies=False), lambda poses: torch.ones(len(poses)).bool())
    said = [str(each.message) for each in caught]
    expected = (
        f"task.motion.looks.ball: {look} is {size} m across, and the geoms that it replaces are 0.18 m; a look is"
    )
    assert [each.startswith(expected) for each in said] == ([True] if size else []), said


def test_several_scenes_are_refused_before_any_is_built(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(places, "_build_place", lambda *_: pytest.fail("a scene is built"))
    with pytest.raises(ValueError, match="scene: expected one scene for a robot with physics, got 2"):
        build_world(load_config(in_both(tmp_path, "push")))


WHEEL = (
    '<body pos="-0.05 {y} -0.02"><joint name="{n}" axis="0 1 0"/><geom type="sphere" size="0.04" mass="0.1"/></body>'
)


def test_a_robot_whose_physics_fails_at_once_is_refused_by_its_file(tmp_path: Path) -> None:
    path, wheels = tmp_path / "cart.xml", WHEEL.format(y=0.08, n="l") + WHEEL.format(y=-0.08, n="r")

    def cart(gain: float) -> PhysicsMotion:
        motors = "".join(f'<velocity joint="{name}" kv="{gain}" ctrlrange="-20 20"/>' for name in "lr")
        path.write_text(CART.format(wheels=wheels, motors=motors))
        return PhysicsMotion(path, "eye", linear=(-0.4, 0.4), angular_deg=90.0, substep=0.005, threads=1)

    assert cart(gain=0.005).action_spec.shape == (2,)
    with pytest.raises(ValueError, match=r"cart\.xml: expected physics that .* fails within the first; lower"):
        cart(gain=0.5)


BODY = '<freejoint/><geom size="0.1"/><camera name="eye"/>'
MOTOR = '<actuator><general site="s" ctrlrange="-1 1" name="push"/></actuator>'


def test_a_robot_that_turns_before_it_goes_forward_is_refused(tmp_path: Path) -> None:
    *before, forward, turn, actuators, end = mjcf_path("wheels").read_text().splitlines()
    (tmp_path / "swapped.xml").write_text("\n".join([*before, turn, forward, actuators, end]))
    with pytest.raises(ValueError, match=r"swapped\.xml: expected the actuator 'forward' before 'turn', got it after"):
        PhysicsMotion(tmp_path / "swapped.xml", "eye", threads=1)


@pytest.mark.parametrize(("ahead", "warned"), [(0.03, False), (0.1, True)])
def test_a_robot_that_does_not_turn_about_its_first_body_is_warned_of(
    tmp_path: Path, ahead: float, warned: bool
) -> None:
    text = mjcf_path("wheels").read_text()
    assert text.count('pos="0.03 ') == 2  # the wheels
    (tmp_path / "moved.xml").write_text(text.replace('pos="0.03 ', f'pos="{ahead} '))
    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always")
        PhysicsMotion(tmp_path / "moved.xml", "eye", {"ball": "ball"}, threads=1)
    found = "moved.xml: expected a robot that turns about the origin of its first body"
    assert any(found in str(one.message) and "a point 0.1 m from it" in str(one.message) for one in told) is warned


@pytest.mark.parametrize(
    ("motors", "driven"),
    [
        (DRIVEN.format("velocity", 'kv="2"'), True),
        (DRIVEN.format("general", 'biastype="affine" gainprm="3" biasprm="0 0 -3"'), True),
        (FORCES, False),  # newtons
        (DRIVEN.format("velocity", 'kv="2"').replace("1 0 0", "4 0 0"), False),  # four units are a metre per second
        (DRIVEN.format("position", 'kp="2" kv="2"'), False),  # metres
        (DRIVEN.format("velocity", 'kv="2"') + '<motor site="s" ctrlrange="-1 1"/>', False),
    ],
)
def test_only_two_velocity_servos_say_how_fast_a_robot_is(tmp_path: Path, motors: str, driven: bool) -> None:
    motion = cart(tmp_path, CART.format(wheels="", motors=motors))
    assert motion.driven is driven and motion.step == pytest.approx(0.04)
    actuators = ["forward", "turn", "2"][: motion.limits.shape[1]]  # the third has no name
    assert list(motion.controls) == (["forward (m/s)", "turn (rad/s)"] if driven else actuators)
    own: dict[str, Any] = {**SPEEDS, "linear": None, "angular_deg": None}
    if driven:
        found = PhysicsMotion(motion.path, "eye", **own)
        torch.testing.assert_close(found.twin.limits, torch.tensor([[-0.2, -1.0], [0.4, 1.0]]))
        return
    for key in ("linear", "angular_deg"):
        with pytest.raises(ValueError, match=rf"^task\.motion\.{key}: expected a value, got none"):
            PhysicsMotion(motion.path, "eye", **{**SPEEDS, key: None})


@pytest.mark.parametrize(
    ("body", "rest", "settings", "message"),
    [
        ('<geom size="0.1"/><camera name="eye"/>', "", {}, "body 'b': expected a <freejoint/>"),
        ('<freejoint/><geom size="0.1"/>', MOTOR, {}, "expected a camera called 'eye', got none"),
        (BODY, "", {}, "expected at least one <actuator>, found none"),
        (
            BODY,
            '<actuator><general site="s" name="push"/></actuator>',
            {},
            "actuator 'push': expected a ctrlrange",
        ),
        (BODY, MOTOR, {}, "task.motion.linear: expected a value, got none, which needs .* 'turn'; .* imagenav"),
        (
            BODY,
            MOTOR,
            {"time_step": 0.003},
            "time_step: expected a multiple of the robot's timestep, 0.002 s, got 0.003",
        ),
        (BODY, MOTOR, {"substep": 0}, "task.motion.substep: expected a number from 1e-05 to 1.0, got 0"),
        (BODY, MOTOR, {"substep": "x"}, "task.motion.substep: expected a number"),
        (BODY, MOTOR, {"pushed": ["egg"]}, "pushed: expected names from task.motion.things, got egg"),
        *(
            (
                BODY,
                MOTOR,
                {"things": {name: "ball"}},
                f"things: expected names without / and other than .*, got {name}$",
            )
            for name in ("robot", "scene", "ground", "world", "robot/b")
        ),
    ],
)
def test_what_a_robot_lacks_is_reported_in_one_line(
    tmp_path: Path, body: str, rest: str, settings: dict[str, Any], message: str
) -> None:
    path = tmp_path / "robot.xml"
    path.write_text(f'<mujoco><worldbody><body name="b"><site name="s"/>{body}</body></worldbody>{rest}</mujoco>')
    with pytest.raises(ValueError, match=message) as caught:
        PhysicsMotion(path, "eye", **settings)
    assert "\n" not in str(caught.value)


def test_a_custom_robot_moves_by_its_actuators(tmp_path: Path) -> None:
    path = tmp_path / "robot.xml"
    path.write_text(f'<mujoco><worldbody><body pos="0 0 0.1"><site name="s"/>{BODY}</body></worldbody>{MOTOR}</mujoco>')
    motion = PhysicsMotion(path, "eye", linear=(-0.2, 0.4), angular_deg=45.0, threads=1)
    state = motion.placed(torch.zeros(1, 3))
    assert motion.action_spec.shape == (1,) and float(motion.body_to_world(state)[0, 2, 3]) == pytest.approx(0.1)
    assert motion.move(state, torch.tensor([[1.0]]), NOTHING).inside.all()
    assert mjcf_path(str(path)) == path and mjcf_path("ball").parent == FOLDER
