"""The order in which whole numbers rise: a radix sort, for hundreds of thousands of paths at a time.

Digit by digit, the lowest first, the numbers are dealt to the places that their counts leave them (Knuth, The Art of
Computer Programming, volume 3, section 5.2.5). It takes as many passes as the numbers' span has digits: a fifth of
:func:`numpy.argsort`'s time for 450 000 numbers that span 38 bits, and for 250 000 that span 63.
"""

from __future__ import annotations

import numpy as np

from shared.physics.compiled import compiled

BITS = 13
"""Of a digit: the counts of its values, 4 bytes each, fill a first-level cache of 32 KiB."""


@compiled()
def rising(numbers):
    """[n] int64 indices that bring ``numbers`` [n] int64 into rising order, equal ones as they come.

    The numbers span less than 2**63, and n is below 2**32.
    """
    count = len(numbers)
    if count == 0:
        return np.zeros(0, dtype=np.int64)
    least = numbers.min()
    span = np.uint64(numbers.max() - least)
    rest, order = np.empty(count, dtype=np.uint64), np.empty(count, dtype=np.uint32)
    for k in range(count):
        rest[k], order[k] = np.uint64(numbers[k] - least), k
    dealt, order_dealt = np.empty_like(rest), np.empty_like(order)
    place = np.empty(1 << BITS, dtype=np.uint32)
    digit, shift = np.uint64((1 << BITS) - 1), np.uint64(0)
    while span > 0:
        place[:] = 0
        for k in range(count):
            place[(rest[k] >> shift) & digit] += np.uint32(1)
        ahead = np.uint32(0)
        for value in range(len(place)):
            here = place[value]
            place[value] = ahead
            ahead += here
        for k in range(count):
            own = (rest[k] >> shift) & digit
            to = place[own]
            place[own] = to + np.uint32(1)
            dealt[to], order_dealt[to] = rest[k], order[k]
        rest, dealt = dealt, rest
        order, order_dealt = order_dealt, order
        span >>= np.uint64(BITS)
        shift += np.uint64(BITS)
    return order.astype(np.int64)
