"""Generate yards and keep them in the cache: ``python -m splatrl.scenes.yards 3 5``."""

import sys

from splatrl.scenes.yards.source import yards

if __name__ == "__main__":
    yards(map(int, sys.argv[1:]))
