"""The clock: the cycles in which something happens, one after the other.

In a cycle, lines arrive first, in the order of their requests. Then come the events of the rays, by slot: a test is over,
the next read becomes ready. Then the port takes as many requests as it has places: demand reads in the order in which they
became ready, then prefetches, of the slot that has waited longest. A demand read that needs an MSHR when none is free holds
the port. A slot takes one ray a cycle, so a ray that reads nothing has it for one.
"""

import numpy as np

from cachesim.clock.calendar import NEVER, enter, lowest_bit, next_cycle, take_word
from cachesim.clock.log import LOG_BOX, LOG_READ, LOG_TRIANGLES, note
from cachesim.clock.memory import after, fill, prefetch, read
from cachesim.clock.state import (
    BY_LEAF,
    CYCLES,
    LEAF_DUE,
    RAY_DUE,
    SPENT_BOX,
    SPENT_IDLE,
    SPENT_MSHR,
    SPENT_PORT,
    SPENT_TRIANGLE,
    SPENT_UNIT,
    TEST_DUE,
    VISIT_DUE,
)  # fmt: skip
from cachesim.clock.stretches import THE_RAY_BEFORE
from cachesim.policies import hooks
from cachesim.policies.machine import first_waiting, stop_waiting
from nptrace_base.jit import inlined, kernel
from traces.format import LEAF, PUSH

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
            slots[slot].event = RAY_DUE
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
        fill(machine, clock, parameters, now)
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
        clock.cycles[SPENT_IDLE] += numbers.last_cycle - slots[slot].since
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
def _advance(rows, unit, machine, clock, parameters, slot, now):
    """Let the ray of a slot go on from the event that is due now."""
    ray, numbers, tree = clock.slots[slot], clock.numbers[0], machine.tree
    ray.due = NEVER
    while True:
        if ray.event == VISIT_DUE:
            if ray.last_kind == LEAF:
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
        elif ray.event == LEAF_DUE:
            start = now
            if parameters.n_units > 0:
                start = _take_unit(clock, now, np.int64(tree.n_prims[ray.last_node]) * parameters.every)
                clock.cycles[SPENT_UNIT] += start - now
            ray.event = TEST_DUE
            if start > now:
                _schedule(clock, slot, now, start)
                return
        elif ray.event == TEST_DUE:
            took = _test_cycles(parameters, np.int64(tree.n_prims[ray.last_node]))
            _count_test(clock, slot, now, took)
            ray.event = VISIT_DUE
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
    clock.cycles[SPENT_TRIANGLE] += took
    note(clock, start, took, slot, LOG_TRIANGLES, clock.slots[slot].last_node, clock.slots[slot].number)


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
    n_prims = np.int64(machine.tree.n_prims[ray.last_node]) if ray.last_kind == LEAF else np.int64(0)
    if n_prims > 0 and (parameters.watches_leaves or parameters.n_units > 0 or parameters.by == BY_LEAF):
        ray.event = LEAF_DUE
    else:
        ray.event = VISIT_DUE
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
    if ray.last_kind == PUSH:
        machine.stack[slot, sp[slot]] = ((node - 1) ^ 1) + 1
        machine.pushed_at[slot, sp[slot]] = ray.row - 1
        sp[slot] += 1
        hooks.on_push(unit, machine, slot)
    elif ray.last_kind == LEAF or not parameters.follows or machine.tree.parent[node] != ray.last_node:
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
    if number == 0 or number >= n_rays or rows.waits_for[number - rows.first_ray] != THE_RAY_BEFORE:
        number = numbers.next_ray
        while number < n_rays and rows.waits_for[number - rows.first_ray] == THE_RAY_BEFORE:
            number += 1
        numbers.next_ray = number
        if number >= n_rays:
            return False
        numbers.next_ray += 1
    ray.number = number
    ray.type = rows.types[number - rows.first_ray]
    ray.row, ray.end = rows.first[number - rows.first_ray], rows.first[number - rows.first_ray + 1]
    ray.last_kind = -1
    ray.event = VISIT_DUE
    ray.started = now
    machine.sp[slot], machine.ray[slot] = 0, number
    clock.cycles[SPENT_IDLE] += now - ray.since
    ray.since = now
    hooks.on_start(unit, machine, slot)
    primary = rows.waits_for[number - rows.first_ray]
    if primary >= 0:
        for other in range(clock.slots.size):
            if other != slot and clock.slots[other].number == primary and clock.slots[other].event != RAY_DUE:
                clock.slots[other].waiter = slot
                return False
    return True


@inlined
def _end_ray(unit, machine, clock, slot, now):
    """Note that the ray of a slot has ended; a shadow ray that waited for it starts in the next cycle."""
    ray = clock.slots[slot]
    hooks.on_end(unit, machine, slot)
    ray.event = RAY_DUE
    ray.since = now
    clock.numbers[0].last_cycle = now
    clock.numbers[0].n_ended += 1
    waiter = ray.waiter
    if waiter >= 0:
        ray.waiter = -1
        clock.cycles[SPENT_IDLE] += now + 1 - clock.slots[waiter].since
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
            clock.cycles[SPENT_PORT] += now - ray.since
        if not read(unit, machine, clock, parameters, slot, line, now):
            port.blocked = -1
            return
        clock.cycles[SPENT_MSHR] += now - ray.seen
        ray.seen, ray.since = -1, now
        ray.lines_done += 1
        free -= 1
        if ray.lines_done < machine.tree.n_lines[ray.last_node]:
            continue
        numbers.queue_head = after(numbers.queue_head, clock.queue.size)
        numbers.n_queued -= 1
        clock.cycles[ray.data_from] += ray.data_at - now
        clock.cycles[SPENT_BOX] += parameters.box
        note(clock, now, ray.data_at - now, slot, LOG_READ, ray.last_node, ray.number * N_CAUSES + ray.data_from)
        note(clock, ray.data_at, parameters.box, slot, LOG_BOX, ray.last_node, ray.number)
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
        if not prefetch(machine, clock, parameters, slot, wanted, line + machine.lines_asked[slot], now):
            port.blocked = slot
            return
        machine.last_issue[slot] = now
        free -= 1
        machine.lines_asked[slot] += 1
        if machine.lines_asked[slot] == n_lines:
            machine.lines_asked[slot] = 0
            port.issued += 1
            hooks.requested(unit, machine, slot)
