"""The clock, cycle by cycle where something happens: fills, then rays, then the port with demand reads before prefetches.

In a cycle, lines arrive first, in the order of their requests. Then come the events of the rays, by slot: a test is over, the next
read becomes ready. Then the port takes as many requests as it has places: demand reads in the order in which they became
ready, then prefetches, of the slot that has waited longest. A demand read that needs an MSHR when none is free holds the port.
"""

import numpy as np

from cachesim.clock.calendar import NEVER, enter, lowest_bit, next_cycle, take_word
from cachesim.clock.state import (
    BOX,
    BUS_FREE,
    DEMAND_HITS,
    DEMAND_JOINED,
    DEMAND_MISSES,
    EVICTED,
    FILLED,
    FREE,
    HIT,
    IDLE,
    IN_FLIGHT,
    IS_STARTED,
    JOINED,
    LAST_CYCLE,
    LATE,
    LATE_USED,
    LEAF,
    MISS,
    MSHR,
    N_LOGGED,
    N_QUEUED,
    N_RUNNING,
    NEXT_RAY,
    OLDEST,
    POLLUTION,
    PORT,
    QUEUE_HEAD,
    REDUNDANT,
    SAVED,
    TEST,
    TIMELY,
    TRIANGLE,
    UNIT,
    VISIT,
    WAITED,
    WANTED_AGAIN,
)
from cachesim.fast_lru import set_of
from cachesim.policies import hooks, machine as shared
from cachesim.policies.machine import BLOCKED, ISSUED, NOW, PUSHED_OUT, RESIDENT, UNUSED
from cachesim.replacement import insert, refresh
from nptrace_base.jit import inlined, kernel
from traces.format import LEAF as KIND_LEAF
from traces.format import PUSH as KIND_PUSH

FLYING, LOST = shared.IN_FLIGHT, shared.LOST

#: What an entry of the log is about.
LOG_READ, LOG_BOX, LOG_TRIANGLES, LOG_PREFETCH = range(4)


@kernel(_nrt=False)
def run(rows, unit, machine, clock, parameters):
    """Go on until all rays have ended, or until rays may be needed that are not in ``rows``; return whether all have ended."""
    numbers, n_slots = clock.numbers, machine.sp.size
    now = machine.clock[NOW]
    n_rays = rows.first_ray + rows.waits_for.size
    if numbers[IS_STARTED] == 0:
        numbers[IS_STARTED] = 1
        for slot in range(n_slots):
            clock.slots.event[slot] = FREE
            clock.slots.since[slot] = 0
            enter(clock.calendar, np.int64(slot), np.int64(-1), np.int64(0))
        now = np.int64(-1)
    while True:
        cycle = _next(machine, clock, parameters, now)
        if cycle == NEVER:
            break
        if not rows.is_last and n_rays - numbers[NEXT_RAY] <= 2 * n_slots:
            machine.clock[NOW] = now
            return False
        now = cycle
        machine.clock[NOW] = now
        _fill(machine, clock, parameters, now)
        for word in range(clock.calendar.slots.shape[1]):
            bits = take_word(clock.calendar, now, word)
            while bits:
                slot = np.int64(64) * word + lowest_bit(bits)
                bits &= bits - np.uint64(1)
                if clock.calendar.due[slot] > now:
                    enter(clock.calendar, slot, now, clock.calendar.due[slot])
                else:
                    _advance(rows, unit, machine, clock, parameters, slot, now)
        _use_port(unit, machine, clock, parameters, now)
    last = numbers[LAST_CYCLE]
    for slot in range(n_slots):
        clock.cycles[IDLE] += last - clock.slots.since[slot]
        clock.slots.since[slot] = last
    return True


@inlined
def _next(machine, clock, parameters, now):
    """Return the next cycle in which something may happen."""
    numbers = clock.numbers
    is_stuck = numbers[IN_FLIGHT] == parameters.mshrs  # then only a fill can help who waits for an MSHR
    if numbers[N_QUEUED] > 0 and not (is_stuck and clock.slots.seen[clock.queue[numbers[QUEUE_HEAD]]] >= 0):
        return now + 1
    waiter = shared.first_waiting(machine)
    if waiter >= 0 and numbers[N_QUEUED] == 0 and machine.clock[BLOCKED] != waiter:
        return now + 1
    cycle = next_cycle(clock.calendar, now)
    if (numbers[N_QUEUED] > 0 or waiter >= 0) and numbers[IN_FLIGHT] > 0:
        cycle = min(cycle, max(clock.arrival[clock.flight[numbers[OLDEST]]], now + 1))
    return cycle


@inlined
def _fill(machine, clock, parameters, now):
    """Install the lines that have arrived."""
    numbers, status, lists = clock.numbers, machine.status, clock.lists
    while numbers[IN_FLIGHT] > 0:
        line = clock.flight[numbers[OLDEST]]
        if clock.arrival[line] > now:
            break
        numbers[OLDEST] = numbers[OLDEST] + 1 if numbers[OLDEST] + 1 < clock.flight.size else 0
        numbers[IN_FLIGHT] -= 1
        is_prefetched = status[line] & UNUSED
        status[line] = (status[line] & (255 - FLYING)) | RESIDENT
        victim = insert(lists, set_of(line, lists.n_sets, parameters.mask), line)
        if victim >= 0:
            left = status[victim] & (255 - RESIDENT)
            if left & UNUSED:
                clock.lines[EVICTED] += 1
                left = (left & (255 - UNUSED)) | LOST
            status[victim] = left | PUSHED_OUT if is_prefetched else left


@inlined
def _advance(rows, unit, machine, clock, parameters, slot, now):
    """Let the ray of a slot go on from the event that is due now."""
    slots, numbers, tree = clock.slots, clock.numbers, machine.tree
    while True:
        event = slots.event[slot]
        if event == VISIT:
            row = slots.row[slot]
            if slots.last_kind[slot] == KIND_LEAF:
                hooks.on_leaf_end(unit, machine, slot)
            if row == slots.end[slot]:
                _end_ray(unit, machine, clock, slot, now)
                if slots.started[slot] == now:  # a slot takes one ray a cycle
                    enter(clock.calendar, slot, now, now + 1)
                    return
                continue
            node = np.int64(rows.nodes[row - rows.first_row])
            _step_stack(unit, machine, clock, parameters, slot, node)
            slots.last_kind[slot] = rows.kinds[row - rows.first_row]
            slots.last_node[slot] = node
            slots.since[slot] = now
            if tree.n_lines[node] > 0:
                slots.seen[slot] = -1
                slots.lines_done[slot] = 0
                slots.data_at[slot] = 0
                place = numbers[QUEUE_HEAD] + numbers[N_QUEUED]
                clock.queue[place if place < clock.queue.size else place - clock.queue.size] = slot
                numbers[N_QUEUED] += 1
                return
            if _after_test(machine, clock, parameters, slot, now):
                return
        elif event == LEAF:
            n_prims = np.int64(tree.n_prims[slots.last_node[slot]])
            start = now
            if parameters.n_units > 0:
                free = clock.units_free
                best = 0
                for i in range(1, free.size):
                    if free[i] < free[best]:
                        best = i
                start = max(now, free[best])
                free[best] = start + n_prims * parameters.every
            clock.cycles[UNIT] += start - now
            slots.event[slot] = TEST
            if start > now:
                enter(clock.calendar, slot, now, start)
                return
        elif event == TEST:
            node = slots.last_node[slot]
            took = _test_cycles(parameters, np.int64(tree.n_prims[node]))
            clock.cycles[TRIANGLE] += took
            _note(clock, now, took, slot, LOG_TRIANGLES, node, slots.ray[slot])
            slots.event[slot] = VISIT
            slots.row[slot] += 1
            hooks.on_leaf(unit, machine, slot, node)
            if took > 0:
                enter(clock.calendar, slot, now, now + took)
                return
        elif not _start_ray(rows, unit, machine, clock, slot, now):
            return


@inlined
def _test_cycles(parameters, n_prims):
    """Return how long the test of a leaf's triangles takes."""
    return (n_prims - 1) * parameters.every + parameters.triangle if n_prims > 0 else np.int64(0)


@inlined
def _after_test(machine, clock, parameters, slot, cycle):
    """Set the slot's event after the box test, which ends in ``cycle``; return whether it is in the future."""
    slots = clock.slots
    now = machine.clock[NOW]
    if slots.last_kind[slot] == KIND_LEAF and machine.tree.n_prims[slots.last_node[slot]] > 0:
        slots.event[slot] = LEAF
    else:
        slots.event[slot] = VISIT
        slots.row[slot] += 1
    if cycle > now:
        enter(clock.calendar, slot, now, cycle)
        return True
    return False


@inlined
def _step_stack(unit, machine, clock, parameters, slot, node):
    """Push or pop what the ray pushed or popped on its way from the last node to this one."""
    slots, sp, last = clock.slots, machine.sp, clock.slots.last_kind[slot]
    if last < 0:
        return
    if last == KIND_PUSH:
        machine.stack[slot, sp[slot]] = ((node - 1) ^ 1) + 1
        machine.pushed_at[slot, sp[slot]] = slots.row[slot] - 1
        sp[slot] += 1
        hooks.on_push(unit, machine, slot)
    elif last == KIND_LEAF or not parameters.follows or machine.tree.parent[node] != slots.last_node[slot]:
        height = sp[slot] - 1
        while parameters.skips and machine.stack[slot, height] != node:
            height -= 1
        sp[slot] = height
        hooks.on_pop(unit, machine, slot)


@inlined
def _start_ray(rows, unit, machine, clock, slot, now):
    """Give the slot its next ray; return whether it runs now."""
    slots, numbers = clock.slots, clock.numbers
    ray = slots.ray[slot] + 1
    n_rays = rows.first_ray + rows.waits_for.size
    if ray == 0 or ray >= n_rays or rows.waits_for[ray - rows.first_ray] != -2:  # no shadow ray of the last
        ray = numbers[NEXT_RAY]
        while ray < n_rays and rows.waits_for[ray - rows.first_ray] == -2:
            ray += 1
        if ray >= n_rays:
            numbers[NEXT_RAY] = ray
            return False
        numbers[NEXT_RAY] = ray + 1
    slots.ray[slot] = ray
    slots.row[slot], slots.end[slot] = rows.first[ray - rows.first_ray], rows.first[ray - rows.first_ray + 1]
    slots.last_kind[slot] = -1
    slots.event[slot] = VISIT
    slots.started[slot] = now
    machine.sp[slot] = 0
    clock.cycles[IDLE] += now - slots.since[slot]
    slots.since[slot] = now
    hooks.on_start(unit, machine, slot)
    primary = rows.waits_for[ray - rows.first_ray]
    if primary >= 0:
        for other in range(slots.ray.size):
            if other != slot and slots.ray[other] == primary and slots.event[other] != FREE:
                slots.waiter[other] = slot
                return False
    return True


@inlined
def _end_ray(unit, machine, clock, slot, now):
    """Note that the ray of a slot has ended; a shadow ray that waited for it starts in the next cycle."""
    slots = clock.slots
    hooks.on_end(unit, machine, slot)
    slots.event[slot] = FREE
    slots.since[slot] = now
    clock.numbers[LAST_CYCLE] = now
    waiter = slots.waiter[slot]
    if waiter >= 0:
        slots.waiter[slot] = -1
        clock.cycles[IDLE] += now + 1 - slots.since[waiter]
        enter(clock.calendar, waiter, now, now + 1)


@inlined
def _use_port(unit, machine, clock, parameters, now):
    """Let the port take what waits: demand reads, then prefetches."""
    slots, numbers = clock.slots, clock.numbers
    machine.clock[BLOCKED] = -1
    free = parameters.ports
    while free > 0 and numbers[N_QUEUED] > 0:
        slot = clock.queue[numbers[QUEUE_HEAD]]
        node = slots.last_node[slot]
        line = np.int64(machine.tree.first_line[node]) + slots.lines_done[slot]
        if slots.seen[slot] < 0:
            slots.seen[slot] = now
            clock.cycles[PORT] += now - slots.since[slot]
        if not _read(unit, machine, clock, parameters, slot, line, now):
            return
        clock.cycles[MSHR] += now - slots.seen[slot]
        slots.seen[slot] = -1
        slots.since[slot] = now
        slots.lines_done[slot] += 1
        free -= 1
        if slots.lines_done[slot] < machine.tree.n_lines[node]:
            continue
        numbers[QUEUE_HEAD] = numbers[QUEUE_HEAD] + 1 if numbers[QUEUE_HEAD] + 1 < clock.queue.size else 0
        numbers[N_QUEUED] -= 1
        data_at = slots.data_at[slot]
        clock.cycles[slots.data_from[slot]] += data_at - now
        clock.cycles[BOX] += parameters.box
        slots.since[slot] = data_at + parameters.box
        _note(clock, now, data_at - now, slot, LOG_READ, node, slots.ray[slot])
        _note(clock, data_at, parameters.box, slot, LOG_BOX, node, slots.ray[slot])
        _after_test(machine, clock, parameters, slot, data_at + parameters.box)
    while free > 0:
        slot = shared.first_waiting(machine)
        if slot < 0:
            return
        wanted = hooks.request(unit, machine, slot)
        if wanted == hooks.NOTHING:
            shared.stop_waiting(machine, slot)
            continue
        line, n_lines = -2 - wanted, np.int64(1)
        if wanted >= 0:
            line, n_lines = np.int64(machine.tree.first_line[wanted]), np.int64(machine.tree.n_lines[wanted])
        if not _prefetch(machine, clock, parameters, slot, line + machine.lines_asked[slot], now):
            machine.clock[BLOCKED] = slot
            return
        machine.last_issue[slot] = now
        free -= 1
        machine.lines_asked[slot] += 1
        if machine.lines_asked[slot] == n_lines:
            machine.lines_asked[slot] = 0
            machine.candidates[ISSUED] += 1
            hooks.requested(unit, machine, slot)


@inlined
def _read(unit, machine, clock, parameters, slot, line, now):
    """Look up a line of a demand read; return False if it needs an MSHR and none is free."""
    status, account = machine.status, clock.lines
    state = status[line]
    ready, cause, outcome = now + parameters.hit, HIT, shared.HIT
    if parameters.is_perfect:
        account[DEMAND_HITS] += 1
    elif state & (RESIDENT | FLYING):
        if state & FLYING:
            ready = max(ready, clock.arrival[line])
        else:
            refresh(clock.lists, set_of(line, clock.lists.n_sets, parameters.mask), line)
        is_late, is_first_use = ready > now + parameters.hit, state & UNUSED != 0
        if is_first_use:
            status[line] = state & (255 - UNUSED)
            outcome = shared.FIRST_USE
            account[SAVED] += now + parameters.miss - ready
            account[WAITED] += ready - (now + parameters.hit)
            account[LATE_USED if is_late else TIMELY] += 1
        if not is_late:
            account[DEMAND_HITS] += 1
        elif is_first_use:
            cause = LATE
        else:
            cause = MISS
            account[DEMAND_JOINED] += 1
    else:
        if clock.numbers[IN_FLIGHT] == parameters.mshrs:
            return False
        if state & PUSHED_OUT:
            account[POLLUTION] += 1
        account[DEMAND_MISSES] += 1
        _ask_memory(machine, clock, parameters, line, now)
        ready, cause, outcome = clock.arrival[line], MISS, shared.MISS
    if ready > clock.slots.data_at[slot]:
        clock.slots.data_at[slot], clock.slots.data_from[slot] = ready, cause
    hooks.on_visit(unit, machine, slot, line, outcome)
    return True


@inlined
def _prefetch(machine, clock, parameters, slot, line, now):
    """Look up a line for a prefetch; return False if it needs an MSHR and none is free."""
    state, account = machine.status[line], clock.lines
    if parameters.is_perfect or state & RESIDENT:
        if not parameters.is_perfect:
            refresh(clock.lists, set_of(line, clock.lists.n_sets, parameters.mask), line)
        account[REDUNDANT] += 1
    elif state & FLYING:
        account[JOINED] += 1
    else:
        if clock.numbers[IN_FLIGHT] == parameters.mshrs:
            return False
        account[FILLED] += 1
        _ask_memory(machine, clock, parameters, line, now)
        machine.status[line] |= UNUSED
    _note(clock, now, np.int64(1), slot, LOG_PREFETCH, line, clock.arrival[line])
    return True


@inlined
def _ask_memory(machine, clock, parameters, line, now):
    """Request a line from memory through an MSHR that is free."""
    numbers = clock.numbers
    if machine.status[line] & LOST:
        clock.lines[WANTED_AGAIN] += 1
    arrival = max(now + parameters.miss, numbers[BUS_FREE] + parameters.transfer)
    numbers[BUS_FREE] = arrival
    place = numbers[OLDEST] + numbers[IN_FLIGHT]
    clock.flight[place if place < clock.flight.size else place - clock.flight.size] = line
    numbers[IN_FLIGHT] += 1
    clock.arrival[line] = arrival
    machine.status[line] = FLYING


@inlined
def _note(clock, cycle, length, slot, what, node, ray):
    """Keep an event for the timeline."""
    n = clock.numbers[N_LOGGED]
    if n < clock.log.shape[0]:
        clock.log[n, 0], clock.log[n, 1], clock.log[n, 2] = cycle, length, slot
        clock.log[n, 3], clock.log[n, 4], clock.log[n, 5] = what, node, ray
        clock.numbers[N_LOGGED] = n + 1
