"""Changes individual values of a ``scene.yaml`` and leaves the rest of the file untouched."""

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
    """Set values in a folder's ``scene.yaml`` atomically, keeping all other lines and all comments.

    Line endings and permissions are kept as well. If the file is a symbolic link, its target is written.

    Args:
        folder: a scene's folder.
        changes: new values of ``bounds`` and of the keys of ``PROPOSALS``, by key.
        check: callback that receives everything the changed file would state and may refuse it with a ``ValueError``;
            the file is then left as it was.

    Raises:
        FileNotFoundError: if the folder has no ``scene.yaml``.
        PermissionError: if the file is read-only.
        ValueError: for values that ``read_scene`` would refuse, or a file that does not have one line per key.
    """
    path, stated = folder / SCENE_FILE, read_description(folder)
    wanted = {**stated, **changes}
    check_proposals(path, wanted)
    if "bounds" in changes:
        checked_bounds(changes["bounds"])
    check(wanted)
    place = path.resolve()
    if not (os.access(place, os.W_OK) and place.stat().st_mode & 0o222):  # a writable folder would allow replacing it
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
            raise ValueError(f"{path}: expected one line per key, as splatrl writes them; edit the file by hand")
    return path


def _with(text: str, key: str, value: str) -> str:
    """Return a YAML text in which one line sets a key, in place of the lines that set it before."""
    of_key = rf"^{key}:(?P<old>[^#\n]*)(?P<comment>#[^\n]*)?\n?(?P<more>(?:[ \t-][^\n]*(?:\n|$))*)"
    found = re.search(of_key, text, re.MULTILINE)
    if found is None:
        end = "" if not text or text.endswith("\n") else "\n"
        comment = f"  # {COMMENTS[key]}" if key in COMMENTS else ""
        return f"{text}{end}{key}: {value}{comment}\n"
    comment = f"  {found['comment']}" if found["comment"] else ""
    within = "".join(f"  {each}\n" for each in re.findall(r"#.*", found["more"]))  # comments of the replaced lines
    return f"{text[: found.start()]}{key}: {value}{comment}\n{within}{text[found.end() :]}"


def _says(path: Path, wanted: Mapping[str, Any]) -> bool:
    """Return whether a file states exactly the wanted values."""
    try:
        content = read_yaml(path)
    except ValueError:
        return False
    return isinstance(content, dict) and {key: value for key, value in content.items() if value is not None} == wanted
