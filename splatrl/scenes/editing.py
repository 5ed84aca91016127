"""Changes single values of a ``scene.yaml``, and leaves the rest of the file as it stands."""

import errno
import json
import os
import re
import shutil
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from splatrl.documents import read_yaml
from splatrl.files import replacing
from splatrl.scenes.description import COMMENTS, SCENE_FILE, read_description
from splatrl.scenes.proposals import check_proposals
from splatrl.scenes.scene import checked_bounds


def edit_description(
    folder: Path, changes: Mapping[str, Any], check: Callable[[Mapping[str, Any]], object] = lambda stated: None
) -> Path:
    """Write values into a folder's ``scene.yaml``; other lines and all comments stay, and the file changes at once.

    Its line ends and permissions stay as well, and where it is a link, what it leads to is written.

    Args:
        folder: a scene's folder.
        changes: values of ``bounds`` and of ``PROPOSALS``, by key.
        check: refuses what the file would say, by a ``ValueError``; the file then stays as it was.

    Raises:
        FileNotFoundError: for a folder without a ``scene.yaml``.
        PermissionError: for a file that is read-only.
        ValueError: for values that ``read_scene`` would refuse, or a file that has not a line for each key.
    """
    path, stated = folder / SCENE_FILE, read_description(folder)
    wanted = {**stated, **changes}
    check_proposals(path, wanted)
    if "bounds" in changes:
        checked_bounds(changes["bounds"])
    check(wanted)
    place = path.resolve()
    if not (os.access(place, os.W_OK) and place.stat().st_mode & 0o222):  # its folder would let it be replaced
        raise PermissionError(errno.EACCES, "cannot write: it is read-only", str(path))
    text = place.read_bytes().decode("utf-8")
    ends = "\r\n" if "\r\n" in text else "\n"
    text = text.replace("\r\n", "\n")
    for key, value in changes.items():
        text = _with(text, key, json.dumps(value))
    with replacing(place) as stream:
        shutil.copymode(place, stream.name)
        stream.write(text.replace("\n", ends).encode())
        stream.flush()
        if not _says(Path(stream.name), wanted):
            raise ValueError(f"{path}: expected a line for each key, as splatrl writes it; edit it by hand")
    return path


def _with(text: str, key: str, value: str) -> str:
    """A YAML text with a line for a key, in place of those that it had."""
    of_key = rf"^{key}:(?P<old>[^#\n]*)(?P<comment>#[^\n]*)?\n?(?P<more>(?:[ \t-][^\n]*(?:\n|$))*)"
    found = re.search(of_key, text, re.MULTILINE)
    if found is None:
        end = "" if not text or text.endswith("\n") else "\n"
        comment = f"  # {COMMENTS[key]}" if key in COMMENTS else ""
        return f"{text}{end}{key}: {value}{comment}\n"
    comment = f"  {found['comment']}" if found["comment"] else ""
    within = "".join(f"  {each}\n" for each in re.findall(r"#.*", found["more"]))  # of the lines that become one
    return f"{text[: found.start()]}{key}: {value}{comment}\n{within}{text[found.end() :]}"


def _says(path: Path, wanted: Mapping[str, Any]) -> bool:
    """Whether a file says just this."""
    try:
        content = read_yaml(path)
    except ValueError:
        return False
    return isinstance(content, dict) and {key: value for key, value in content.items() if value is not None} == wanted
