"""Writes what ``LeRobotDataset`` reads from a folder to an npz file; runs in an environment with lerobot.

usage: python read_with_lerobot.py FOLDER OUT.npz
"""

import sys

import numpy as np
import torch

ours = torch.library.Library("torchvision", "DEF")
ours.define(
    "nms(Tensor dets, Tensor scores, float iou_threshold) -> Tensor"
)  # torchvision may be built for another torch

from lerobot.datasets.lerobot_dataset import LeRobotDataset  # noqa: E402, it imports torchvision


def main(folder: str, out: str) -> None:
    """Read every frame, one by one, as training would."""
    dataset = LeRobotDataset("demos", root=folder, video_backend="pyav")
    rows = [dataset[number] for number in range(len(dataset))]
    columns = {key: np.stack([np.asarray(row[key]) for row in rows]) for key in rows[0]}
    facts = {
        "episodes": dataset.num_episodes,
        "fps": dataset.fps,
        "mean": dataset.meta.stats["observation.state"]["mean"],
    }
    np.savez(out, **columns, **facts)


if __name__ == "__main__":
    main(*sys.argv[1:])
