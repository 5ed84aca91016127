"""Damaged files of every format, made with their structure in mind; a seed and a number say which.

``python -m tests.fuzzing --count 10000 --seed 0`` tries that many of each format and prints what became of them. A
reader may return or raise a ValueError that names the file; anything else, a signal, a file that takes long or much
memory is a fault, which is printed with what brings it back.
"""
