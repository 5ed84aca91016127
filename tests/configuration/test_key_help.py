"""``--help`` explains every key with the comments in conf/."""

import functools

import pytest

from splatrl.configuration import key_help as key_help_module
from splatrl.configuration import load_config, options
from splatrl.configuration.command_line import command_line
from splatrl.configuration.key_help import MOST_USED, WIDEST, comments_of, help_page, key_help
from splatrl.configuration.typed_words import MAIN_KEYS

CHOICES = [
    *([f"task={task}"] for task in options("task")),
    ["scene=many", "scene.paths=[backyard]"],
    ["scene=file", "memory=gru", "transforms/appearance=varied", "collision=fcl", "motion@task.motion=drive"],
    ["scene=kitchen", "memory=stack", "transforms/pose_noise=unsteady", "collision=none", "rewards@task.rewards=unit"],
    ["ppo=many", "renderer=reference", "transforms/skip=four", "curriculum=none", "motion@task.motion=forward"],
    ["renderer=gsplat", "transforms/sprite=apple"],
]


@pytest.fixture(autouse=True, scope="module")
def read_once():
    """Cache the comments of files, since every page needs the same ones."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(key_help_module, "comments_of", functools.cache(comments_of))
        yield


@pytest.mark.parametrize(
    ("name", "overrides"), [*((name, []) for name in MAIN_KEYS), *(("train", choice) for choice in CHOICES)]
)
def test_every_key_and_every_option_is_explained(name, overrides):
    found = key_help(name, overrides)
    assert [key for key in found.values if not found.comments.get(key)] == []
    assert [(one.key, option) for one in found.choices for option, said in one.options.items() if not said] == []
    assert found.header


@pytest.mark.parametrize(
    ("keys", "choice"),
    [
        (["curriculum.first", "collision.occupancy.fill", "renderer.cache", "starts.farthest"], []),
        (["starts.farthest"], ["task=imagenav"]),
        (["task.motion.gait", "task.motion.ceiling", "task.motion.linear"], ["task=walk"]),
    ],
)
def test_null_is_accepted_for_keys_whose_comment_mentions_it(keys, choice):
    typed = [*choice, *(f"{key}=null" for key in keys)]
    assert command_line("train", typed) == typed
    found = key_help("train", choice)
    assert all("null" in found.comments[key] for key in keys)


@pytest.mark.parametrize("name", MAIN_KEYS)
def test_a_page_lists_every_key_of_the_config_within_the_terminals_width(name, monkeypatch):
    monkeypatch.setenv("COLUMNS", "80")
    assert 70 < max(map(len, help_page(name).splitlines())) <= 80
    monkeypatch.setenv("COLUMNS", "300")
    page = help_page(name)
    assert 80 < max(map(len, page.splitlines())) <= WIDEST
    for key in load_config(name=name):
        if key == "drawing":  # which only says what to build
            continue
        assert any(line.startswith((f"{key}=", f"{key}.")) for line in page.splitlines()), key


@pytest.mark.parametrize("name", MOST_USED)
def test_the_most_used_keys_come_first(name):
    page = help_page(name, ["scene=file"])
    places = [page.index(f"\n{key}=") for key in MOST_USED[name]]
    assert places == sorted(places)
    assert places[-1] < page.index("CHOICES") < page.index("ALL KEYS")


def test_the_page_describes_the_config_that_was_typed(capsys):
    with pytest.raises(SystemExit) as end:
        command_line("train", ["task=apple", "seed=7", "--help"])
    assert not end.value.code
    page = capsys.readouterr().out
    assert "\nseed=7 " in page
    assert "\n  * apple " in page
    assert "\ntask.reach=1.1 " in page


def test_a_mistake_is_reported_instead_of_the_help():
    with pytest.raises(SystemExit, match="sed: no such key"):
        command_line("train", ["sed=7", "-h"])


def test_the_comments_of_a_yaml_file_are_found_by_key():
    found = comments_of(
        "# @package _global_\n# What it is.\n# More.\ndefaults:\n  - /a@b.c: one  # which\n"
        "  - override /d: two  # why\na: '#1'  # first # still\nb:  # second\n"
        "  c: [1,\n    2]  # third\n  d: {e: 1}\n  f:\n    - 1  # no key\n"
    )
    assert found.package == ""
    assert found.header == "What it is."
    assert found.groups == {"a": "which"}
    assert found.keys == {"a": "first # still", "b": "second", "b.c": "third"}
    assert comments_of("{}").keys == {}


def test_keys_that_options_have_in_common_have_the_same_explanation():
    published, unit = (key_help("train", [f"rewards@task.rewards={name}"]) for name in ("published", "unit"))
    assert published.comments["task.rewards.goal"] == unit.comments["task.rewards.goal"] != ""


def test_a_node_whose_keys_have_no_comments_is_one_line():
    found = key_help("experiment")
    assert found.values["scene_overrides"] == "{...}"
    assert found.comments["experiments.grid"].startswith("I: ")
