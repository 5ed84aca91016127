"""The C++ core: ``_core.pyi`` lists its interface, which the classes that use it document."""
