"""Reads MJCF, MuJoCo's format for robots and things, from untrusted files.

Every file that the MJCF references is read here, from the MJCF's own folder, and handed to MuJoCo as bytes, so that
MuJoCo's own file search finds nothing else. Anything that can request unbounded memory in a few bytes is refused.
"""

import math
import os
import re
import xml.etree.ElementTree as ElementTree
from dataclasses import dataclass, field
from pathlib import Path, PurePosixPath
from typing import Any

import numpy as np

from splatrl.physics.optional import needed, without_warnings

MOST_TEXT = 4 * 2**20
"""Maximum bytes of a file's text."""
MOST_ELEMENTS = 50_000
MOST_ASSETS = 256 * 2**20
"""Maximum total bytes of the meshes, skins, textures and height fields that a file references."""
MOST_TEXELS = 2**24
"""Maximum texels of a texture or height field whose dimensions a file gives in numbers."""
MOST_FILES = 1000
MULTIPLYING = {"replicate", "composite", "flexcomp", "plugin", "extension", "model", "attach"}
"""Elements that expand one element into many, load code, or read further models."""
FOLDERS = {"mesh": "meshdir", "skin": "meshdir", "texture": "texturedir", "hfield": "meshdir"}
"""For each element with files, the attribute of ``<compiler>`` that gives their folder."""
NUMBERS = ("qpos0", "body_pos", "body_quat", "body_mass", "geom_size", "cam_pos", "cam_fovy", "actuator_ctrlrange")
"""Arrays of a model in which MuJoCo lets non-finite numbers pass."""


@dataclass
class _Reading:
    """Contents read so far of the files that an MJCF file references."""

    folder: Path
    included: dict[str, bytes] = field(default_factory=dict)
    found: dict[str, Path] = field(default_factory=dict)  # where the included files are
    assets: dict[str, bytes] = field(default_factory=dict)
    elements: int = 0
    size: int = 0


@without_warnings()
def read_mjcf(path: Path | str) -> Any:
    """Read an MJCF file as an ``MjSpec``.

    Settings of ``<compiler>`` that MuJoCo applies to whole models are resolved, so that they hold in a world of which
    this model is only a part: the total mass becomes the bodies' own inertia, and static bodies are not fused. Bodies
    keep the frames that the file gives them, even if their free joint asks for those of their inertia (``align``).

    Args:
        path: the MJCF file. Meshes and textures lie in its folder or below.

    Raises:
        FileNotFoundError: if there is no such file.
        ImportError: without the extra ``physics``.
        ValueError: for a file that is not MJCF, is too large, references files outside its folder, uses elements that
            expand one element into many or load code, or has keyframes and a body with another frame than written, in
            one line that names the file and the element.
    """
    mujoco, path = needed(), Path(path)
    text, reading = _read(path)
    try:
        spec = mujoco.MjSpec.from_string(text.decode(), include=reading.included, assets=reading.assets)
        spec.compiler.fusestatic = False
        _keep_frames(spec)
        alone = spec.copy()
        model = alone.compile()
    except (ValueError, UnicodeDecodeError) as error:
        raise ValueError(f"{path}: expected MJCF, got {_one_line(error)}") from error
    if odd := [name for name in NUMBERS if not np.isfinite(getattr(model, name)).all()]:
        raise ValueError(f"{path}: expected finite numbers, got infinite ones or NaN in {odd[0]}")
    if getattr(spec.compiler, "settotalmass", 0.0) > 0.0:  # MuJoCo has announced its removal
        _fix_inertia(spec, alone, model)
    return spec


def mjcf_files(path: Path) -> list[Path]:
    """Return an MJCF file, the files that it includes, and its meshes and textures; raises as ``read_mjcf``."""
    _, reading = _read(path)
    included = [str(file.relative_to(reading.folder)) for file in reading.found.values()]
    return [path, *(path.parent / name for name in (*included, *reading.assets))]


def _read(path: Path) -> tuple[bytes, _Reading]:
    """Read an MJCF file and everything that it references, and check it."""
    if not path.is_file():
        raise FileNotFoundError(f"{path}: expected an MJCF file, found none")
    reading = _Reading(path.parent.resolve())
    text = _small(path, MOST_TEXT)
    trees = _checked(path, text, reading)
    places = {key: value for tree in trees for node in tree.iter("compiler") for key, value in node.attrib.items()}
    for tree in trees:
        for node in tree.iter():
            _read_files(path, node, places, reading)
    return text, reading


def _keep_frames(spec: Any) -> None:
    """Keep MuJoCo from replacing the frames of bodies with a free joint and no children by those of their inertia."""
    mujoco = needed()
    aligned = {mujoco.mjtAlignFree.mjALIGNFREE_TRUE}
    if spec.compiler.alignfree:
        aligned.add(mujoco.mjtAlignFree.mjALIGNFREE_AUTO)
    for joint in spec.joints:
        if joint.type == mujoco.mjtJoint.mjJNT_FREE and joint.align in aligned and not joint.parent.bodies:
            if spec.keys:
                raise ValueError(
                    f"<key>: keyframes beside the free joint of body {joint.parent.name!r}, whose poses are those of "
                    'its inertia; write align="false" and the poses of the body'
                )
            joint.align = mujoco.mjtAlignFree.mjALIGNFREE_FALSE


def _fix_inertia(spec: Any, alone: Any, model: Any) -> None:
    """Give the bodies of a spec the inertia that they have in its compiled copy."""
    for body, compiled in zip(spec.bodies[1:], alone.bodies[1:], strict=True):
        number, body.explicitinertial = compiled.id, True
        body.mass, body.inertia = model.body_mass[number], model.body_inertia[number]
        body.ipos, body.iquat = model.body_ipos[number], model.body_iquat[number]
    compiler = spec.compiler
    compiler.settotalmass, compiler.boundmass, compiler.boundinertia = -1.0, 0.0, 0.0
    compiler.inertiafromgeom = needed().mjtInertiaFromGeom.mjINERTIAFROMGEOM_FALSE


def _checked(path: Path, text: bytes, reading: _Reading) -> list[ElementTree.Element]:
    """Parse a file and those that it includes, refuse unsafe elements, and return the root elements."""
    try:
        words = text.decode()
        if "\0" in words:  # another encoding could hide a document type, whose entities expand
            raise ValueError("bytes that are not UTF-8 text")
        if "<!DOCTYPE" in words or "<!ENTITY" in words:
            raise ValueError("an XML document type declaration")
        tree = ElementTree.fromstring(words)
    except (ElementTree.ParseError, ValueError, LookupError) as error:
        raise ValueError(f"{path}: expected XML, got {error}") from error
    found = [tree]
    for node in tree.iter():
        reading.elements += 1
        if reading.elements > MOST_ELEMENTS:
            raise ValueError(f"{path}: expected at most {MOST_ELEMENTS:,} elements, got more")
        where = f"{path}: <{node.tag}>"
        if any("}" in name for name in (node.tag, *node.attrib)):
            raise ValueError(
                f"{where}: expected a robot without XML namespaces, since MuJoCo knows no elements in them"
            )
        if node.tag in MULTIPLYING:
            raise ValueError(f"{where}: expected a robot without this element; write out what it expands to")
        _check_sizes(where, node)
        if node.tag == "include":
            name = node.get("file", "")
            inner = _inside(where, reading.folder, name, path.parent.resolve())
            if name not in reading.included:
                reading.found[name], reading.included[name] = inner, _small(inner, MOST_TEXT)
                found += _checked(inner, reading.included[name], reading)
            elif inner != reading.found[name]:
                raise ValueError(
                    f"{where}: expected another name than that of {reading.found[name]}, which is included too, "
                    f"got {name!r:.80}"
                )
    return found


def _check_sizes(where: str, node: ElementTree.Element) -> None:
    """Refuse numbers with which a few bytes request much memory."""
    if node.tag in ("texture", "hfield"):
        sides = [_number(where, node, key) for key in ("width", "height", "nrow", "ncol") if key in node.attrib]
        if math.prod(sides) > MOST_TEXELS:
            raise ValueError(f"{where}: expected at most {MOST_TEXELS:,} texels, got {math.prod(sides):,.0f}")
    if node.tag == "size":
        for key in node.attrib:
            if key != "memory" and _number(where, node, key) > MOST_ELEMENTS:
                raise ValueError(f"{where}: {key}: expected at most {MOST_ELEMENTS:,}, got {node.get(key)}")
        if re.search(r"[GTPE]", node.get("memory", ""), re.IGNORECASE) or len(node.get("memory", "")) > 9:
            raise ValueError(f"{where}: memory: expected less than 1G, got {node.get('memory')}")


def _number(where: str, node: ElementTree.Element, key: str) -> float:
    try:
        return float(node.attrib[key])
    except ValueError as error:
        raise ValueError(f"{where}: {key}: expected a number, got {node.attrib[key]!r:.80}") from error


def _read_files(path: Path, node: ElementTree.Element, places: dict[str, str], reading: _Reading) -> None:
    """Read the files that an element references, keyed by the names for which MuJoCo will ask."""
    if node.tag == "include":
        return
    for key, name in node.attrib.items():
        if not key.startswith("file"):
            continue
        where = f"{path}: <{node.tag} {key}>"
        if node.tag not in FOLDERS:
            raise ValueError(
                f"{where}: expected files only for meshes, textures, skins and height fields, got {name!r:.80}"
            )
        if places.get("strippath", "false") == "true":
            name = PurePosixPath(name).name
        folder = places.get(FOLDERS[node.tag], places.get("assetdir", ""))
        full = str(PurePosixPath(folder) / name)
        if full in reading.assets:
            continue
        content = _small(_inside(where, reading.folder, full), MOST_ASSETS)
        reading.size += len(content)
        if reading.size > MOST_ASSETS or len(reading.assets) >= MOST_FILES:
            raise ValueError(
                f"{where}: expected at most {MOST_FILES} files with {MOST_ASSETS:,} bytes in total, got more"
            )
        reading.assets[full] = content


def _inside(where: str, folder: Path, name: str, beside: Path | None = None) -> Path:
    """Resolve a name to a file in a folder or below, and refuse any other place.

    Args:
        where: the element, for messages.
        folder: the folder.
        name: path of the file, relative to the folder.
        beside: folder of the including file, to which the path is relative if the first has no such file.
    """
    if not name or PurePosixPath(name).is_absolute() or "\\" in name or "\0" in name:
        raise ValueError(f"{where}: expected a path inside the MJCF file's folder, got {name!r:.80}")
    starts = [folder] if beside is None else [folder, beside]
    found = [(start / name).resolve() for start in starts]
    inside = [place for place in found if place.is_relative_to(folder)]
    if not inside:
        linked = os.path.normpath(folder / name) != str(found[0])
        raise ValueError(
            f"{where}: expected a path inside the MJCF file's folder, got "
            f"{'a link that leaves it, ' if linked else ''}{name!r:.80}"
        )
    for place in inside:
        if place.is_file():
            return place
    raise ValueError(f"{where}: expected a file {name!r:.80} beside the MJCF, found none")


def _small(path: Path, most: int) -> bytes:
    """Read the bytes of a file, and refuse one that is too large."""
    with path.open("rb") as stream:
        content = stream.read(most + 1)
    if len(content) > most:
        raise ValueError(f"{path}: expected at most {most:,} bytes, got more")
    return content


def _one_line(error: Exception) -> str:
    return " ".join(str(error).split())[:300]
