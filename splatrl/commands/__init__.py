"""The commands; each one only reads a config or arguments, calls the library and prints."""
