"""What is found of a scene or of a body once, and kept with it."""

from __future__ import annotations

from collections.abc import Callable
from functools import wraps
from typing import Any, Protocol, TypeVar


class Keeps(Protocol):
    """What has a place for what was found of it."""

    @property
    def found(self) -> dict[str, Any]: ...


Subject = TypeVar("Subject", bound=Keeps)
Value = TypeVar("Value")


def found_once(find: Callable[[Subject], Value]) -> Callable[[Subject], Value]:
    """A function whose result is kept with its argument, and goes with it to other processes."""
    name = f"{find.__module__}.{find.__qualname__}"

    @wraps(find)
    def kept(subject: Subject) -> Value:
        if name not in subject.found:
            subject.found[name] = find(subject)
        value: Value = subject.found[name]
        return value

    return kept
