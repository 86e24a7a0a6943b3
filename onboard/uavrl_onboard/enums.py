"""Enumerations whose members are text, also in Python 3.10, which has no ``enum.StrEnum``."""

import sys

if sys.version_info >= (3, 11):
    from enum import StrEnum
else:
    from enum import Enum

    class StrEnum(str, Enum):
        """Members are, and print as, their values."""

        def __str__(self) -> str:
            return str(self.value)

        def __format__(self, form: str) -> str:
            return format(str(self.value), form)


__all__ = ["StrEnum"]
