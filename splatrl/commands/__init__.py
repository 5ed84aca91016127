"""The commands, ``splatrl-train`` and its like: they parse, call the library, and print."""
