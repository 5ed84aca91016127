"""The C++ core: ``_core.pyi`` lists its interface, and the classes that use it document it."""
