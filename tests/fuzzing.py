"""Damaged and odd input for the readers: how it is made, how long, and what a reader may do with it.

``FUZZ_INPUTS=100000 pytest tests/fuzz`` goes on after the usual examples, with other examples in each round, until all
fuzzers together have tried as many inputs, each as large a share as it has of the usual examples. ``FUZZ_SEED`` chooses
where the rounds begin. pytest's last lines say how many inputs were tried (``tests/conftest.py``).
"""

import inspect
import json
import os
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


def damaged(good: bytes, splices: list[Splice]) -> bytes:
    for where, out, put in splices:
        place = int(where * len(good))
        good = good[:place] + put + good[place + out :]
    return good


def flipped(good: bytes, generator: np.random.Generator) -> tuple[bytes, str]:
    """One bit is another; which."""
    place, bit = int(generator.integers(len(good))), int(generator.integers(8))
    return good[:place] + bytes([good[place] ^ 1 << bit]) + good[place + 1 :], f"bit {bit} of byte {place}"


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
