"""Scores policies by how often they act in a clip as its labels say: Experiment IV of the paper.

Labels come from a person or a planner.
"""

from collections import deque
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import torch
from PIL import Image
from tensordict import TensorDict, TensorDictBase
from tensordict.nn import TensorDictModuleBase
from torch import Tensor

from splatrl.documents import write_json
from splatrl.evaluation.clip_files import Clip
from splatrl.evaluation.policy_camera import Eye
from splatrl.evaluation.rollouts import acting
from splatrl.files import replacing

REPORT = "clips"
HEADLINE = (
    "Fraction of labelled frames in which the policy's most probable action is among the label's actions; "
    "in brackets, the mean total probability of the label's actions."
)


@dataclass(frozen=True)
class ClipResult:
    """Score of a policy on the labelled frames of a clip.

    Attributes:
        name: name of the clip.
        frames: number of labelled frames.
        matches: number of labelled frames whose most probable action is one of the label's.
        mass: total probability that the policy gives to the label's actions, averaged over labelled frames.
    """

    name: str
    frames: int
    matches: int
    mass: float

    @property
    def rate(self) -> float:
        """Fraction of labelled frames that match."""
        return self.matches / self.frames


def total(results: Sequence[ClipResult]) -> ClipResult:
    """Combine the results of all clips into one, in which every labelled frame has equal weight."""
    frames = sum(one.frames for one in results)
    mass = sum(one.frames * one.mass for one in results) / frames
    return ClipResult("total", frames, sum(one.matches for one in results), mass)


def match(
    policy: TensorDictModuleBase,
    action_names: Sequence[str],
    clips: Sequence[Clip],
    eye: Eye,
    start: TensorDictBase | None = None,
    progress: Callable[[int], object] = lambda frames: None,
) -> list[ClipResult]:
    """Show clips to a policy frame by frame, and compare its most probable action with the labels.

    A policy with stacked frames also sees the preceding ones, oldest first, padded at the start of a clip with its
    first frame. A recurrent state is reset for each clip and carried through it. PyTorch's global generator is left
    as it was.

    Args:
        policy: reads ``pixels`` and whatever else its ``in_keys`` name, writes ``logits``.
        action_names: names of the task's actions, by index.
        clips: clips that were read with the same names.
        eye: the camera as which the policy sees the clips.
        start: batch of [1] with everything but ``pixels`` that the policy reads at the start of an episode, such as a
            recurrent state of zeros; None if it reads nothing else.
        progress: called with the number of frames just shown.

    Raises:
        ValueError: for a clip that cannot be read, a policy with another number of actions, or one that reads keys that
            are not given.
    """
    results = []
    for clip in clips:
        matches, masses = 0, []
        with acting(sampled=False, seed=0):
            shown = predictions(policy, action_names, clip.images(), eye, start)
            for number, (_, _, probabilities) in enumerate(shown):
                if (label := clip.labels.get(number)) is not None:
                    matches += int(probabilities.argmax()) in label
                    masses.append(float(probabilities[sorted(label)].sum()))
                progress(1)
        results.append(ClipResult(clip.name, len(masses), matches, sum(masses) / len(masses)))
    return results


def predictions(
    policy: TensorDictModuleBase,
    action_names: Sequence[str],
    images: Iterable[Image.Image],
    eye: Eye,
    start: TensorDictBase | None = None,
) -> Iterator[tuple[Image.Image, Tensor, Tensor]]:
    """Show images to a policy one after another, as ``match`` does, and yield its action probabilities.

    Args:
        policy: as for ``match``.
        action_names: names of the A actions.
        images: RGB images of any size.
        eye: as for ``match``.
        start: batch of [1], as for ``match``.

    Yields:
        The image, its version that the policy sees, [H, W, 3] uint8, and the probabilities of the actions, [A].

    Raises:
        ValueError: for a policy with another number of actions, or one that reads keys that are not given.
    """
    begun = TensorDict({}, [1]) if start is None else start
    extra = [key for key in policy.in_keys if key != "pixels"]
    missing = [key for key in extra if key not in begun.keys(True)]
    if missing:
        raise ValueError(f"start: expected {', '.join(map(str, missing))}, which the policy reads, found none")
    begun = begun.select(*extra)
    seen: deque[Tensor] = deque(maxlen=eye.views)
    carried = begun.clone()
    for number, image in enumerate(images):
        frame = eye.fitted(image)
        seen.extend([frame] * eye.views if not number else [frame])
        out = policy(carried.clone().set("pixels", torch.cat(list(seen), -1).unsqueeze(0).to(carried.device)))
        probabilities = out["logits"].softmax(-1)[0]
        if len(probabilities) != len(action_names):
            names = ", ".join(action_names)
            raise ValueError(
                f"policy: expected {len(action_names)} actions ({names}), got a policy with {len(probabilities)}"
            )
        yield image, frame, probabilities
        after = out.get("next", TensorDict({}, [1]))
        for key in begun.keys():  # noqa: SIM118, iterating over a TensorDict runs along its batch
            carried[key] = after.get(key, begun[key])
        if "is_init" in carried.keys():  # noqa: SIM118
            carried["is_init"] = torch.zeros_like(carried["is_init"])


def table(results: Mapping[str, Sequence[ClipResult]]) -> str:
    """Format match rates as a Markdown table, with one row per clip, one for the total, and one column per run.

    The mean probability of the label's actions is in brackets.

    Args:
        results: results on the same clips, by run.
    """
    runs = list(results)
    rows = [["clip", "frames", *runs], ["---", "---:", *["---:"] * len(runs)]]
    columns = [[*found, total(found)] for found in results.values()]
    for line in zip(*columns, strict=True):
        cells = [f"{one.rate:.3f} ({one.mass:.3f})" for one in line]
        rows.append([line[0].name, str(line[0].frames), *cells])
    return "".join(f"| {' | '.join(row)} |\n" for row in rows)


def write_report(results: Mapping[str, Sequence[ClipResult]], folder: Path) -> str:
    """Write ``clips.md`` and ``clips.json``; return the content of the former.

    Args:
        results: results on the same clips, by run.
        folder: folder to write to.
    """
    page = f"{HEADLINE}\n\n{table(results)}"
    folder.mkdir(parents=True, exist_ok=True)
    content = {
        run: {"clips": [asdict(one) | {"rate": one.rate} for one in found], "rate": total(found).rate}
        for run, found in results.items()
    }
    write_json(folder / f"{REPORT}.json", content)
    with replacing(folder / f"{REPORT}.md") as stream:
        stream.write(page.encode())
    return page
