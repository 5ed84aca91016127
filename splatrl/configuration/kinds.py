"""Whether a value that was typed is of the kind of its key's default."""

from collections.abc import Callable, Mapping, Sequence

from omegaconf import DictConfig, OmegaConf
from omegaconf.errors import OmegaConfBaseException

from splatrl.configuration.grammar import written


def value_of(cfg: DictConfig, key: str) -> object:
    """Return the value of a key; None if it has no value, or refers to a key without one."""
    try:
        return OmegaConf.select(cfg, key, throw_on_missing=False)
    except OmegaConfBaseException:
        return None


def check_kind(key: str, usual: object, given: object, may_be_null: Callable[[str], bool]) -> None:
    """Refuse a value whose kind differs from that of the key's default; interpolations always pass.

    Args:
        key: the key, for the message.
        usual: the default in the configs; None accepts any value, and a string any word or number. A node accepts null.
        given: the value that was typed, as plain Python values.
        may_be_null: whether a key accepts null although its default is another value.

    Raises:
        ValueError: names the key, what was expected and what was given.
    """
    if usual is None or (isinstance(given, str) and "${" in given):
        return
    if given is None and (isinstance(usual, DictConfig) or may_be_null(key)):
        return
    if isinstance(usual, bool):
        fits, expected = isinstance(given, bool), "true or false"
    elif isinstance(usual, int | float):
        fits, expected = _is_number(given), f"a number such as {usual}"
    elif isinstance(usual, Sequence) and not isinstance(usual, str):
        numbers = len(usual) > 0 and all(map(_is_number, usual))
        fits = isinstance(given, list) and (not numbers or all(map(_is_number, given)))
        expected = f"a list such as [{','.join(map(str, usual))}]" if len(usual) else "a list in brackets"
    elif isinstance(usual, DictConfig):
        names = [f"{key}.{name!s}=..." for name in usual if not str(name).startswith("_")]
        fits, expected = isinstance(given, dict), f"keys and values, such as {(*names, key + '={}')[0]}"
        _check_names(key, usual, given if isinstance(given, dict) else {}, may_be_null)
    else:
        fits, expected = not isinstance(given, list | dict | None), f"a single value such as {usual}"
    if not fits:
        raise ValueError(f"{key}: expected {expected}, got {'nothing' if given == '' else written(given)}")


def _check_names(
    key: str, usual: DictConfig, given: Mapping[object, object], may_be_null: Callable[[str], bool]
) -> None:
    """Refuse keys that a node does not have, and values of another kind than theirs."""
    for name, value in given.items():
        where = f"{key}.{name}"
        if name not in list(usual):
            raise ValueError(f"{where}: no such key; to add one, type +{where}={written(value)}")
        check_kind(where, value_of(usual, str(name)), value, may_be_null)


def _is_number(value: object) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)
