"""Cross references of the docstrings as plain code: Markdown knows no roles."""

from __future__ import annotations

import re
from typing import Any

import griffe

_ROLE = re.compile(r":(?:func|class|mod|meth|data|attr|exc):`([^`]+)`")


class PlainRoles(griffe.Extension):
    """``:func:`shared.signal.spectrum.range_doppler``` becomes ```shared.signal.spectrum.range_doppler```."""

    def on_object(self, *, obj: griffe.Object, **_: Any) -> None:
        if obj.docstring is not None:
            obj.docstring.value = _ROLE.sub(r"`\1`", obj.docstring.value)
