"""Caches that let Hydra compose configs faster: it would otherwise parse and merge forty files for each config."""

import copy
import functools
import io
import operator
import pickle
import sys
from collections.abc import Callable
from contextlib import suppress
from hashlib import blake2b
from itertools import takewhile
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import hydra
import omegaconf
from hydra._internal import config_loader_impl, defaults_list
from hydra._internal.config_loader_impl import ConfigLoaderImpl
from hydra._internal.config_repository import CachingConfigRepository, ConfigRepository
from hydra.core.config_store import ConfigStore
from hydra.core.override_parser.overrides_parser import OverridesParser
from omegaconf import OmegaConf, flag_override, grammar_parser
from omegaconf.errors import OmegaConfBaseException

from tests.builds import built

CONF = Path(__file__).parents[1] / "conf"
CODE = Path(__file__).parents[1] / "splatrl" / "configuration"
SHIPPED = {"pkg://hydra.conf", "structured://", f"file://{CONF}"}
"""Sources of configs that no test changes."""


def parse_once() -> None:
    """Cache what Hydra and OmegaConf would otherwise compute again for each config.

    ``OmegaConf.load`` caches the texts of open files; each call still gets its own config. Hydra collects the values
    that defaults may refer to only if one of them is an interpolation, not for each of the forty files, and does not
    copy schemas with its list of folders. It caches parsed overrides and, for files that no test changes, their
    content, the files that groups choose and the merged config: a command composes its config twice, to learn whether
    it is one run or a sweep, and to run. The last two take longest, so all processes and runs share them.
    """
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
    """Cache parsed overrides, which a command parses up to five times, and parsed interpolations."""
    parse = OverridesParser.parse_rule

    @functools.cache
    def parsed(word: str, rule: str) -> bytes:
        return pickle.dumps(parse(OverridesParser.create(), word, rule))

    OverridesParser.parse_rule = lambda self, s, rule_name: pickle.loads(parsed(s, rule_name))
    references = functools.cache(grammar_parser.parse)
    for module in (omegaconf.base, omegaconf._utils):
        module.parse = references


def _shipped(repo: Any) -> tuple[str, ...]:
    """Return the sources of configs, or nothing if a test may change some of them."""
    places = tuple(source.full_path() for source in repo.get_sources())
    return places if SHIPPED.issuperset(places) else ()


@functools.cache
def _sources() -> bytes:
    """Return a digest of all that a config composed from ``SHIPPED`` depends on, apart from what is chosen in it."""
    libraries = sys.version, hydra.__version__, omegaconf.__version__, ConfigStore.instance().repo
    digest = blake2b(repr(libraries).encode())
    for path in sorted([Path(__file__), *CODE.glob("*.py"), *CONF.rglob("*.yaml")]):
        digest.update(path.relative_to(CONF.parent).as_posix().encode() + path.read_bytes())
    return digest.digest()


def _shared(key: str, make: Callable[[], object]) -> bytes:
    """Return a pickled object that depends only on a key and on ``_sources``; the first process that asks makes it."""
    name = blake2b(key.encode(), key=_sources(), digest_size=16).hexdigest()
    return built(f"config-{name}.pickle", lambda made: made.write_bytes(pickle.dumps(make()))).read_bytes()


def _read_once() -> None:
    """Cache the content of files."""
    load, known = ConfigRepository.load_config, dict[tuple[str, ...], bytes]()

    def read(self: Any, config_path: str) -> Any:
        if not (places := _shipped(self)):
            return load(self, config_path)
        if (key := (*places, config_path)) not in known:
            known[key] = pickle.dumps(load(self, config_path))
        return pickle.loads(known[key])

    ConfigRepository.load_config = read


def _choose_once() -> None:
    """Cache the files that the options of groups choose together; only a few overrides are such options."""
    choose, known = config_loader_impl.create_defaults_list, dict[str, bytes]()

    def chosen(repo: Any, config_name: Any, overrides_list: Any, prepend_hydra: bool, skip_missing: bool) -> Any:
        if not (places := _shipped(repo)):
            return choose(repo, config_name, overrides_list, prepend_hydra, skip_missing)
        values = defaults_list.Overrides(repo, overrides_list).config_overrides
        groups = [each for each in overrides_list if all(each is not value for value in values)]
        key = repr((places, config_name, [each.input_line for each in groups], prepend_hydra, skip_missing))
        if key not in known:
            known[key] = _shared(key, lambda: choose(repo, config_name, groups, prepend_hydra, skip_missing))
        result = pickle.loads(known[key])
        result.config_overrides = values
        return result

    config_loader_impl.create_defaults_list = chosen


def _merge_once() -> None:
    """Cache merged files, and start from them when other files follow."""
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
            with suppress(OmegaConfBaseException):  # merging below lets Hydra name the file
                known[key] = _shared(repr(key), lambda: merge(self, [begin(self, defaults, repo, key)], repo))
        return pickle.loads(known[key]) if key in known else merge(self, defaults, repo)

    ConfigLoaderImpl._load_single_config = loaded
    ConfigLoaderImpl._compose_config_from_defaults_list = merged


def compose_once() -> None:
    """Share the configs that choices from groups make with all processes and runs; a process caches only its own."""
    from splatrl.configuration import search_path

    compose = search_path._chosen

    @functools.cache
    def chosen(name: str, *choices: str) -> bytes:
        with search_path.config_loader() as loader:
            if not (places := _shipped(loader.repository)):
                return compose(name, *choices)
        return pickle.loads(_shared(repr((places, name, choices)), lambda: compose(name, *choices)))

    search_path._chosen = chosen
