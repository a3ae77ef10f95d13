"""The clock: the cycles in which something happens, one after the other.

In a cycle, lines arrive first, in the order of their requests. Then come the events of the rays, by slot: a test is over,
the next read becomes ready. Then the port takes as many requests as it has places: demand reads in the order in which they
became ready, then prefetches, of the slot that has waited longest. A demand read that needs an MSHR when none is free holds
the port.
"""

import numpy as np

from cachesim.clock.calendar import NEVER, enter, lowest_bit, next_cycle, take_word
from cachesim.clock.state import (
    BOX,
    BY_LEAF,
    BY_LEVEL,
    BY_RAY,
    CYCLES,
    FREE,
    HIT,
    IDLE,
    LATE,
    LEAF,
    MISS,
    MSHR,
    PORT,
    T_EVICTED,
    T_FILLED,
    T_JOINED,
    T_LATE,
    T_MISSES,
    T_READS,
    T_REDUNDANT,
    T_TIMELY,
    TEST,
    TRIANGLE,
    UNIT,
    VISIT,
)  # fmt: skip
from cachesim.fast_lru import set_of
from cachesim.policies import hooks
from cachesim.policies.machine import FIRST_USE, IN_FLIGHT, LOST, PUSHED_OUT, RESIDENT, UNUSED, first_waiting, stop_waiting
from cachesim.policies.machine import HIT as FOUND
from cachesim.policies.machine import MISS as NOT_FOUND
from cachesim.replacement import insert, refresh
from nptrace_base.jit import inlined, kernel
from traces.format import LEAF as KIND_LEAF
from traces.format import PUSH as KIND_PUSH

#: What an entry of the log is about.
LOG_READ, LOG_BOX, LOG_TRIANGLES, LOG_PREFETCH = map(np.int64, range(4))  # as NumPy's: literals are compiled one by one

N_CAUSES = len(CYCLES)


@kernel(_nrt=False)
def run(rows, unit, machine, clock, parameters):
    """Go on until all rays have ended, or until rays may be needed that are not in ``rows``; return whether all have ended."""
    numbers, slots, port = clock.numbers[0], clock.slots, machine.port[0]
    n_slots = slots.size
    n_rays = rows.first_ray + rows.waits_for.size
    now = port.now
    if numbers.is_started == 0:
        numbers.is_started = 1
        now = np.int64(-1)
        for slot in range(n_slots):
            slots[slot].event = FREE
            slots[slot].since = 0
            _schedule(clock, slot, now, np.int64(0))
    while True:
        cycle = _next(machine, clock, parameters, now)
        if cycle == NEVER:
            break
        if not rows.is_last and n_rays - numbers.next_ray <= 2 * n_slots:
            return False
        now = cycle
        port.now = now
        _fill(machine, clock, parameters, now)
        if n_slots == 1:
            if slots[0].due <= now:
                _advance(rows, unit, machine, clock, parameters, np.int64(0), now)
        else:
            for word in range(clock.calendar.slots.shape[1]):
                bits = take_word(clock.calendar, now, word)
                while bits:
                    slot = np.int64(64) * word + lowest_bit(bits)
                    bits &= bits - np.uint64(1)
                    if slots[slot].due > now:
                        enter(clock.calendar, slot, now, slots[slot].due)
                    else:
                        _advance(rows, unit, machine, clock, parameters, slot, now)
        if rows.is_last and numbers.n_ended == n_rays:
            break
        _use_port(unit, machine, clock, parameters, now)
    hooks.on_finish(unit, machine)
    for slot in range(n_slots):
        clock.cycles[IDLE] += numbers.last_cycle - slots[slot].since
        slots[slot].since = numbers.last_cycle
    return True


@inlined
def _schedule(clock, slot, now, cycle):
    """Set the cycle of a slot's next event, later than ``now``."""
    clock.slots[slot].due = cycle
    if clock.slots.size > 1:  # one ray needs no calendar
        enter(clock.calendar, slot, now, cycle)


@inlined
def _next(machine, clock, parameters, now):
    """Return the next cycle in which something may happen."""
    numbers = clock.numbers[0]
    waiter = first_waiting(machine)
    if numbers.n_queued > 0:
        is_stuck = numbers.in_flight == parameters.mshrs and clock.slots[clock.queue[numbers.queue_head]].seen >= 0
        if not is_stuck:
            return now + 1
    elif waiter >= 0 and machine.port[0].blocked != waiter:
        return now + 1
    cycle = clock.slots[0].due if clock.slots.size == 1 else next_cycle(clock.calendar, now)
    if (numbers.n_queued > 0 or waiter >= 0) and numbers.in_flight > 0:  # who waits for an MSHR waits for a line
        cycle = min(cycle, max(clock.arrival[clock.flight[numbers.oldest]], now + 1))
    return cycle


@inlined
def _fill(machine, clock, parameters, now):
    """Install the lines that have arrived."""
    numbers, status, lists = clock.numbers[0], machine.status, clock.lists
    while numbers.in_flight > 0:
        line = clock.flight[numbers.oldest]
        if clock.arrival[line] > now:
            break
        numbers.oldest = _after(numbers.oldest, clock.flight.size)
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
def _after(place, size):
    """Return the place after one in a ring."""
    return place + 1 if place + 1 < size else np.int64(0)


@inlined
def _advance(rows, unit, machine, clock, parameters, slot, now):
    """Let the ray of a slot go on from the event that is due now."""
    ray, numbers, tree = clock.slots[slot], clock.numbers[0], machine.tree
    ray.due = NEVER
    while True:
        if ray.event == VISIT:
            if ray.last_kind == KIND_LEAF:
                hooks.on_leaf_end(unit, machine, slot)
            if ray.row == ray.end:
                _end_ray(unit, machine, clock, slot, now)
                if ray.started == now:  # a slot takes one ray a cycle
                    _schedule(clock, slot, now, now + 1)
                    return
                continue
            node = np.int64(rows.nodes[ray.row - rows.first_row])
            _step_stack(unit, machine, clock, parameters, slot, node)
            ray.last_kind, ray.last_node, ray.since = rows.kinds[ray.row - rows.first_row], node, now
            if tree.n_lines[node] > 0:
                ray.seen, ray.lines_done, ray.data_at = -1, 0, 0
                place = numbers.queue_head + numbers.n_queued
                clock.queue[place if place < clock.queue.size else place - clock.queue.size] = slot
                numbers.n_queued += 1
                return
            if _after_box(machine, clock, parameters, slot, now, now):
                return
        elif ray.event == LEAF:
            start = now
            if parameters.n_units > 0:
                start = _take_unit(clock, now, np.int64(tree.n_prims[ray.last_node]) * parameters.every)
                clock.cycles[UNIT] += start - now
            ray.event = TEST
            if start > now:
                _schedule(clock, slot, now, start)
                return
        elif ray.event == TEST:
            took = _test_cycles(parameters, np.int64(tree.n_prims[ray.last_node]))
            _count_test(clock, slot, now, took)
            ray.event = VISIT
            ray.row += 1
            hooks.on_leaf(unit, machine, slot, ray.last_node)
            if took > 0:
                _schedule(clock, slot, now, now + took)
                return
        elif not _start_ray(rows, unit, machine, clock, slot, now):
            return


@inlined
def _test_cycles(parameters, n_prims):
    """Return how long the test of a leaf's triangles takes."""
    return (n_prims - 1) * parameters.every + parameters.triangle


@inlined
def _count_test(clock, slot, start, took):
    clock.cycles[TRIANGLE] += took
    _note(clock, start, took, slot, LOG_TRIANGLES, clock.slots[slot].last_node, clock.slots[slot].number)


@inlined
def _take_unit(clock, now, busy):
    """Keep the intersection unit that is free first busy for some cycles; return when it starts."""
    free = clock.units_free
    best = 0
    for i in range(1, free.size):
        if free[i] < free[best]:
            best = i
    start = max(now, free[best])
    free[best] = start + busy
    return start


@inlined
def _after_box(machine, clock, parameters, slot, now, cycle):
    """Set the slot's event after its box test, which ends in ``cycle``; return whether it is later than ``now``."""
    ray = clock.slots[slot]
    n_prims = np.int64(machine.tree.n_prims[ray.last_node]) if ray.last_kind == KIND_LEAF else np.int64(0)
    if n_prims > 0 and (parameters.watches_leaves or parameters.n_units > 0):
        ray.event = LEAF
    else:
        ray.event = VISIT
        ray.row += 1
        if n_prims > 0:
            took = _test_cycles(parameters, n_prims)
            _count_test(clock, slot, cycle, took)
            cycle += took
    if cycle > now:
        _schedule(clock, slot, now, cycle)
        return True
    return False


@inlined
def _step_stack(unit, machine, clock, parameters, slot, node):
    """Push or pop what the ray pushed or popped on its way from the last node to this one."""
    ray, sp = clock.slots[slot], machine.sp
    if ray.last_kind < 0:
        return
    if ray.last_kind == KIND_PUSH:
        machine.stack[slot, sp[slot]] = ((node - 1) ^ 1) + 1
        machine.pushed_at[slot, sp[slot]] = ray.row - 1
        sp[slot] += 1
        hooks.on_push(unit, machine, slot)
    elif ray.last_kind == KIND_LEAF or not parameters.follows or machine.tree.parent[node] != ray.last_node:
        height = sp[slot] - 1
        while parameters.skips and machine.stack[slot, height] != node:
            height -= 1
        sp[slot] = height
        hooks.on_pop(unit, machine, slot)


@inlined
def _start_ray(rows, unit, machine, clock, slot, now):
    """Give the slot its next ray; return whether it runs now."""
    ray, numbers = clock.slots[slot], clock.numbers[0]
    number = ray.number + 1
    n_rays = rows.first_ray + rows.waits_for.size
    if number == 0 or number >= n_rays or rows.waits_for[number - rows.first_ray] != -2:  # no shadow ray of the last
        number = numbers.next_ray
        while number < n_rays and rows.waits_for[number - rows.first_ray] == -2:
            number += 1
        numbers.next_ray = number
        if number >= n_rays:
            return False
        numbers.next_ray += 1
    ray.number = number
    ray.type = rows.types[number - rows.first_ray]
    ray.row, ray.end = rows.first[number - rows.first_ray], rows.first[number - rows.first_ray + 1]
    ray.last_kind = -1
    ray.event = VISIT
    ray.started = now
    machine.sp[slot], machine.ray[slot] = 0, number
    clock.cycles[IDLE] += now - ray.since
    ray.since = now
    hooks.on_start(unit, machine, slot)
    primary = rows.waits_for[number - rows.first_ray]
    if primary >= 0:
        for other in range(clock.slots.size):
            if other != slot and clock.slots[other].number == primary and clock.slots[other].event != FREE:
                clock.slots[other].waiter = slot
                return False
    return True


@inlined
def _end_ray(unit, machine, clock, slot, now):
    """Note that the ray of a slot has ended; a shadow ray that waited for it starts in the next cycle."""
    ray = clock.slots[slot]
    hooks.on_end(unit, machine, slot)
    ray.event = FREE
    ray.since = now
    clock.numbers[0].last_cycle = now
    clock.numbers[0].n_ended += 1
    waiter = ray.waiter
    if waiter >= 0:
        ray.waiter = -1
        clock.cycles[IDLE] += now + 1 - clock.slots[waiter].since
        _schedule(clock, waiter, now, now + 1)


@inlined
def _use_port(unit, machine, clock, parameters, now):
    """Let the port take what waits: demand reads, then prefetches."""
    numbers, port = clock.numbers[0], machine.port[0]
    free = parameters.ports
    while free > 0 and numbers.n_queued > 0:
        slot = clock.queue[numbers.queue_head]
        ray = clock.slots[slot]
        line = np.int64(machine.tree.first_line[ray.last_node]) + ray.lines_done
        if ray.seen < 0:
            ray.seen = now
            clock.cycles[PORT] += now - ray.since
        if not _read(unit, machine, clock, parameters, slot, line, now):
            port.blocked = -1
            return
        clock.cycles[MSHR] += now - ray.seen
        ray.seen, ray.since = -1, now
        ray.lines_done += 1
        free -= 1
        if ray.lines_done < machine.tree.n_lines[ray.last_node]:
            continue
        numbers.queue_head = _after(numbers.queue_head, clock.queue.size)
        numbers.n_queued -= 1
        clock.cycles[ray.data_from] += ray.data_at - now
        clock.cycles[BOX] += parameters.box
        _note(clock, now, ray.data_at - now, slot, LOG_READ, ray.last_node, ray.number * N_CAUSES + ray.data_from)
        _note(clock, ray.data_at, parameters.box, slot, LOG_BOX, ray.last_node, ray.number)
        _after_box(machine, clock, parameters, slot, now, ray.data_at + parameters.box)
    port.blocked = -1  # not before: what a read drops had waited for the MSHR until now
    while free > 0:
        slot = first_waiting(machine)
        if slot < 0:
            return
        wanted = hooks.request(unit, machine, slot)
        if wanted == hooks.NOTHING:
            stop_waiting(machine, slot)
            continue
        line, n_lines = hooks.as_line(wanted), np.int64(1)
        if wanted >= 0:
            line, n_lines = np.int64(machine.tree.first_line[wanted]), np.int64(machine.tree.n_lines[wanted])
        if not _prefetch(machine, clock, parameters, slot, wanted, line + machine.lines_asked[slot], now):
            port.blocked = slot
            return
        machine.last_issue[slot] = now
        free -= 1
        machine.lines_asked[slot] += 1
        if machine.lines_asked[slot] == n_lines:
            machine.lines_asked[slot] = 0
            port.issued += 1
            hooks.requested(unit, machine, slot)


@inlined
def _read(unit, machine, clock, parameters, slot, line, now):
    """Look up a line of a demand read; return False if it needs an MSHR and none is free."""
    status, numbers, ray = machine.status, clock.numbers[0], clock.slots[slot]
    state, of_read = status[line], T_READS
    hit_at = now + parameters.hit
    ready, cause, outcome = hit_at, HIT, FOUND
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
                cause = LATE
                _tally(clock, parameters, line, T_LATE)
            else:
                numbers.timely += 1
                numbers.hits += 1
                _tally(clock, parameters, line, T_TIMELY)
        elif ready > hit_at:
            numbers.joined_by_demand += 1
            cause, of_read = MISS, T_MISSES
        else:
            numbers.hits += 1
    else:
        if numbers.in_flight == parameters.mshrs:
            return False
        numbers.pollution += np.int64(state & PUSHED_OUT != 0)
        numbers.misses += 1
        of_read = T_MISSES
        ready, cause, outcome = _ask_memory(machine, clock, parameters, line, now), MISS, NOT_FOUND
    if parameters.by:
        of = _class_of(machine, clock, parameters, slot, ray.last_node, T_READS)
        clock.tally[of, T_READS] += 1
        if of_read == T_MISSES:
            clock.tally[of, T_MISSES] += 1
    if ready > ray.data_at:
        ray.data_at, ray.data_from = ready, cause
    hooks.on_visit(unit, machine, slot, line, outcome)
    return True


@inlined
def _prefetch(machine, clock, parameters, slot, wanted, line, now):
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
        of = _class_of(machine, clock, parameters, slot, wanted, found)
        clock.tally[of, found] += 1
        if found == T_FILLED:
            clock.class_of[line] = of
    _note(clock, now, np.int64(1), slot, LOG_PREFETCH, line, np.int64(-1))
    return True


@inlined
def _tally(clock, parameters, line, what):
    """Count what became of a line, by the prefetch that filled it."""
    if parameters.by:
        clock.tally[clock.class_of[line], what] += 1


@kernel(_nrt=False)
def _class_of(machine, clock, parameters, slot, node, what):
    """Return the class of a read, or of a request, of a node; ``node`` is negative for a request of a line.

    A request by a unit that all rays share is of the class of slot 0's ray; reads have no place on the stack and no leaf:
    class 0.
    """
    own = min(slot, machine.sp.size - 1)
    if parameters.by == BY_LEVEL:
        return np.int64(machine.tree.level[node]) if node >= 0 else np.int64(0)
    if parameters.by == BY_RAY:
        return clock.slots[own].type
    if what == T_READS:
        return np.int64(0)
    if parameters.by == BY_LEAF:
        is_testing = clock.slots[own].last_kind == KIND_LEAF and clock.slots[own].event == VISIT
        return np.int64(machine.tree.n_prims[clock.slots[own].last_node]) if is_testing else np.int64(0)
    for place in range(machine.sp[own]):
        if machine.stack[own, machine.sp[own] - 1 - place] == node:
            return np.int64(place)
    return np.int64(machine.stack.shape[1])


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
def _note(clock, cycle, length, slot, what, node, number):
    """Keep an event for the timeline."""
    if clock.log.shape[0] == 0 or clock.numbers[0].next_ray < clock.log_from:
        return
    n = clock.numbers[0].n_logged
    if n < clock.log.shape[0]:
        clock.log[n, 0], clock.log[n, 1], clock.log[n, 2] = cycle, length, slot
        clock.log[n, 3], clock.log[n, 4], clock.log[n, 5] = what, node, number
        clock.numbers[0].n_logged = n + 1
