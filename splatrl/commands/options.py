"""Options that take several words, some beginning with a minus sign, which argparse alone cannot parse."""

import argparse
from collections.abc import Callable, Mapping, Sequence
from typing import NoReturn

from splatrl.values import split_words


class Parser(argparse.ArgumentParser):
    """An argument parser that reports errors in one line."""

    def error(self, message: str) -> NoReturn:
        """Exit with one line that says what is wrong and how to list the options."""
        self.exit(2, f"{self.prog}: {message.removeprefix('argument ')}; {self.prog} --help lists the options\n")


def is_word(word: str) -> bool:
    """Return whether an argument is a word rather than an option."""
    return not word.startswith("--")


def is_numbers(word: str) -> bool:
    """Return whether an argument is one number, or several separated by blanks or commas."""
    try:
        return len([float(part) for part in split_words(word)]) > 0
    except ValueError:
        return False


def joined(arguments: Sequence[str], words: Mapping[str, int], fits: Callable[[str], bool] = is_word) -> list[str]:
    """Join each option that takes several words into one argument: ``--axes x -z y`` becomes ``--axes=x -z y``.

    Args:
        arguments: arguments of a command line.
        words: for each such option, the maximum number of words it takes.
        fits: decides whether an argument may be one of an option's words.
    """
    result, rest = [], list(arguments)
    while rest:
        argument = rest.pop(0)
        if argument in words:
            taken: list[str] = []
            while rest and len(taken) < words[argument] and fits(rest[0]):
                taken += split_words(rest.pop(0))
            argument = f"{argument}={' '.join(taken)}" if taken else argument
        result.append(argument)
    return result
