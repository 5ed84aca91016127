"""Command-line entry points; each only reads a config or arguments, calls the library and prints."""
