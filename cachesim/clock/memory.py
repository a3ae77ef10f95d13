"""The memory side of the clock: lookups of reads and prefetches, lines on their way, and the tally of what became of them."""

import numpy as np

from cachesim.clock.log import LOG_PREFETCH, note
from cachesim.clock.state import (
    BY_LEAF,
    BY_LEVEL,
    BY_RAY,
    SPENT_HIT,
    SPENT_LATE,
    SPENT_MISS,
    T_EVICTED,
    T_FILLED,
    T_JOINED,
    T_LATE,
    T_MISSES,
    T_READS,
    T_REDUNDANT,
    T_TIMELY,
    VISIT_DUE,
)  # fmt: skip
from cachesim.fast_lru import set_of
from cachesim.policies import hooks
from cachesim.policies.machine import FIRST_USE, HIT, IN_FLIGHT, LOST, MISS, PUSHED_OUT, RESIDENT, UNUSED
from cachesim.replacement import insert, refresh
from nptrace_base.jit import inlined, kernel
from traces.format import LEAF


@inlined
def fill(machine, clock, parameters, now):
    """Install the lines that have arrived."""
    numbers, status, lists = clock.numbers[0], machine.status, clock.lists
    while numbers.in_flight > 0:
        line = clock.flight[numbers.oldest]
        if clock.arrival[line] > now:
            break
        numbers.oldest = after(numbers.oldest, clock.flight.size)
        numbers.in_flight -= 1
        is_prefetched = status[line] & UNUSED
        status[line] = (status[line] & (255 - IN_FLIGHT)) | RESIDENT
        victim = insert(lists, set_of(line, lists.n_sets, parameters.mask), line)
        if victim >= 0:
            left = status[victim] & (255 - RESIDENT)
            if left & UNUSED:
                numbers.evicted += 1
                if parameters.by:
                    clock.tally[clock.class_of[victim], T_EVICTED] += 1
                left = (left & (255 - UNUSED)) | LOST
            status[victim] = left | PUSHED_OUT if is_prefetched else left


@inlined
def after(place, size):
    """Return the place after one in a ring."""
    return place + 1 if place + 1 < size else np.int64(0)


@inlined
def read(unit, machine, clock, parameters, slot, line, now):
    """Look up a line of a demand read; return False if it needs an MSHR and none is free."""
    status, numbers, ray = machine.status, clock.numbers[0], clock.slots[slot]
    state, of_read = status[line], T_READS
    hit_at = now + parameters.hit
    ready, cause, outcome = hit_at, SPENT_HIT, HIT
    if parameters.is_perfect:
        numbers.hits += 1
    elif state & (RESIDENT | IN_FLIGHT):
        if state & IN_FLIGHT:
            ready = max(hit_at, clock.arrival[line])
        else:
            refresh(clock.lists, set_of(line, clock.lists.n_sets, parameters.mask), line)
        if state & UNUSED:
            status[line] = state & (255 - UNUSED)
            outcome = FIRST_USE
            numbers.saved += now + parameters.miss - ready
            numbers.waited += ready - hit_at
            if ready > hit_at:
                numbers.late += 1
                cause = SPENT_LATE
                _tally(clock, parameters, line, T_LATE)
            else:
                numbers.timely += 1
                numbers.hits += 1
                _tally(clock, parameters, line, T_TIMELY)
        elif ready > hit_at:
            numbers.joined_by_demand += 1
            cause, of_read = SPENT_MISS, T_MISSES
        else:
            numbers.hits += 1
    else:
        if numbers.in_flight == parameters.mshrs:
            return False
        numbers.pollution += np.int64(state & PUSHED_OUT != 0)
        numbers.misses += 1
        of_read = T_MISSES
        ready, cause, outcome = _ask_memory(machine, clock, parameters, line, now), SPENT_MISS, MISS
    if parameters.by:
        of = _class_of(machine, clock, parameters, slot, ray.last_node, line, T_READS)
        clock.tally[of, T_READS] += 1
        if of_read == T_MISSES:
            clock.tally[of, T_MISSES] += 1
    if ready > ray.data_at:
        ray.data_at, ray.data_from = ready, cause
    hooks.on_visit(unit, machine, slot, line, outcome)
    return True


@inlined
def prefetch(machine, clock, parameters, slot, wanted, line, now):
    """Look up a line for a prefetch; return False if it needs an MSHR and none is free."""
    state, numbers, found = machine.status[line], clock.numbers[0], T_FILLED
    if parameters.is_perfect:
        numbers.redundant += 1
        found = T_REDUNDANT
    elif state & RESIDENT:
        refresh(clock.lists, set_of(line, clock.lists.n_sets, parameters.mask), line)
        numbers.redundant += 1
        found = T_REDUNDANT
    elif state & IN_FLIGHT:
        numbers.joined += 1
        found = T_JOINED
    else:
        if numbers.in_flight == parameters.mshrs:
            return False
        numbers.filled += 1
        _ask_memory(machine, clock, parameters, line, now)
        machine.status[line] |= UNUSED
    if parameters.by:
        of = _class_of(machine, clock, parameters, slot, wanted, line, found)
        clock.tally[of, found] += 1
        if found == T_FILLED:
            clock.class_of[line] = of
    note(clock, now, np.int64(1), slot, LOG_PREFETCH, line, np.int64(-1))
    return True


@inlined
def _ask_memory(machine, clock, parameters, line, now):
    """Request a line from memory through an MSHR that is free; return when it arrives."""
    numbers = clock.numbers[0]
    numbers.wanted_again += np.int64(machine.status[line] & LOST != 0)
    arrival = max(now + parameters.miss, numbers.bus_free + parameters.transfer)
    numbers.bus_free = arrival
    place = numbers.oldest + numbers.in_flight
    clock.flight[place if place < clock.flight.size else place - clock.flight.size] = line
    numbers.in_flight += 1
    clock.arrival[line] = arrival
    machine.status[line] = IN_FLIGHT
    return arrival


@inlined
def _tally(clock, parameters, line, what):
    """Count what became of a line, by the prefetch that filled it."""
    if parameters.by:
        clock.tally[clock.class_of[line], what] += 1


@kernel(_nrt=False)
def _class_of(machine, clock, parameters, slot, node, line, what):
    """Return the class of a read, or of a request, of a line of a node; ``node`` is negative if the line itself is requested.

    Such a line is of the level nearest the root of its nodes. A request by a unit that all rays share is of the class of slot
    0's ray; reads have no place on the stack and no leaf: class 0.
    """
    own = slot if slot < machine.sp.size else np.int64(0)
    if parameters.by == BY_LEVEL:
        return np.int64(machine.tree.level[node]) if node >= 0 else clock.level_of[line]
    if parameters.by == BY_RAY:
        return clock.slots[own].type
    if what == T_READS:
        return np.int64(0)
    if parameters.by == BY_LEAF:
        is_testing = clock.slots[own].last_kind == LEAF and clock.slots[own].event == VISIT_DUE
        return np.int64(machine.tree.n_prims[clock.slots[own].last_node]) if is_testing else np.int64(0)
    for place in range(machine.sp[own]):
        if machine.stack[own, machine.sp[own] - 1 - place] == node:
            return np.int64(place)
    return np.int64(machine.stack.shape[1])
