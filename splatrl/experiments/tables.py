"""Markdown tables and sentences for a report."""

import math
from collections.abc import Mapping, Sequence
from typing import Any

from splatrl.experiments.experiment import Experiment
from splatrl.experiments.results import Entry, Spread, comparable

RATES = ("success_rate", "success_rate_argmax", "collision_rate", "step_spl", "spl")
"""Rates that are reported for a policy tested in several scenes."""
NOWHERE = "–"
"""Training scene shown for baselines that never learned."""
SIGNIFICANT = 0.05
"""Probability below which a difference is taken for more than chance."""
TOTAL = "**all**"
"""Name of the row that combines all clips of a scene."""


def table(header: Sequence[str], rows: Sequence[Sequence[str]], words: int = 2) -> list[str]:
    """Format a Markdown table whose first columns hold words and whose others hold numbers.

    Args:
        header: column titles.
        rows: rows, each as long as the header.
        words: number of columns that hold words, which are left-aligned; numbers are right-aligned.
    """
    rule = ["---"] * words + ["---:"] * (len(header) - words)
    return [f"| {' | '.join(cells)} |" for cells in (header, rule, *rows)]


def main_table(found: Sequence[Entry]) -> list[str]:
    """Build the table of what the policies reach from the start set, and of the training that it took."""
    header = ["scene", "arm", "seeds", "success", "argmax", "SPL", "level", "frames", "training, s", "frames/s"]
    rows = [
        [
            entry.scene,
            entry.label,
            entry.seeds(),
            f"**{entry.spread('success_rate').percent()}**" if entry.runs else "–",
            entry.spread("success_rate_argmax").percent(),
            entry.spl().text(3),
            entry.spread("level").text(1) if entry.has_curriculum else "–",
            f"{entry.spread('frames').mean:,.0f}" if entry.runs else "–",
            entry.spread("wall_seconds").text(),
            entry.speed().text(),
        ]
        for entry in found
    ]
    return table(header, rows)


def marks_table(found: Sequence[Entry], experiment: Experiment) -> list[str]:
    """Build the table of test success during training, and of when a test first reached the threshold."""
    marks = [f"at {mark:,}" for mark in experiment.marks]
    goal = f"{experiment.threshold:.0%}"
    header = ["scene", "arm", *marks, f"frames to {goal}", f"minutes to {goal}", "seeds that reached it"]
    rows = []
    for entry in found:
        first, minutes = entry.frames_to(experiment.threshold), entry.minutes_to(experiment.threshold)
        tested = [entry.tested_at(mark).percent() for mark in experiment.marks]
        there = f"{len(first.values)} of {len(entry.runs)}"
        rows.append([entry.scene, entry.label, *tested, first.text(), minutes.text(1), there])
    return table(header, rows)


def verdicts(found: Sequence[Entry]) -> list[str]:
    """Write one sentence per scene and number of frames: which arm won, and whether the seeds support that.

    An arm wins if it differs from the next best one by more than chance; see ``chance_of_difference``.
    """
    return [f"- {_verdict(group)}" for group in comparable(found)]


def _verdict(group: Sequence[Entry]) -> str:
    place = f"{group[0].scene}, {group[0].budget:,} frames"
    ranked = sorted(group, key=lambda entry: -entry.spread("success_rate").mean)
    best, *others = ranked
    first = best.spread("success_rate")
    if not others:
        seeds = f"{len(best.runs)} seed{'s' if len(best.runs) > 1 else ''}"
        spl = best.spl().text(3)
        return f"**{place}**: {best.label} reaches {first.percent()}, SPL {spl}, over {seeds}."
    second = others[0].spread("success_rate")
    if min(len(first.values), len(second.values)) < 2:
        level = [entry for entry in ranked if entry.spread("success_rate").percent() == first.percent()]
        names = " and ".join(entry.label for entry in level)
        lead = f"{names} are level" if len(level) > 1 else f"{names} is ahead"
        rest = f", against {_rates(ranked[len(level) :])}" if len(level) < len(ranked) else ""
        return f"**{place}**: {lead} with {first.percent()}{rest}; a single seed is not conclusive."
    chance = chance_of_difference(first, second)
    told = "p < 0.001" if chance < 0.001 else f"p = {chance:.2g}"
    if chance < SIGNIFICANT:
        return f"**{place}**: {best.label} won with {first.percent()}, against {_rates(others)} ({told})."
    return f"**{place}**: no clear winner; {_rates(ranked)}: chance may explain how the first two differ ({told})."


def _rates(found: Sequence[Entry]) -> str:
    """List arms with their success rates."""
    return ", ".join(f"{entry.label} {entry.spread('success_rate').percent()}" for entry in found)


def chance_of_difference(first: Spread, second: Spread) -> float:
    """Return how probable a difference of two means would be that is at least as large, if there were none in truth.

    It is the two-sided p-value of Welch's t-test over the seeds, at least two of each, which does not assume that both
    vary as much (Colas et al. 2019, "A Hitchhiker's Guide to Statistical Comparisons of Reinforcement Learning
    Algorithms"). That is undefined where no seed differs from another of its arm, as at a success of 100 %; then it is
    the p-value of the permutation test, which two or three seeds per arm cannot bring below 0.05.
    """
    if first.deviation == second.deviation == 0.0:
        seeds = len(first.values), len(second.values)
        return 1.0 if first.mean == second.mean else 2.0 / math.comb(sum(seeds), seeds[0])
    from scipy.stats import ttest_ind_from_stats  # slow to import

    summaries = (value for each in (first, second) for value in (each.mean, each.deviation, len(each.values)))
    return float(ttest_ind_from_stats(*summaries, equal_var=False).pvalue)


def scores_table(scores: Sequence[Mapping[str, Any]], experiment: Experiment) -> list[str]:
    """Build the table of match rates: fractions of labelled frames with a correct action, one column per arm.

    Args:
        scores: one row per run and clip: ``run`` (name of its folder), ``clip``, ``frames`` and ``matches``.
        experiment: the experiment to which the runs belong.
    """
    found = _match_rates(scores, experiment)
    labels = list(dict.fromkeys(run.label for run in experiment.runs))
    rows = [
        [scene, clip, f"{frames:,}", *(rates.get(label, Spread(())).percent() for label in labels)]
        for (scene, clip), (frames, rates) in found.items()
    ]
    return table(["scene", "clip", "frames", *labels], rows)


def scores_sentences(scores: Sequence[Mapping[str, Any]], experiment: Experiment) -> list[str]:
    """Write one sentence per scene with the match rate of each arm over all clips.

    Args:
        scores: as for ``scores_table``.
        experiment: the experiment to which the runs belong.
    """
    lines = []
    for (scene, clip), (frames, rates) in _match_rates(scores, experiment).items():
        if clip == TOTAL:
            each = ", ".join(f"{label} {rate.percent()}" for label, rate in rates.items())
            lines.append(
                f"- **{scene}, labelled clips**: fraction of {frames:,} frames in which the actions match: {each}."
            )
    return lines


def transfer_table(tests: Sequence[Mapping[str, Any]], experiment: Experiment) -> list[str]:
    """Build the table of policies tested in several scenes, one row per test place, training scene and arm.

    Args:
        tests: one row per run and place: ``run`` (name of its folder) or a baseline's ``label``, ``place``, ``starts``
            and rates.
        experiment: the experiment to which the runs belong.
    """
    header = ["tested in", "trained in", "arm", "seeds", "starts", "success", "argmax", "collisions", "SPL"]
    rows = []
    for (place, scene, label), found in _transfers(tests, experiment).items():
        spreads = {
            key: Spread(tuple(float(row[key]) for row in found if key in row)) for key in found[0] if key in RATES
        }
        rows.append(
            [
                place,
                scene,
                label,
                str(len(found)),
                f"{found[0]['starts']:,}",
                f"**{spreads['success_rate'].percent()}**",
                spreads["success_rate_argmax"].percent(),
                spreads["collision_rate"].percent(),
                next((spreads[key].text(3) for key in ("spl", "step_spl") if key in spreads), "–"),
            ]
        )
    return table(header, rows, words=3)


def transfer_sentences(tests: Sequence[Mapping[str, Any]], experiment: Experiment) -> list[str]:
    """Write one sentence per place with the success there of the policies of each training scene and arm.

    Args:
        tests: as for ``transfer_table``.
        experiment: the experiment to which the runs belong.
    """
    said: dict[str, list[str]] = {}
    for (place, scene, label), found in _transfers(tests, experiment).items():
        rate = Spread(tuple(float(row["success_rate"]) for row in found)).percent()
        said.setdefault(place, []).append(
            f"{rate} ({label})" if scene == NOWHERE else f"{rate} ({label}, trained in {scene})"
        )
    return [
        f"- **tested in {place}**, with a steady camera: success {', '.join(each)}." for place, each in said.items()
    ]


def _transfers(
    tests: Sequence[Mapping[str, Any]], experiment: Experiment
) -> dict[tuple[str, str, str], list[Mapping[str, Any]]]:
    """Group tests by place, training scene and label, in the order of the experiment's scenes.

    A place is one of these scenes or another, with an optional detail such as the weather after a comma. Baselines
    that never learned come last in each place, under labels of their own.
    """
    runs = {run.folder.name: run for run in experiment.runs}
    places = (row["place"].partition(",")[0] for row in tests)
    scenes = list(dict.fromkeys([*(run.scene for run in experiment.runs), *places, NOWHERE]))
    groups: dict[tuple[str, str, str], list[Mapping[str, Any]]] = {}
    for row in tests:
        run = runs.get(row.get("run", ""))
        if run is not None or "label" in row:
            scene, label = (run.scene, run.label) if run is not None else (NOWHERE, row["label"])
            groups.setdefault((row["place"], scene, label), []).append(row)
    return dict(
        sorted(groups.items(), key=lambda group: [scenes.index(name.partition(",")[0]) for name in group[0][:2]])
    )


def _match_rates(
    scores: Sequence[Mapping[str, Any]], experiment: Experiment
) -> dict[tuple[str, str], tuple[int, dict[str, Spread]]]:
    """Compute, by scene and clip, the number of frames and each arm's match rates; a scene's total comes last."""
    runs = {run.folder.name: run for run in experiment.runs}
    counts: dict[tuple[str, str], dict[str, tuple[int, int]]] = {}
    for score in scores:
        run = runs.get(score["run"])
        if run is None:
            continue
        for clip in (score["clip"], TOTAL):
            seeds = counts.setdefault((run.scene, clip), {})
            frames, matches = seeds.get(score["run"], (0, 0))
            seeds[score["run"]] = (frames + score["frames"], matches + score["matches"])
    scenes = list(dict.fromkeys(run.scene for run in experiment.runs))
    labels = list(dict.fromkeys(run.label for run in experiment.runs))
    result = {}
    for scene, clip in sorted(counts, key=lambda key: (scenes.index(key[0]), key[1] == TOTAL)):
        found = counts[scene, clip]
        rates = {
            label: tuple(matches / frames for name, (frames, matches) in found.items() if runs[name].label == label)
            for label in labels
        }
        result[scene, clip] = (
            next(iter(found.values()))[0],
            {label: Spread(values) for label, values in rates.items() if values},
        )
    return result
