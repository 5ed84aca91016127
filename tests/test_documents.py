"""YAML and JSON from strangers become small plain values, or raise a clear error."""

import json
import math
import time
from pathlib import Path

import pytest
import torch

from splatrl.documents import MAX_DEPTH, MAX_YAML, read_config, read_json, read_yaml, write_json

BOMB = "a: &a [x, x, x, x, x, x, x, x, x]\n" + "".join(
    f"{name}: &{name} [{', '.join([f'*{before}'] * 9)}]\n" for before, name in zip("abcdefg", "bcdefgh", strict=True)
)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (BOMB, r"the alias \*a"),
        ("a: &x 1\nb: {<<: *x}", r"the alias \*x"),
        ("a: &x [1]\nb: [\n\ufeff', *x, \"' , # \"\n]", r"the alias \*x"),
        ("a: " + "[" * 10_000, f"nested more than {MAX_DEPTH} deep"),
        ("a: [" * 10_000, f"nested more than {MAX_DEPTH} deep"),
        ("a: " + "${" * 3000, "expected plain YAML"),
        ("a: !!python/object/apply:os.system [ls]", "python/object"),
        ("a: 1\na: 2", "duplicate key"),
        ("? [a]\n: 1", "expected plain YAML"),
        ("? {a: 1}\n: 1", "expected plain YAML"),
        (f"a: {'9' * 5000}", "expected plain YAML"),
        ("a: !!binary x", "the tag !!binary in line 1"),
        ("b: 1\na: !!binary aGk=", "the tag !!binary in line 2"),
        ("a: !!timestamp 99999-99-99", "the tag !!timestamp in line 1"),
        ("a: !!set {1}", "expected plain YAML"),
        ("\x00", "an error in line 1, column 1: the character"),
        ("a: 1\nb: \x07", r"an error in line 2, column 4: the character '\\x07'"),
        ("- [", "got an error in line 1, column 4: expected the node content"),
        ("a: 1\n b: 2", "got an error in line 2, column 3: mapping values are not allowed here"),
        ("#" * MAX_YAML + "\n", "expected at most 131,072 bytes"),
    ],
    ids=[
        "exponential aliases",
        "merge key",
        "alias after a byte order mark",
        "nested lists",
        "nested mappings",
        "nested references",
        "Python tag",
        "duplicate key",
        "list as a key",
        "mapping as a key",
        "huge number",
        "invalid binary",
        "binary",
        "invalid date",
        "set",
        "null byte",
        "control character",
        "unclosed list",
        "indented key",
        "too large",
    ],
)
def test_yaml_that_expands_runs_code_or_is_invalid_is_refused_by_file(text: str, message: str, tmp_path: Path) -> None:
    path = tmp_path / "config.yaml"
    path.write_text(text, encoding="utf-8")
    began = time.process_time()
    with pytest.raises(ValueError, match=message) as refused:
        read_yaml(path)
    assert str(path) in str(refused.value) and "\n" not in str(refused.value)
    assert time.process_time() - began < 60  # not a test of speed: expanding it would take hours


def test_yaml_that_is_not_text_is_refused(tmp_path: Path) -> None:
    (tmp_path / "a.yaml").write_bytes(b"a: \xff\xfe")
    with pytest.raises(ValueError, match="expected UTF-8 text"):
        read_yaml(tmp_path / "a.yaml")


@pytest.mark.parametrize(
    "text", ["a: ${oc.env:HOME}", "a: '${b}${b}'", "a: '\\${oc.env:HOME}'", "'${oc.env:HOME}': 1", "a: [{b: 'x ${a}'}]"]
)
def test_a_config_may_refer_only_to_its_own_keys(text: str, tmp_path: Path) -> None:
    (tmp_path / "a.yaml").write_text(text)
    with pytest.raises(ValueError, match=r"a\.yaml: expected references to a single key"):
        read_config(tmp_path / "a.yaml")
    assert "${" in str(read_yaml(tmp_path / "a.yaml"))  # in other documents it is plain text


def test_plain_yaml_is_read_and_a_config_may_refer_to_itself(tmp_path: Path) -> None:
    (tmp_path / "a.yaml").write_text("a: {b: 1e-3}\nc: ${a.b}\nd: [1, null, 'x']\n")
    assert read_yaml(tmp_path / "a.yaml") == {"a": {"b": 0.001}, "c": "${a.b}", "d": [1, None, "x"]}
    assert read_config(tmp_path / "a.yaml").c == 0.001


@pytest.mark.parametrize(
    "text",
    ["[" * 100_000, '{"a":' * 100_000, "9" * 5000, "{", ""],
    ids=["nested lists", "nested objects", "huge number", "unclosed object", "empty"],
)
def test_json_that_is_broken_or_too_deep_is_refused_by_file(text: str, tmp_path: Path) -> None:
    path = tmp_path / "a.json"
    path.write_text(text)
    with pytest.raises(ValueError, match=r"a\.json: expected JSON"):
        read_json(path)


def test_json_is_read_up_to_a_maximum_size(tmp_path: Path) -> None:
    path = tmp_path / "a.json"
    path.write_text(json.dumps({"a": [1.5]}))
    assert read_json(path) == {"a": [1.5]}
    with pytest.raises(ValueError, match="expected at most 4 bytes"):
        read_json(path, 4)


def test_yaml_that_is_a_bare_number_is_refused_by_name(tmp_path: Path) -> None:
    (tmp_path / "a.yaml").write_text("5")
    with pytest.raises(ValueError, match=r"a\.yaml: expected plain YAML"):
        read_yaml(tmp_path / "a.yaml")


def test_json_is_written_whole_or_not_at_all(tmp_path: Path) -> None:
    path = tmp_path / "evaluation.json"
    write_json(path, {"success_rate": 0.5})
    with pytest.raises(TypeError):
        write_json(path, {"success_rate": torch.zeros(1)})
    assert json.loads(path.read_text()) == {"success_rate": 0.5}
    assert list(tmp_path.iterdir()) == [path]


def test_numbers_that_json_does_not_have_become_null(tmp_path: Path) -> None:
    path = tmp_path / "evaluation.json"
    write_json(path, {"scenes": [{"success_rate": math.nan, "distance": math.inf, "spl": 0.5}]})
    assert json.loads(path.read_text(), parse_constant=pytest.fail) == {
        "scenes": [{"success_rate": None, "distance": None, "spl": 0.5}]
    }
