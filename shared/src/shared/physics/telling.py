"""What a value says of itself where it is printed, and where a notebook shows it."""

from __future__ import annotations

from html import escape


class Told:
    """For values that a user handles: ``__str__`` is one to five lines, and a notebook shows the same lines.

    ``repr`` stays what the class makes it, with every field.
    """

    def _repr_html_(self) -> str:
        return f"<pre>{escape(str(self))}</pre>"
