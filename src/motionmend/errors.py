"""The one exception for what a user can mend."""

from __future__ import annotations

import difflib
from collections.abc import Iterable


class InputError(ValueError):
    """Something in a file, a name or an option that its owner can put right.

    Parameters
    ----------
    found : what was found, in one clause.
    where : the file, with its line where that is known (``walk.bvh:312``).
    expected : what would have been right.
    hint : what to do about it.
    """

    def __init__(self, found: str, *, where: object = None, expected: str = "", hint: str = ""):
        self.found, self.where, self.expected, self.hint = found, where, expected, hint
        message = f"{where}: {found}" if where is not None else found
        if expected:
            message += f"; expected {expected}"
        if hint:
            message += f". {hint[0].upper()}{hint[1:]}"
        super().__init__(message)


def nearest_names(wrong: str, names: Iterable[str], count: int = 3) -> str:
    """A phrase that names the closest of `names` to `wrong`, for an error's hint."""
    names = list(names)
    by_folded = {name.casefold(): name for name in names}
    close = difflib.get_close_matches(wrong.casefold(), by_folded, count, cutoff=0.4)
    picked = [by_folded[name] for name in close] or names[: 2 * count]
    return ("did you mean " if close else "the names are ") + ", ".join(picked) + ("?" if close else ", …")
