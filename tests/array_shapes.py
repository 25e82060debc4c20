"""What checks the array shapes of signatures in tests: beartype, for jaxtyping's import hook."""

import functools
import sys
from collections.abc import Callable
from typing import Any

from beartype import BeartypeConf, beartype

_hold_to_annotations = beartype(conf=BeartypeConf(is_pep484_tower=True, is_random=False))
"""An int will do for a float. No check draws a random item: Hypothesis refuses randomness that it does not control."""


def checked(function: Callable[..., Any]) -> Callable[..., Any]:
    """The function, held to its annotations at every call.

    While torch traces a network for ONNX the lengths of its arrays are no numbers, and nothing is checked.
    """
    strict = _hold_to_annotations(function)
    if strict is function:
        return function

    @functools.wraps(function)
    def call(*arguments: Any, **named: Any) -> Any:
        torch = sys.modules.get("torch")
        traced = torch is not None and torch.jit.is_tracing()
        return (function if traced else strict)(*arguments, **named)

    return call
