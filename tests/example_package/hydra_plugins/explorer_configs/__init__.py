"""Tells Hydra where this package's configs are, so that every splatrl command finds them."""

from hydra.core.config_search_path import ConfigSearchPath
from hydra.plugins.search_path_plugin import SearchPathPlugin


class ExplorerConfigs(SearchPathPlugin):
    """Adds ``explorer/conf`` to Hydra's search path."""

    def manipulate_search_path(self, search_path: ConfigSearchPath) -> None:
        """Append the folder, so that splatrl's own names take precedence."""
        search_path.append("explorer", "pkg://explorer.conf")
