"""Policies are tested in clear weather and in each kind of weather alone, whatever they were trained in."""

from pathlib import Path

import pytest

from splatrl.configuration import load_config, run_config
from splatrl.experiments import weathers
from splatrl.experiments.weathers import KINDS, WEATHERS, in_weather, score_weathers
from tests.experiments.test_transfer import run_of


def test_a_test_has_one_kind_of_weather_in_every_episode_and_no_other(tmp_path: Path) -> None:
    own = run_config(run_of(tmp_path, "room", "transforms/appearance=weather", "transforms.appearance.snow=0").folder)
    assert own.transforms.appearance.snow == 0 and own.transforms.appearance.often == 0.5
    snowy, usual = in_weather(own, ["snow"]), load_config(["transforms/appearance=weather"])
    weather = snowy.transforms.appearance
    assert weather.often == 1 and weather.snow == usual.transforms.appearance.snow > 0
    assert all(weather[kind] == 0 for kind in KINDS if kind != "snow")
    clear = in_weather(own, [])
    assert not clear.transforms.appearance and clear.around_drawing is None
    assert own.transforms.appearance.snow == 0  # the run's own config is unchanged


def test_every_policy_is_tested_in_every_weather_even_if_trained_without(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    runs = [
        run_of(tmp_path, "room", "evaluation.starts=6", "task.max_steps=8"),
        run_of(tmp_path, "part", "evaluation.starts=5", "task.max_steps=8", "transforms/appearance=weather"),
    ]
    rows = score_weathers(runs, tmp_path)
    assert [(row["run"], row["place"]) for row in rows[:2]] == [
        ("room-a-s0", "room, clear"),
        ("part-a-s0", "part, clear"),
    ]
    assert [row["place"] for row in rows if row["run"] == "room-a-s0"] == [f"room, {name}" for name in WEATHERS]
    assert all(0 <= row["success_rate"] <= 1 for row in rows) and {row["starts"] for row in rows} == {5, 6}
    some = dict(list(WEATHERS.items())[:2])
    monkeypatch.setattr(weathers, "WEATHERS", some)
    assert rows[: 2 * len(some) : 2] == score_weathers(runs[:1], tmp_path)  # whichever other runs are tested
