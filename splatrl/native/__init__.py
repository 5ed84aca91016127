"""The C++ core: what it offers is listed in ``_core.pyi``, and the classes that use it are its documentation."""
