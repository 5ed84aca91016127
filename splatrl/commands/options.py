"""Options of several words, some of which may begin with a minus, as argparse alone cannot take them."""

import argparse
from collections.abc import Callable, Mapping, Sequence
from typing import NoReturn


class Parser(argparse.ArgumentParser):
    """A parser that says in one line what is wrong."""

    def error(self, message: str) -> NoReturn:
        """End with what is wrong, and where the options are listed."""
        self.exit(2, f"{self.prog}: {message.removeprefix('argument ')}; {self.prog} --help lists the options\n")


def is_word(word: str) -> bool:
    """Whether an argument is no option."""
    return not word.startswith("--")


def is_numbers(word: str) -> bool:
    """Whether an argument is a number, or several with blanks or commas between."""
    try:
        return len([float(part) for part in split(word)]) > 0
    except ValueError:
        return False


def joined(arguments: Sequence[str], words: Mapping[str, int], fits: Callable[[str], bool] = is_word) -> list[str]:
    """The arguments, with options such as ``--axes x -z y`` joined into ``--axes=x -z y``.

    Args:
        arguments: of a command line.
        words: the most words that each such option takes.
        fits: whether an argument may be one of them.
    """
    result, rest = [], list(arguments)
    while rest:
        argument = rest.pop(0)
        if argument in words:
            taken: list[str] = []
            while rest and len(taken) < words[argument] and fits(rest[0]):
                taken += split(rest.pop(0))
            argument = f"{argument}={' '.join(taken)}" if taken else argument
        result.append(argument)
    return result


def split(text: str) -> list[str]:
    """The words of a text with blanks or commas between them."""
    return text.replace(",", " ").split()
