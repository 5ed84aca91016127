"""Check that a task gets a motion and rewards of the kinds that it is made for."""


def require_part(group: str, part: object, kind: type, expected: str, *options: str) -> None:
    """Refuse a motion or rewards of a kind other than the task's own.

    Args:
        group: the config group from which the part is chosen, ``motion`` or ``rewards``, for the message.
        part: the motion or the rewards.
        kind: the class that it must have.
        expected: what such a part is, for the message.
        options: the options of the group that fit, for the message.

    Raises:
        ValueError: names the key, what was expected, what was given and what to type.
    """
    if not isinstance(part, kind):
        raise misfit(group, part, expected, *options)


def misfit(group: str, part: object, expected: str, *options: str) -> ValueError:
    """Return the error that refuses a part; see ``require_part``."""
    words = " or ".join(f"{group}@task.{group}={option}" for option in options)
    return ValueError(f"task.{group}: expected {expected}, got {type(part).__name__}; type {words}")
