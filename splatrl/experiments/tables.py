"""Tables and sentences of a report, in markdown."""

import math
from collections.abc import Mapping, Sequence
from typing import Any

from splatrl.experiments.experiment import Experiment
from splatrl.experiments.results import Entry, Spread, comparable


def table(header: Sequence[str], rows: Sequence[Sequence[str]], words: int = 2) -> list[str]:
    """A markdown table: the first columns hold words, the rest numbers.

    Args:
        header: of the columns.
        rows: as long as the header.
        words: columns aligned to the left.
    """
    rule = ["---"] * words + ["---:"] * (len(header) - words)
    return [f"| {' | '.join(cells)} |" for cells in (header, rule, *rows)]


def main_table(found: Sequence[Entry]) -> list[str]:
    """What the policies reach from every start, and what that took."""
    header = ["scene", "arm", "seeds", "success", "argmax", "SPL", "level", "frames", "training, s", "frames/s"]
    rows = [
        [
            entry.scene,
            entry.label,
            str(len(entry.runs)),
            f"**{entry.spread('success_rate').percent()}**" if entry.runs else "–",
            entry.spread("success_rate_argmax").percent(),
            entry.spread("spl").text(3),
            entry.spread("level").text(1) if entry.has_curriculum else "–",
            f"{entry.spread('frames').mean:,.0f}" if entry.runs else "–",
            entry.spread("wall_seconds").text(),
            entry.speed().text(),
        ]
        for entry in found
    ]
    return table(header, rows)


def marks_table(found: Sequence[Entry], experiment: Experiment) -> list[str]:
    """Success in the tests along the way, and when a test first got to the threshold."""
    marks = [f"at {mark:,}" for mark in experiment.marks]
    header = ["scene", "arm", *marks, f"frames to {experiment.threshold:.0%}", "seeds that got there"]
    rows = []
    for entry in found:
        first = entry.frames_to(experiment.threshold)
        tested = [entry.tested_at(mark).percent() for mark in experiment.marks]
        rows.append([entry.scene, entry.label, *tested, first.text(), f"{len(first.values)} of {len(entry.runs)}"])
    return table(header, rows)


def verdicts(found: Sequence[Entry]) -> list[str]:
    """A sentence a scene and number of frames: who won, and whether the seeds bear it out."""
    return [f"- {_verdict(group)}" for group in comparable(found)]


def _verdict(group: Sequence[Entry]) -> str:
    place = f"{group[0].scene}, {group[0].budget:,} frames"
    ranked = sorted(group, key=lambda entry: -entry.spread("success_rate").mean)
    best, *others = ranked
    first = best.spread("success_rate")
    if not others:
        seeds = f"{len(best.runs)} seed{'s' if len(best.runs) > 1 else ''}"
        spl = best.spread("spl").text(3)
        return f"**{place}**: {best.label} reaches {first.percent()}, SPL {spl}, over {seeds}."
    second = others[0].spread("success_rate")
    rest = ", ".join(f"{entry.label} {entry.spread('success_rate').percent()}" for entry in others)
    noise = max(_deviation(first), _deviation(second))
    if math.isinf(noise):
        return f"**{place}**: {best.label} is ahead with {first.percent()}, against {rest}; one seed settles nothing."
    if first.mean - second.mean > noise:
        return f"**{place}**: {best.label} won with {first.percent()}, against {rest}."
    return (
        f"**{place}**: no clear winner; {best.label} {first.percent()}, {rest}: "
        "the first two differ by no more than their seeds do."
    )


def _deviation(spread: Spread) -> float:
    return spread.deviation if len(spread.values) > 1 else math.inf


def scores_table(scores: Sequence[Mapping[str, Any]], experiment: Experiment) -> list[str]:
    """Share of frames of labelled clips in which the policy's action is among the right ones.

    Args:
        scores: a row a run and clip: ``run`` (name of its folder), ``clip``, ``frames`` and ``matches``.
        experiment: whose runs they are.
    """
    runs = {run.folder.name: run for run in experiment.runs}
    counts: dict[tuple[str, str, str], dict[str, tuple[int, int]]] = {}
    for score in scores:
        run = runs.get(score["run"])
        if run is None:
            continue
        for clip in (score["clip"], "**all**"):
            seeds = counts.setdefault((run.scene, run.label, clip), {})
            frames, matches = seeds.get(score["run"], (0, 0))
            seeds[score["run"]] = (frames + score["frames"], matches + score["matches"])
    arms = list(dict.fromkeys((run.scene, run.label) for run in experiment.runs))
    order = sorted(counts, key=lambda key: (arms.index(key[:2]), key[2] == "**all**"))
    rows = []
    for key in order:
        seeds = counts[key]
        rates = Spread(tuple(matches / frames for frames, matches in seeds.values() if frames))
        frames = next(iter(seeds.values()))[0]
        rows.append([*key, f"{frames:,}", str(len(seeds)), rates.percent()])
    return table(["scene", "arm", "clip", "frames", "seeds", "match"], rows, words=3)
