"""What an override sets in the jobs of a sweep, the configs of these jobs, and what a sweeper looks for."""

from collections.abc import Sequence

from hydra.core.override_parser.types import Glob, Override
from omegaconf import DictConfig

from splatrl.configuration.grammar import bare
from splatrl.configuration.search_path import composed, options


def values(override: Override) -> list[object]:
    """Return the values that an override gives a key, in a sweep several; those of ranges are left out."""
    if override.is_sweep_override():
        return list(override.sweep_iterator()) if override.is_choice_sweep() else []
    return [override.value()]


def choices(override: Override) -> list[str]:
    """Return the options that an override chooses from a group, in a sweep several.

    Raises:
        ValueError: for a pattern that matches none.
    """
    if not override.is_sweep_override():
        return [override.get_value_element_as_str()]
    if not isinstance(pattern := override.value(), Glob):
        return list(override.sweep_string_iterator())
    key, _, typed = str(override.input_line).partition("=")
    valid = options(override.key_or_group)
    if not (found := pattern.filter(list(valid))):
        raise ValueError(f"{key}: expected a pattern that matches one of {', '.join(valid)}, got {typed}")
    return found


def compositions(chosen: Sequence[Sequence[str]], name: str) -> list[dict[str, DictConfig]]:
    """Compose the configs of a sweep over groups, by choice: a dictionary for each swept group.

    Every other group has its first choice. Without a sweep over a group, there is a single config.

    Args:
        chosen: the choices from each group that was typed, as overrides.
        name: name of the root config.

    Raises:
        HydraException: for choices that do not fit the configs.
    """
    first = [several[0] for several in chosen]
    swept = [
        {choice: composed([*first[:place], choice, *first[place + 1 :]], name) for choice in several}
        for place, several in enumerate(chosen)
        if len(several) > 1
    ]
    return swept or [{"": composed(first, name)}]


def directed(overrides: Sequence[str]) -> list[str]:
    """Let Optuna look for the highest success rate, which a training returns: its sweeper minimises by default.

    Args:
        overrides: overrides as they were typed.

    Returns:
        The same, after ``hydra.sweeper.direction=maximize`` if the sweeper is Optuna's; a direction that was typed
        takes precedence, since it comes later.
    """
    sweepers = [bare(override.partition("=")[2]) for override in overrides if override.startswith("hydra/sweeper=")]
    return [*(["hydra.sweeper.direction=maximize"] if sweepers[-1:] == ["optuna"] else []), *overrides]


def check_sweeps(overrides: Sequence[Override]) -> None:
    """Refuse sweeps that Hydra's own sweeper cannot run.

    Raises:
        ValueError: names the key and what to type instead.
    """
    for override in overrides:
        key = override.key_or_group
        if override.is_interval_sweep():
            raise ValueError(
                f"{key}: expected values such as 0.001,0.01 or range(...), since interval(...) needs a sweeper such as "
                "hydra/sweeper=optuna (pip install hydra-optuna-sweeper), which looks for the highest success rate"
            )
        if isinstance(override.value(), Glob) and not options(key):
            raise ValueError(f"{key}: expected values such as 1,2, since glob(...) chooses from a group")
