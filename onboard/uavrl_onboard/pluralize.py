"""A number and what it counts, in words."""


def pluralize(number: int, thing: str, things: str | None = None) -> str:
    """A number with its noun, in the singular for one.

    Args:
        number: how many.
        thing: one of them.
        things: several of them, where that is not ``thing`` with an s.

    Examples:
        >>> pluralize(1, "episode"), pluralize(1200, "episode"), pluralize(0, "class", "classes")
        ('1 episode', '1,200 episodes', '0 classes')
    """
    return f"{number:,} {thing if number == 1 else things or f'{thing}s'}"
