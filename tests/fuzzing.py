"""Damaged and odd input for the readers: how it is made, how long, and what a reader may do with it.

``FUZZ_INPUTS=100000 pytest tests/fuzz`` goes on after the usual examples, with other examples in each round, until all
fuzzers together have tried as many inputs, each as large a share as it has of the usual examples. ``FUZZ_SEED`` chooses
where the rounds begin. pytest's last lines say how many inputs were tried (``tests/conftest.py``).
"""

from __future__ import annotations

import inspect
import json
import os
import re
from collections.abc import Callable
from typing import Any

import hypothesis
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from shared.physics.errors import InputError

INPUTS = int(os.environ.get("FUZZ_INPUTS", "0"))
FIRST_SEED = int(os.environ.get("FUZZ_SEED", "1"))

TRIED = "fuzzed inputs"
"""Property of a fuzzer's report: how many inputs it has given to readers."""
_tried = {TRIED: 0}
"""Of this process."""

TOKENS = (
    *(b"nan", b"inf", b"-1", b"0", b"1e400", b"1e-320", b"99999999999999999999", b"null", b"true", b"None"),
    *(b"[", b"]", b"{", b"}", b"(", b")", b"<", b">", b'"', b"'", b"\\", b"=", b",", b"#", b"@", b"$x", b"&amp;"),
    *(b"\n", b"\r", b"\x00", b"\xff", b"\xc3\x28", b"\xef\xbb\xbf", "\u0131\u202e".encode(), b"\x1b[31m", b" " * 40),
)

Splice = tuple[float, int, bytes]
SPLICES = st.lists(
    st.tuples(st.floats(0.0, 1.0), st.integers(0, 24), st.one_of(st.sampled_from(TOKENS), st.binary(max_size=4))),
    min_size=1,
    max_size=6,
)
"""(where, as a share of the file; bytes taken out; bytes put in)."""

JSON = st.recursive(
    st.none() | st.booleans() | st.floats() | st.integers(-(10**25), 10**25) | st.text(max_size=4),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(max_size=3), inner, max_size=3),
    max_leaves=8,
)

NUMBER = re.compile(rb"[-+]?\d[\d.]*(?:[eE][-+]?\d+)?")
NAME = re.compile(rb"[A-Za-z_][\w:]*")
NUMBERS = b"0 -1 3 nan inf -inf 1e300 1e38 1e-300 2147483648 4294967295 0.1".split()

Edit = tuple[str, int, int]
PLACE = st.integers(0, 2**20)
EDITS = st.lists(
    st.tuples(st.sampled_from(["number", "number", "copy", "name", "drop", "repeat", "swap"]), PLACE, PLACE),
    min_size=1,
    max_size=4,
)
"""(what is done, where, with what) by number, round and round: most of what comes out can still be parsed.

A number becomes an odd one or another number of the file, a name another name; lines are left out, repeated, exchanged.
"""


def damaged(good: bytes, splices: list[Splice]) -> bytes:
    for where, out, put in splices:
        place = int(where * len(good))
        good = good[:place] + put + good[place + out :]
    return good


def flipped(good: bytes, generator: np.random.Generator) -> tuple[bytes, str]:
    """One bit is another; which."""
    place, bit = int(generator.integers(len(good))), int(generator.integers(8))
    return good[:place] + bytes([good[place] ^ 1 << bit]) + good[place + 1 :], f"bit {bit} of byte {place}"


def edited(good: bytes, edits: list[Edit]) -> bytes:
    """The text with some numbers, names and lines of it changed; its first line stays."""
    head, _, text = good.partition(b"\n")
    for what, where, other in edits:
        if what in ("number", "copy", "name"):
            found = list((NAME if what == "name" else NUMBER).finditer(text))
            if not found:
                continue
            place = found[where % len(found)]
            put = NUMBERS[other % len(NUMBERS)] if what == "number" else found[other % len(found)][0]
            text = text[: place.start()] + put + text[place.end() :]
            continue
        lines = text.split(b"\n")
        one, two = where % len(lines), other % len(lines)
        if what == "drop":
            del lines[one]
        elif what == "repeat":
            lines[one:one] = lines[one : one + 1 + other % 6]
        else:
            lines[one], lines[two] = lines[two], lines[one]
        text = b"\n".join(lines)
    return head + b"\n" + text


def altered(document: Any, edits: list[tuple[float, Any]]) -> Any:
    """A copy of a JSON document with values anywhere in it replaced."""
    document = json.loads(json.dumps(document))
    for where, value in edits:
        places: list[tuple[Any, Any]] = []
        waiting = [document]
        while waiting:
            node = waiting.pop()
            keys = list(node) if isinstance(node, dict) else range(len(node)) if isinstance(node, list) else ()
            places += [(node, key) for key in keys]
            waiting += [node[key] for key in keys]
        if not places:
            break
        node, key = places[min(int(where * len(places)), len(places) - 1)]
        node[key] = value
    return document


def fuzz(examples: int, **strategies: st.SearchStrategy[Any]) -> Callable[[Callable[..., None]], Callable[..., None]]:
    """Give a test these examples, the same in every run; with ``FUZZ_INPUTS`` then others."""

    def decorate(body: Callable[..., None]) -> Callable[..., None]:
        fixtures = [p for name, p in inspect.signature(body).parameters.items() if name not in strategies]

        def examples_of(seed: int | None) -> Callable[..., None]:
            test = given(**strategies)(body)
            test = settings(
                max_examples=examples, suppress_health_check=list(HealthCheck), derandomize=seed is None, deadline=None,
                database=None,
            )(test)  # fmt: skip
            return test if seed is None else hypothesis.seed(seed)(test)

        def test(request: pytest.FixtureRequest, **given_fixtures: Any) -> None:
            before, share = _tried[TRIED], INPUTS * examples / _examples_of_all(request.session)
            try:
                examples_of(None)(**given_fixtures)
                seed = FIRST_SEED
                while _tried[TRIED] - before < share:
                    examples_of(seed)(**given_fixtures)
                    seed += 1
            finally:
                request.node.user_properties.append((TRIED, _tried[TRIED] - before))

        fixtures.insert(0, inspect.Parameter("request", inspect.Parameter.POSITIONAL_OR_KEYWORD))
        test.__name__, test.__doc__ = body.__name__, body.__doc__
        test.examples = examples  # type: ignore[attr-defined]
        test.__signature__ = inspect.Signature(fixtures)  # type: ignore[attr-defined]
        test.pytestmark = getattr(body, "pytestmark", [])  # type: ignore[attr-defined]
        return test

    return decorate


def _examples_of_all(session: pytest.Session) -> int:
    """Usual examples of all fuzzers that the session runs; under xdist, that all of its processes run."""
    return sum(getattr(getattr(item, "function", None), "examples", 0) for item in session.items)


def reads_or_says_one_line(read: Callable[[], object]) -> None:
    _tried[TRIED] += 1
    try:
        read()
    except InputError as error:
        message = str(error)
    else:
        return
    assert len(message.splitlines()) == 1
    message.encode()
