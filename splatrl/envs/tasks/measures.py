"""Measures of navigation that are computed from how far a robot was from its goal, and how far it went."""

from collections.abc import Mapping

import torch
from torch import Tensor


def path_measures(success: Tensor, distances: Mapping[str, Tensor]) -> dict[str, Tensor]:
    """Compute ``spl`` and ``soft_spl`` of episodes as they stand, under Habitat's names: float64, in [0, 1].

    ``spl`` is success weighted by path length (Anderson et al. 2018, eq. 1), that is start distance / max(start
    distance, path length), which is 1 if both are 0, or 0 without success. ``soft_spl`` (Datta et al. 2020) has
    progress, the fraction of the start distance by which the robot came nearer, in place of success.

    Args:
        success: [...] bool, whether an episode has succeeded.
        distances: ``start_distance`` and ``distance_to_goal``, geodesic, and ``path_length``: [...], metres.
    """
    far, start, path = (distances[key].double() for key in ("distance_to_goal", "start_distance", "path_length"))
    longer = torch.maximum(start, path)
    ratio = torch.where(longer > 0.0, start / longer.clamp_min(1e-9), 1.0)
    progress = (1.0 - far / start.clamp_min(1e-9)).clamp_min(0.0)
    return {"spl": success * ratio, "soft_spl": progress * ratio}
