"""Lets Hydra compose configs in less time: for each, it would parse and merge forty files anew."""

import copy
import functools
import io
import operator
import pickle
from contextlib import suppress
from itertools import takewhile
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import omegaconf
from hydra._internal import config_loader_impl, defaults_list
from hydra._internal.config_loader_impl import ConfigLoaderImpl
from hydra._internal.config_repository import CachingConfigRepository, ConfigRepository
from hydra.core.override_parser.overrides_parser import OverridesParser
from omegaconf import OmegaConf, flag_override, grammar_parser
from omegaconf.errors import OmegaConfBaseException

SHIPPED = {"pkg://hydra.conf", "structured://", f"file://{Path(__file__).parents[1] / 'conf'}"}
"""Where configs come from that no test changes."""


def parse_once() -> None:
    """Let ``OmegaConf.load`` remember the texts of open files; each call still gets a config of its own. Let Hydra
    gather what defaults may refer to only where one of them does, not for each of the forty files, and copy no schemas
    with its list of folders. Let it remember words, and of files that no test changes what they hold, what groups
    choose and what it has merged: a command composes one config twice, to learn whether it runs once or several times,
    and to run."""
    load, gather = OmegaConf.load, defaults_list._create_interpolation_map

    @functools.cache
    def parsed(text: str | bytes) -> bytes:
        return pickle.dumps(load(io.StringIO(text) if isinstance(text, str) else io.BytesIO(text)))

    @functools.wraps(load)
    def remembered(file: Any) -> Any:
        return load(file) if isinstance(file, str | Path) else pickle.loads(parsed(file.read()))

    def gathered(overrides: Any, defaults: Any, self_added: bool) -> Any:
        return gather(overrides, defaults, self_added) if any(each.is_interpolation() for each in defaults) else None

    def begin(self: Any, delegate: Any) -> None:
        self.delegate, self.cache = copy.copy(delegate), {}

    OmegaConf.load = staticmethod(remembered)
    defaults_list._create_interpolation_map = gathered
    CachingConfigRepository.__init__ = begin
    _parse_words_once()
    _read_once()
    _choose_once()
    _merge_once()


def _parse_words_once() -> None:
    """Remember overrides, which a command parses up to five times, and references."""
    parse = OverridesParser.parse_rule

    @functools.cache
    def parsed(word: str, rule: str) -> bytes:
        return pickle.dumps(parse(OverridesParser.create(), word, rule))

    OverridesParser.parse_rule = lambda self, s, rule_name: pickle.loads(parsed(s, rule_name))
    references = functools.cache(grammar_parser.parse)
    for module in (omegaconf.base, omegaconf._utils):
        module.parse = references


def _shipped(repo: Any) -> tuple[str, ...]:
    """Where configs come from; nothing where a test may change some of them."""
    places = tuple(source.full_path() for source in repo.get_sources())
    return places if SHIPPED.issuperset(places) else ()


def _read_once() -> None:
    """Remember files."""
    load, known = ConfigRepository.load_config, dict[tuple[str, ...], bytes]()

    def read(self: Any, config_path: str) -> Any:
        if not (places := _shipped(self)):
            return load(self, config_path)
        if (key := (*places, config_path)) not in known:
            known[key] = pickle.dumps(load(self, config_path))
        return pickle.loads(known[key])

    ConfigRepository.load_config = read


def _choose_once() -> None:
    """Remember the files that options of groups, which stand in few of the overrides, choose together."""
    choose, known = config_loader_impl.create_defaults_list, dict[str, bytes]()

    def chosen(repo: Any, config_name: Any, overrides_list: Any, prepend_hydra: bool, skip_missing: bool) -> Any:
        if not (places := _shipped(repo)):
            return choose(repo, config_name, overrides_list, prepend_hydra, skip_missing)
        values = defaults_list.Overrides(repo, overrides_list).config_overrides
        groups = [each for each in overrides_list if all(each is not value for value in values)]
        key = repr((places, config_name, [each.input_line for each in groups], prepend_hydra, skip_missing))
        if key not in known:
            known[key] = pickle.dumps(choose(repo, config_name, groups, prepend_hydra, skip_missing))
        result = pickle.loads(known[key])
        result.config_overrides = values
        return result

    config_loader_impl.create_defaults_list = chosen


def _merge_once() -> None:
    """Remember what was merged of files, and begin with it where other files follow."""
    load, merge = ConfigLoaderImpl._load_single_config, ConfigLoaderImpl._compose_config_from_defaults_list
    known: dict[tuple[str, ...], bytes] = {}
    begun: dict[tuple[str, ...], bytes] = {(): pickle.dumps(OmegaConf.create())}

    def loaded(self: Any, default: Any, repo: Any) -> Any:
        return SimpleNamespace(config=default) if OmegaConf.is_config(default) else load(self, default, repo)

    def begin(self: Any, defaults: list[Any], repo: Any, key: tuple[str, ...]) -> Any:
        alike = max((sum(takewhile(bool, map(operator.eq, key, other))) for other in known), default=0)
        start = next(count for count in range(alike, -1, -1) if key[:count] in begun)
        cfg = pickle.loads(begun[key[:start]])
        for count in range(start, len(key)):
            if count == alike:
                begun[key[:count]] = pickle.dumps(cfg)
            with flag_override(cfg, "no_deepcopy_set_nodes", True):
                cfg.merge_with(load(self, defaults[count], repo).config)
        return cfg

    def merged(self: Any, defaults: list[Any], repo: Any) -> Any:
        if not (places := _shipped(repo)):
            return merge(self, defaults, repo)
        key = tuple(repr((places, each, each.override_key)) for each in defaults)
        if key not in known:
            with suppress(OmegaConfBaseException):  # of which Hydra says in which file it was
                known[key] = pickle.dumps(merge(self, [begin(self, defaults, repo, key)], repo))
        return pickle.loads(known[key]) if key in known else merge(self, defaults, repo)

    ConfigLoaderImpl._load_single_config = loaded
    ConfigLoaderImpl._compose_config_from_defaults_list = merged
