"""The calendar against a list of events: the next in time, all slots of a cycle by number, however far ahead."""

import numpy as np
from hypothesis import example, given
from hypothesis import strategies as st

from cachesim.clock.calendar import NEVER, SPAN, enter, lowest_bit, make_calendar, next_cycle, take_word
from tests.reference.clock import NoPolicy
from tests.reference.clock_cases import Case, config_of, fast_account, slow_account

waits = st.one_of(st.integers(1, 3), st.integers(1, SPAN // 2), st.integers(SPAN - 2, 5 * SPAN))


@example([[1 + slot % 7] for slot in range(70)])  # more slots than bits in a word, many of them in one cycle
@given(st.lists(st.lists(waits, min_size=1, max_size=6), min_size=1, max_size=70))
def test_events_come_in_their_cycle_and_in_the_order_of_their_slots(plans):
    """``plans``: for each slot, how long after one event it has its next."""
    calendar, now, came = make_calendar(len(plans)), np.int64(-1), []
    due = [np.int64(-1)] * len(plans)
    left = [list(plan) for plan in plans]
    wanted = sorted((int(cycle) - 1, slot) for slot, plan in enumerate(plans) for cycle in np.cumsum(plan))
    for slot, plan in enumerate(left):
        due[slot] = now + plan.pop(0)
        enter(calendar, slot, now, due[slot])
    while (now := np.int64(next_cycle(calendar, now))) != NEVER:
        for word in range(calendar.slots.shape[1]):
            bits = int(take_word(calendar, now, word))
            while bits:
                slot = 64 * word + int(lowest_bit(np.uint64(bits)))
                bits &= bits - 1
                if due[slot] > now:
                    enter(calendar, slot, now, due[slot])
                    continue
                came.append((int(now), slot))
                if left[slot]:
                    due[slot] = now + left[slot].pop(0)
                    enter(calendar, slot, now, due[slot])
    assert came == wanted


def test_latencies_longer_than_the_calendar():
    numbers = {"hit": 2, "mshrs": 2, "ports": 1, "transfer": 5, "box": 1, "triangle": 2500, "every": 1100, "n_units": 1}
    for extra in (SPAN - 2, SPAN - 1, SPAN, 3 * SPAN + 7):
        case = Case("bvh", extra, 64, 0, 4)
        numbers["extra"] = extra
        assert fast_account(case, numbers, config_of((2, 1, "lru")), 3, "none") == slow_account(
            case, numbers, config_of((2, 1, "lru")), 3, NoPolicy()
        )
