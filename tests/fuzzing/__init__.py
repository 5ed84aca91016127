"""Structure-aware fuzzing of every file format; a seed and a number determine each damaged file.

``python -m tests.fuzzing --count 10000 --seed 0`` tries that many files of each format and prints the outcomes. A
reader may return, or raise a ValueError that names the file. Anything else is a fault, including a signal, or a file
that takes too much time or memory; each fault is printed with the arguments that reproduce it.
"""
