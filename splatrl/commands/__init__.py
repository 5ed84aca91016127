"""The commands, each thin: it reads a config or arguments, calls the library and prints."""
