"""MJCF files from untrusted sources are read as data, and refused in one line."""

import struct
from pathlib import Path

import mujoco
import pytest

from splatrl.physics import compose, level_ground, read_mjcf
from splatrl.physics import mjcf as reading
from splatrl.physics.robots import FOLDER, mjcf_path

BALL = '<body name="ball"><freejoint/><geom size="0.1"/></body>'
TRIANGLES = [((0, 0, 0), (0, 1, 0), (1, 0, 0)), ((0, 0, 0), (1, 0, 0), (0, 0, 1)), ((0, 0, 0), (0, 0, 1), (0, 1, 0))]
TRIANGLES.append(((1, 0, 0), (0, 1, 0), (0, 0, 1)))


def written(folder: Path, body: str = BALL, head: str = "") -> Path:
    """Write an MJCF file in its own folder, and return its path."""
    path = folder / "robot" / "robot.xml"
    path.parent.mkdir(exist_ok=True)
    path.write_text(f"<mujoco>{head}<worldbody>{body}</worldbody></mujoco>")
    return path


def write_mesh(path: Path) -> None:
    """Write a tetrahedron as binary STL."""
    path.parent.mkdir(parents=True, exist_ok=True)
    numbers = [[number for corner in each for number in corner] for each in TRIANGLES]
    rows = [struct.pack("<12fH", 0, 0, 0, *row, 0) for row in numbers]
    path.write_bytes(bytes(80) + struct.pack("<I", len(rows)) + b"".join(rows))


def test_the_built_in_robots_are_read() -> None:
    for path in sorted(FOLDER.glob("*.xml")):
        assert read_mjcf(path).compile().nbody > 1, path
    assert mjcf_path("wheels") == FOLDER / "wheels.xml"
    with pytest.raises(FileNotFoundError, match=r"nothing: expected an MJCF file, or one of ball, .*wheels"):
        mjcf_path("nothing")


def test_meshes_and_included_files_in_its_folder_are_found(tmp_path: Path) -> None:
    write_mesh(tmp_path / "robot" / "meshes" / "shell.stl")
    (tmp_path / "robot" / "assets.xml").write_text('<mujoco><asset><mesh name="m" file="shell.stl"/></asset></mujoco>')
    head = '<compiler meshdir="meshes"/><include file="assets.xml"/>'
    path = written(tmp_path, '<body><freejoint/><geom type="mesh" mesh="m"/></body>', head)
    composed = compose(read_mjcf(path), level_ground())
    assert composed.model.nmeshvert == 4 and composed.robot == "robot/body"


OUTSIDE = "expected a path inside the MJCF file's folder"


@pytest.mark.parametrize(
    ("head", "body", "message"),
    [
        ("", "<body><freejoint/></body", r"robot.xml: expected XML, got"),
        ("", '<body><joint type="spiral"/></body>', r"robot.xml: expected MJCF, got .*spiral"),
        ("", "<body><freejoint/></body>", r"robot.xml: expected MJCF, got .*mass"),
        ('<asset><mesh file="../secret.stl"/></asset>', BALL, rf"<mesh file>: {OUTSIDE}, got '../secret.stl'"),
        ('<asset><mesh file="/etc/passwd"/></asset>', BALL, rf"<mesh file>: {OUTSIDE}, got '/etc/passwd'"),
        ('<compiler meshdir="/etc"/><asset><mesh file="passwd"/></asset>', BALL, OUTSIDE),
        ('<compiler meshdir=".."/><asset><mesh file="secret.stl"/></asset>', BALL, OUTSIDE),
        ('<asset><mesh file="link.stl"/></asset>', BALL, r"got a link that leaves it, 'link.stl'"),
        ('<asset><mesh file="none.stl"/></asset>', BALL, r"expected a file 'none.stl' beside the MJCF, found none"),
        ('<asset><texture type="2d" file="none.png"/></asset>', BALL, r"<texture file>: expected a file 'none.png'"),
        ('<include file="/etc/hosts"/>', BALL, rf"<include>: {OUTSIDE}, got '/etc/hosts'"),
        ('<extension><plugin plugin="any"/></extension>', BALL, r"<extension>: expected a robot without this element"),
        (
            "",
            '<replicate count="1000000">' + BALL + "</replicate>",
            r"<replicate>: expected a robot without this element",
        ),
        ("", '<body><flexcomp name="f" type="grid" count="999 999 999"/></body>', r"<flexcomp>: expected a robot"),
        ('<asset><texture type="2d" builtin="flat" width="99999" height="99999"/></asset>', BALL, "texels"),
        (
            '<asset><texture type="2d" builtin="flat" width="wide" height="9"/></asset>',
            BALL,
            "width: expected a number",
        ),
        ('<a:extension xmlns:a="b"><a:plugin plugin="any"/></a:extension>', BALL, "without XML namespaces"),
        ('<extension xmlns="b"><plugin plugin="any"/></extension>', BALL, "without XML namespaces"),
        ('<asset xmlns:a="b"><mesh name="m" a:file="/etc/passwd"/></asset>', BALL, "without XML namespaces"),
        (
            "",
            '<body pos="nan 0 0"><freejoint/><geom size="0.1"/></body>',
            "expected finite numbers, got infinite ones or NaN in qpos0",
        ),
        ('<size memory="900G"/>', BALL, r"memory: expected less than 1G, got 900G"),
        ('<size nuserdata="900000000"/>', BALL, r"nuserdata: expected at most"),
    ],
)
def test_invalid_or_dangerous_files_are_refused_in_one_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, head: str, body: str, message: str
) -> None:
    monkeypatch.chdir(tmp_path)
    write_mesh(tmp_path / "secret.stl")
    path = written(tmp_path, body, head)
    (path.parent / "link.stl").symlink_to(tmp_path / "secret.stl")
    with pytest.raises(ValueError, match=message) as caught:
        read_mjcf(path)
    assert str(path) in str(caught.value) and "\n" not in str(caught.value)
    assert not (tmp_path / "MUJOCO_LOG.TXT").exists()


DOUBLING = '<!DOCTYPE a [<!ENTITY b "c"><!ENTITY d "&b;&b;">]><mujoco model="&d;"/>'


def test_entities_and_large_files_are_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = written(tmp_path)
    path.write_text('<!DOCTYPE a [<!ENTITY b "c">]>' + path.read_text())
    with pytest.raises(ValueError, match="got an XML document type"):
        read_mjcf(path)
    for encoding in ("utf-16", "utf-16-le", "cp037"):
        path.write_bytes(f'<?xml version="1.0" encoding="{encoding}"?>{DOUBLING}'.encode(encoding))
        with pytest.raises(ValueError, match="expected XML, got"):
            read_mjcf(path)
    path.write_bytes(b'<?xml version="1.0" encoding="utf-7"?>' + DOUBLING.encode("utf-7"))
    with pytest.raises(ValueError, match="expected XML, got"):
        read_mjcf(path)
    monkeypatch.setattr(reading, "MOST_TEXT", 50)
    with pytest.raises(ValueError, match="expected at most 50 bytes"):
        read_mjcf(written(tmp_path))
    with pytest.raises(FileNotFoundError, match="expected an MJCF file, found none"):
        read_mjcf(tmp_path / "none.xml")


def test_without_mujoco_an_error_says_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(__import__("sys").modules, "mujoco", None)
    with pytest.raises(ImportError, match=r"mujoco is missing: pip install 'splatrl\[physics\]'"):
        read_mjcf(FOLDER / "ball.xml")


def test_included_files_are_found_beside_the_main_file_or_else_beside_the_including_one(tmp_path: Path) -> None:
    folder = tmp_path / "robot"
    write_mesh(folder / "m.stl")
    (folder / "parts" / "deep").mkdir(parents=True)
    (folder / "parts" / "middle.xml").write_text(
        '<mujocoinclude><include file="deep/leaf.xml"/><include file="../top.xml"/></mujocoinclude>'
    )
    (folder / "parts" / "deep" / "leaf.xml").write_text('<mujocoinclude><mesh name="a" file="m.stl"/></mujocoinclude>')
    (folder / "top.xml").write_text('<mujocoinclude><mesh name="b" vertex="0 0 0 1 0 0 0 1 0 0 0 1"/></mujocoinclude>')
    head = '<asset><include file="parts/middle.xml"/></asset>'
    geoms = '<geom type="mesh" mesh="a"/><geom type="mesh" mesh="b"/>'
    assert read_mjcf(written(tmp_path, f"<body><freejoint/>{geoms}</body>", head)).compile().nmesh == 2


def test_different_included_files_of_one_name_are_refused(tmp_path: Path) -> None:
    for side in ("left", "right"):
        (tmp_path / "robot" / side).mkdir(parents=True)
        (tmp_path / "robot" / side / "arm.xml").write_text('<mujocoinclude><include file="leaf.xml"/></mujocoinclude>')
        (tmp_path / "robot" / side / "leaf.xml").write_text("<mujocoinclude/>")
    head = '<include file="left/arm.xml"/><include file="right/arm.xml"/>'
    with pytest.raises(
        ValueError, match=r"right/arm\.xml: <include>: expected another name than that of .*, got 'leaf"
    ):
        read_mjcf(written(tmp_path, BALL, head))


def test_a_path_may_turn_around_inside_the_folder(tmp_path: Path) -> None:
    write_mesh(tmp_path / "robot" / "m.stl")
    (tmp_path / "robot" / "assets").mkdir()
    body = '<body><freejoint/><geom type="mesh" mesh="m"/></body>'
    path = written(tmp_path, body, '<asset><mesh name="m" file="assets/../m.stl"/></asset>')
    assert read_mjcf(path).compile().nmesh == 1
    path.write_text(path.read_text().replace("assets/../m", "assets/../../secret"))
    write_mesh(tmp_path / "secret.stl")
    with pytest.raises(ValueError, match=rf"<mesh file>: {OUTSIDE}, got 'assets/../../secret.stl'"):
        read_mjcf(path)


ARM = """
<body name="trunk" pos="0 0 1"><freejoint/><geom size="0.1"/>
  <body name="head" pos="0 0 0.3"><geom size="0.05" pos="0.1 0 0"/></body>
  <body name="arm"><joint name="j" axis="0 1 0" springdamper="0.1 1"/>
    <geom type="capsule" size="0.02" fromto="0 0 0 0.3 0.1 0"/></body>
</body>
"""
SERVO = '<actuator><position joint="j" kp="5" dampratio="1" ctrlrange="-1 1"/></actuator>'


@pytest.mark.filterwarnings("ignore:compiler attribute 'settotalmass'")
def test_the_total_mass_of_a_robot_holds_in_a_world_with_other_things(tmp_path: Path) -> None:
    path = written(tmp_path, ARM, '<compiler settotalmass="7" inertiafromgeom="true"/>' + SERVO)
    alone = mujoco.MjModel.from_xml_string(path.read_text())
    world = compose(read_mjcf(path), level_ground(), {"ball": read_mjcf(mjcf_path("ball"))}).model
    own = slice(2, 1 + alone.nbody)  # behind the world and the ground
    assert world.body_mass[own].sum() == pytest.approx(7.0)
    for name in ("body_mass", "body_inertia", "body_ipos", "body_iquat"):
        assert getattr(world, name)[own] == pytest.approx(getattr(alone, name)[1:]), name
    assert world.actuator_biasprm[0] == pytest.approx(alone.actuator_biasprm[0]), "damping depends on the mass"
    assert world.dof_damping[: alone.nv] == pytest.approx(alone.dof_damping)
    assert read_mjcf(mjcf_path("ball")).compile().body_mass[1] == pytest.approx(world.body("ball/ball").mass[0])


SKEWED = (
    '<freejoint name="f"{}/><geom type="box" size="0.02 0.1 0.05" euler="0 0 35"/><geom size="0.02" pos="0.1 0 0"/>'
)


@pytest.mark.parametrize(("joint", "head"), [(' align="true"', ""), ("", '<compiler alignfree="true"/>')])
def test_bodies_keep_the_frames_that_their_file_gives_them(tmp_path: Path, joint: str, head: str) -> None:
    body = f'<body pos="0 0 0.2">{SKEWED.format(joint)}</body>'
    assert abs(mujoco.MjModel.from_xml_path(str(written(tmp_path, body, head))).qpos0[3]) < 0.9
    assert read_mjcf(written(tmp_path, body, head)).compile().qpos0.tolist() == [0.0, 0.0, 0.2, 1.0, 0.0, 0.0, 0.0]
    keys = '<keyframe><key qpos="0 0 0.2 1 0 0 0"/></keyframe>'
    with pytest.raises(ValueError, match=r"robot\.xml: expected MJCF, got <key>: keyframes beside .* align=\"false\""):
        read_mjcf(written(tmp_path, body, head + keys))
    if joint:
        read_mjcf(written(tmp_path, body.replace(joint, ""), head + keys))


@pytest.mark.filterwarnings("error")
def test_outdated_settings_of_a_model_as_a_whole_are_read_without_a_warning(tmp_path: Path) -> None:
    head = '<compiler settotalmass="7"/><size njmax="500" nconmax="100"/><visual><map znear="0.1"/></visual>'
    assert compose(read_mjcf(written(tmp_path, BALL, head)), level_ground()).model.nbody == 3


def test_static_bodies_are_not_fused_with_their_parents(tmp_path: Path) -> None:
    model = read_mjcf(written(tmp_path, ARM, '<compiler fusestatic="true"/>')).compile()
    assert [model.body(number).name for number in range(1, model.nbody)] == ["trunk", "head", "arm"]
