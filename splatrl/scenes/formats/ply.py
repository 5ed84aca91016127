"""Reads 3DGS PLY as written by Inria's code, nerfstudio, gsplat and others, and writes Inria's layout."""

from collections.abc import Mapping
from pathlib import Path

import numpy as np
import plyfile

from splatrl.files import replacing
from splatrl.scenes.formats.compressed_ply import is_compressed, read_compressed_ply
from splatrl.scenes.formats.limits import MOST_HARMONICS, warn_of_fourth_degree
from splatrl.scenes.formats.ply_header import PlyHeader, read_ply_header
from splatrl.scenes.formats.ply_rows import vertex_columns
from splatrl.scenes.formats.stored import activated, opacity_logits
from splatrl.scenes.gaussians import Gaussians

THIN = np.float32(np.log(0.01))
"""Log of the thickness that surfels are given, relative to their smaller scale."""
MEANS = ("x", "y", "z")
NORMALS = ("nx", "ny", "nz")
SH0 = ("f_dc_0", "f_dc_1", "f_dc_2")
SCALES = ("scale_0", "scale_1", "scale_2")
QUATS = ("rot_0", "rot_1", "rot_2", "rot_3")
FILTER = "filter_3D"
"""Standard deviation of the 3D smoothing filter, in a file that stores the Gaussians without it."""

MODE = {True: "SplatRenderMode: mip", False: "SplatRenderMode: default"}
"""Brush's comments on whether a splat was trained antialiased."""
TRAINED = {comment: antialiased for antialiased, comment in MODE.items()}
TRAINED |= {"antialiased 1": True, "antialiased 0": False}  # Postshot's


def read_ply(path: Path, max_inflation: float) -> Gaussians:
    """Read a PLY file of Gaussians: fields by name in any order, ASCII or binary, SH degree 0 to 4.

    Harmonics of degree 4 are left out, with a warning.

    The 3D smoothing filter that Mip-Splatting and Gaussian Opacity Fields store in ``FILTER`` is applied. Surfels of 2D
    Gaussian Splatting (Huang et al. 2024) are flat, with the third axis as normal, and stored without the third scale,
    or with 0; it becomes a hundredth of the smaller one.

    Raises:
        ValueError: for a damaged file, one that does not hold Gaussians, or a wrong number of harmonics.
    """
    header = read_ply_header(path)
    if is_compressed(header):
        return read_compressed_ply(path, header)
    rest = np.array(_checked_fields(path, header), object).reshape(3, -1).T  # the file stores harmonics by channel
    if len(rest) > MOST_HARMONICS:
        warn_of_fourth_degree(path)
        rest = rest[:MOST_HARMONICS]
    properties = header.elements["vertex"].properties
    filters = (FILTER,) if properties.get(FILTER, "list") != "list" else ()
    groups = (MEANS, QUATS, _scales(properties), ("opacity",), (*SH0, *rest.ravel()), filters)
    doubles = {"double", "float64"} & {properties[name] for name in MEANS}
    dtypes = [np.float64 if doubles else np.float32, *[np.float32] * (len(groups) - 1)]
    means, quats, log_scales, logits, sh, smoothing = vertex_columns(path, header, groups, dtypes)
    sh = sh.reshape(len(sh), 1 + len(rest), 3)
    if log_scales.shape[1] == 2:
        log_scales = np.column_stack([log_scales, np.full(len(log_scales), -np.inf, log_scales.dtype)])
    surfels = np.isneginf(log_scales[:, 2])
    log_scales[surfels, 2] = log_scales[surfels, :2].min(1) + THIN
    return activated(path, means, quats, log_scales, logits[:, 0], sh, smoothing if filters else None)


def write_ply(path: Path, gaussians: Gaussians, antialiased: bool | None = None) -> None:
    """Write Gaussians as PLY in Inria's layout.

    Args:
        path: the file to write.
        gaussians: Gaussians in any frame.
        antialiased: whether they were trained antialiased, for a comment; None writes none.

    Raises:
        ValueError: if a value to store is not finite, such as the log of a scale of 0.
    """
    sh = gaussians.sh.detach().cpu()
    values = {
        MEANS: gaussians.means,
        NORMALS: gaussians.means.new_zeros(len(sh), 3),
        SH0: sh[:, 0],
        _rest(3 * (sh.shape[1] - 1)): sh[:, 1:].mT.flatten(1),
        ("opacity",): opacity_logits(gaussians.opacities)[:, None],
        SCALES: gaussians.scales.double().log(),
        QUATS: gaussians.quats,
    }
    rows = np.empty(len(sh), [(name, "<f4") for names in values for name in names])
    for names, columns in values.items():
        if not columns.isfinite().all():
            raise ValueError(
                f"{path}: {', '.join(names)}: expected values that are finite when stored, got non-finite ones"
            )
        for name, column in zip(names, columns.detach().cpu().unbind(1), strict=True):
            rows[name] = column.numpy()
    element = plyfile.PlyElement.describe(rows, "vertex")
    with replacing(path) as stream:
        comments = [] if antialiased is None else [MODE[antialiased]]
        plyfile.PlyData([element], byte_order="<", comments=comments).write(stream)


def _rest(count: int) -> tuple[str, ...]:
    return tuple(f"f_rest_{i}" for i in range(count))


def _scales(properties: Mapping[str, str]) -> tuple[str, ...]:
    """Return the names of the scales: two for surfels, which have no others."""
    return SCALES[:2] if {name for name in properties if name.startswith("scale")} == {*SCALES[:2]} else SCALES


def _checked_fields(path: Path, header: PlyHeader) -> tuple[str, ...]:
    """Check that all fields are present and return the names of the harmonics above degree 0."""
    if "vertex" not in header.elements:
        raise ValueError(f"{path}: expected an element vertex, got {', '.join(header.elements) or 'none'}")
    properties = header.elements["vertex"].properties
    rest = _rest(sum(name.startswith("f_rest_") for name in properties))
    if len(rest) not in (0, 9, 24, 45, 72):
        raise ValueError(f"{path}: f_rest_*: expected 0, 9, 24, 45 or 72 harmonics above degree 0, got {len(rest)}")
    needed = (*MEANS, *SH0, *rest, "opacity", *_scales(properties), *QUATS)
    missing = [name for name in needed if properties.get(name, "list") == "list"]
    if missing:
        raise ValueError(
            f"{path}: expected the fields of Gaussians, got a PLY file without {', '.join(missing)}; "
            f"it has {', '.join(properties) or 'none'}"
        )
    return rest


def _antialiased(path: Path) -> bool | None:
    """Return whether the splat was trained antialiased, if a comment of Brush or Postshot says so."""
    found = {TRAINED[comment] for comment in read_ply_header(path).comments if comment in TRAINED}
    return found.pop() if len(found) == 1 else None


READERS = {".ply": read_ply}
MODES = {".ply": _antialiased}
