"""Mutations of the clock, the prefetch policies and their replay without a clock."""

# ruff: noqa: E501
# fmt: off

from tests.mutations.mutation import Mutation

KERNEL, MEMORY, CALENDAR, TIMING, STRETCHES = (
    f"cachesim/clock/{name}.py" for name in ("kernel", "memory", "calendar", "timing", "stretches")
)
MODEL, WORKED, LAWS, EQUATION = (f"tests/cachesim/clock/test_{name}.py" for name in ("clock_model", "worked", "laws", "equation_1"))
STACK, PUSH, TTP, NEXT, STRIDE, TREELET, ORACLE, PREDICTOR = (f"tests/cachesim/policies/test_{name}.py" for name in ("stack", "push", "ttp", "next_line", "stride", "treelet", "oracle", "predictor"))
TALLY = "tests/cachesim/clock/test_tally.py"
UNTIMED, NEEDS, FOREIGN = (f"tests/cachesim/policies/test_{name}.py" for name in ("untimed", "needs_clock", "foreign"))


def policy(name):
    return f"cachesim/policies/{name}.py"


MUTATIONS = [
    # The kernel
    Mutation("clock: a line arrives a cycle late", MEMORY, "if clock.arrival[line] > now:", "if clock.arrival[line] >= now:", WORKED),
    Mutation("clock: prefetches go before reads that wait", KERNEL, "while free > 0 and numbers.n_queued > 0:\n        slot = clock.queue", "while free > 0 and numbers.n_queued > 0 and first_waiting(machine) < 0:\n        slot = clock.queue", STACK),
    Mutation("clock: a read that joins a line waits for a whole miss", MEMORY, "ready = max(hit_at, clock.arrival[line])", "ready = now + parameters.miss", WORKED),
    Mutation("clock: a hit refreshes nothing", MEMORY, "        else:\n            refresh(clock.lists, set_of(line, clock.lists.n_sets, parameters.mask), line)\n        if state & UNUSED:", "        if state & UNUSED:", MODEL),
    Mutation("clock: a redundant prefetch refreshes nothing", MEMORY, "    elif state & RESIDENT:\n        refresh(clock.lists, set_of(line, clock.lists.n_sets, parameters.mask), line)\n", "    elif state & RESIDENT:\n", STACK),
    Mutation("clock: the last MSHR is kept from prefetches", MEMORY, "        found = T_JOINED\n    else:\n        if numbers.in_flight == parameters.mshrs:\n            return False\n", "        found = T_JOINED\n    else:\n        if numbers.in_flight == parameters.mshrs - 1:\n            return False\n", STACK),
    Mutation("clock: memory delivers lines back to back", MEMORY, "numbers.bus_free + parameters.transfer)", "numbers.bus_free)", MODEL),
    Mutation("clock: the intersection unit is free when the first triangle is done", KERNEL, "np.int64(tree.n_prims[ray.last_node]) * parameters.every)", "np.int64(1) * parameters.every)", MODEL),
    Mutation("clock: triangles of a leaf are tested at once", KERNEL, "return (n_prims - 1) * parameters.every + parameters.triangle", "return parameters.triangle", WORKED),
    Mutation("clock: a shadow ray starts with its primary ray", KERNEL, "if other != slot and clock.slots[other].number == primary and", "if other == slot and clock.slots[other].number == primary and", MODEL),
    Mutation("clock: a shadow ray starts in the cycle after next", KERNEL, "        _schedule(clock, waiter, now, now + 1)\n", "        _schedule(clock, waiter, now, now + 2)\n", MODEL),
    Mutation("clock: a waiting MSHR counts as the port", KERNEL, "clock.cycles[SPENT_MSHR] += now - ray.seen", "clock.cycles[SPENT_PORT] += now - ray.seen", MODEL),
    Mutation("clock: the cycles before a ray's start are lost", KERNEL, "    clock.cycles[SPENT_IDLE] += now - ray.since\n    ray.since = now\n    hooks", "    ray.since = now\n    hooks", MODEL),
    Mutation("clock: a late prefetch saves a whole miss", MEMORY, "numbers.saved += now + parameters.miss - ready", "numbers.saved += parameters.miss", WORKED),
    Mutation("clock: a used line that is evicted counts as lost", MEMORY, "            status[line] = state & (255 - UNUSED)\n", "", LAWS + " -k issued"),
    Mutation("clock: every eviction is pollution", MEMORY, "status[victim] = left | PUSHED_OUT if is_prefetched else left", "status[victim] = left | PUSHED_OUT", STACK),
    Mutation("clock: prefetches go on after the last ray", KERNEL, "        if rows.is_last and numbers.n_ended == n_rays:\n            break\n", "", TREELET),
    Mutation("clock: entries beyond the hit stay on the stack", KERNEL, "while parameters.skips and machine.stack[slot, height] != node:", "while False:", MODEL + " " + STACK),
    Mutation("clock: the cache of the bound has misses", MEMORY, "    if parameters.is_perfect:\n        numbers.hits += 1\n", "    if parameters.is_perfect and state:\n        numbers.hits += 1\n", LAWS + " -k perfect"),
    Mutation("clock: hits take a cycle more", MEMORY, "hit_at = now + parameters.hit\n", "hit_at = now + parameters.hit + 1\n", EQUATION),
    Mutation("clock: a requested line is of the root's level", MEMORY, "else clock.level_of[line]", "else np.int64(0)", TALLY),
    Mutation("clock: a leaf counts before its test", KERNEL, " or parameters.by == BY_LEAF):", "):", TALLY),
    Mutation("clock: classes of leaves are cut to 16 bits", "cachesim/clock/state.py", "class_of=np.zeros(n_lines if parameters.by else 0, np.uint32)", "class_of=np.zeros(n_lines if parameters.by else 0, np.uint16)", "tests/cachesim/test_limits.py -k leaf"),
    # The calendar
    Mutation("calendar: slots beyond 31 are shown as others", CALENDAR, "np.uint64(slot & 63)", "np.uint64(slot & 31)", "tests/cachesim/clock/test_calendar.py"),
    Mutation("calendar: the rest of today's word is not looked at", CALENDAR, "    if bits:\n        return now + 1 + lowest_bit(bits)\n", "", MODEL),
    # Timing and stretches
    Mutation("timing: a leaf that is no node is read", TIMING, "        n_lines[columns[\"axis\"] == 3] = 0\n", "        n_lines[columns[\"axis\"] == 4] = 0\n", NEEDS),
    Mutation("timing: no scout goes before", TIMING, "**({\"scouted\": scout.unit} if scout else {})", "**({\"scouted\": None} if scout else {})", NEEDS),
    Mutation("timing: rays are let go before they have ended", TIMING, "return int(min(begun.min(initial=1 << 62), self.clock.numbers[0].next_ray))", "return int(self.clock.numbers[0].next_ray)", "tests/cachesim/clock/test_stretches.py"),
    Mutation("stretches: a shadow ray follows any ray before it", STRETCHES, "elif primary_of[pixels[ray]] == ray - 1 and ray > 0:", "elif ray > 0:", "tests/cachesim/clock/test_stretches.py"),
    # Policies
    Mutation("push: the sibling is requested after it has been popped", policy("push"), "if self.entry[slot] >= machine.sp[slot]:", "if self.entry[slot] > machine.sp[slot]:", PUSH),
    Mutation("push: what waits stays when the ray ends", policy("push"), "    def on_end(self, machine, slot):\n        if self.entry[slot] >= 0:", "    def on_end(self, machine, slot):\n        if self.entry[slot] > 99:", PUSH),
    Mutation("push: a leaf that is no node is requested", policy("push"), "        if machine.tree.n_lines[machine.stack[slot, machine.sp[slot] - 1]] > 0:\n", "        if True:\n", UNTIMED),
    Mutation("ttp: the second pop requests three", policy("ttp"), "_FIRST, _SECOND, _MORE = 1, 2, 16", "_FIRST, _SECOND, _MORE = 1, 3, 16", UNTIMED),
    Mutation("ttp: a push does not reset the count of pops", policy("ttp"), "        self.pointer[slot] = machine.sp[slot]\n        self.pops[slot] = 0\n", "        self.pointer[slot] = machine.sp[slot]\n", UNTIMED),
    Mutation("ttp: a request stays when its node is demanded", policy("ttp"), "if node == demanded:", "if node < 0:", TTP),
    Mutation("ttp: entries are requested twice", policy("ttp"), "            self.pointer[slot] -= 1\n            left -= 1\n            node = machine.stack[slot, self.pointer[slot]]\n", "            left -= 1\n            node = machine.stack[slot, self.pointer[slot] - 1]\n", UNTIMED),
    Mutation("next line: tagged as miss", policy("next_line"), "(self.trigger == TAGGED and outcome != HIT)", "(self.trigger == TAGGED and outcome == MISS)", NEXT),
    Mutation("next line: the distance is one", policy("next_line"), "replace(self, machine, slot, line + self.distance)", "replace(self, machine, slot, line + 1)", NEXT),
    Mutation("stride: lines before the tree's first are offered", policy("next_line"), "if 0 <= line < machine.status.size:", "if line < machine.status.size:", STRIDE),
    Mutation("stride: one stride confirms itself", policy("stride"), "is_own = stride == self.stride[slot]", "is_own = stride != 0", STRIDE),
    Mutation("stride: no stride of another ray", policy("stride"), "if is_own or stride == self.shared[0]:", "if is_own:", STRIDE),
    Mutation("stride: the last line of the ray before", policy("stride"), "        self.last[slot] = -1\n", "", STRIDE + " -k before"),
    Mutation("stride: the stride of the ray before", policy("stride"), "        self.stride[slot] = 0\n", "", STRIDE + " -k before"),
    Mutation("treelet: a line is of its last node", policy("machine"), "lowest[line] = min(lowest[line], values[node])", "lowest[line] = values[node]", TREELET),
    Mutation("treelet: a vote at every read", policy("treelet"), "if now - self.vote[0] < self.every:", "if now < self.every:", TREELET),
    Mutation("treelet: rays that have ended vote", policy("treelet"), "            self.votes[self.current[slot]] -= 1\n            self.current[slot] = -1\n", "            self.current[slot] = -1\n", TREELET),
    Mutation("treelet: the share of all slots", policy("treelet"), "self.share * n_rays:", "self.share * self.current.size:", TREELET),
    Mutation("treelet: the last winner may win again", policy("treelet"), "if winner == self.vote[1] or 100", "if 100", TREELET),
    Mutation("treelet: filled depth-first", policy("treelet"), "            node = queue[head]\n            head += 1\n", "            tail -= 1\n            node = queue[tail]\n", TREELET),
    Mutation("oracle: a use is credited when the last line is asked for", policy("oracle"), "line = np.int64(machine.tree.first_line[node]) + machine.lines_asked[slot]", "line = np.int64(machine.tree.first_line[node])", ORACLE),
    Mutation("oracle: every read is a use", policy("oracle"), "if outcome == FIRST_USE:", "if outcome != 2:", ORACLE),
    Mutation("predictor: looked up before the primary ray has ended", policy("predictor"), "        self.predicted[slot], self.leaf[slot] = -2, -1\n", "        self.predicted[slot], self.leaf[slot] = look_up(self, machine.ray[slot]), -1\n        if self.predicted[slot] >= 0:\n            offer(machine, slot, walk(self, machine, slot))\n", PREDICTOR),
    Mutation("predictor: a request stays when its node is read", policy("predictor"), "if first <= line < first + machine.tree.n_lines[node]:", "if line < 0:", PREDICTOR),
    Mutation("predictor: rays that miss are learned", policy("predictor"), "if node <= 0 or not self.is_hit[ray]:", "if node <= 0:", PREDICTOR),
    Mutation("predictor: a right prediction is replaced", policy("predictor"), "if above != self.predicted[slot]:", "if True:", PREDICTOR),
    Mutation("predictor: a look-up refreshes nothing", policy("predictor"), "    put_first(unit, of, way, unit.keys[ray], node)\n    return node\n", "    return node\n", PREDICTOR + " -k recently"),
    Mutation("predictor: the path goes one level higher", policy("predictor"), "while left > 0 and machine.tree.level[node] > 1:", "while left >= 0 and machine.tree.level[node] > 1:", PREDICTOR),
    Mutation("predictor: rays are counted by slot", KERNEL, "machine.sp[slot], machine.ray[slot] = 0, number", "machine.sp[slot], machine.ray[slot] = 0, slot", PREDICTOR),
    Mutation("predictor: theta keeps the lower bits", policy("predictor"), "np.hypot(x, y), z)).astype(np.int64) >> (8 - direction_bits)", "np.hypot(x, y), z)).astype(np.int64) & ((1 << direction_bits) - 1)", PREDICTOR + " -k key"),
    Mutation("rays: rays that read nothing are counted", "traces/rays.py", "    read = rays[\"count\"] > 0\n", "    read = rays[\"count\"] >= 0\n", "tests/traces/test_rays.py"),
    Mutation("rays: a shadow ray begins where any primary ray hits", "traces/rays.py", "    of = primary[place]\n", "    of = primary[place - 1]\n", "tests/traces/test_rays.py"),
    Mutation("live: what is popped unread is wanted", policy("stack"), "        self.used[machine.pushed_at[slot, machine.sp[slot]]] = 1\n", "        self.used[:] = 1\n", UNTIMED),
    Mutation("stack: the level is that of the leaf above", policy("stack"), "machine.tree.level[node] > unit.levels", "machine.tree.level[node] >= unit.levels", UNTIMED),
    Mutation("stack: what is given up is not counted", policy("stack"), "        drop(machine, slot, unit.open[slot])\n", "        pass\n", STACK),
    Mutation("candidates: no time for one", policy("machine"), "elif machine.last_issue[slot] == port.now - 1:", "elif machine.last_issue[slot] == port.now:", STACK),
    Mutation("ring: the slot that waits shortest goes first", policy("machine"), "    first = machine.waiting[0, ring]\n", "    first = machine.waiting[1, ring]\n", STACK),
    Mutation("ring: lines asked of a node given up count for the next", policy("machine"), "    machine.lines_asked[slot] = 0\n", "", PUSH),
    # Part of a run
    Mutation("parts: the warm-up is counted", "cachesim/clock/sampled_rays.py", "            at += int(cuts[piece] - cuts[piece - 1])\n", "", "tests/cachesim/clock/test_sampled_rays.py"),
    Mutation("parts: every piece is warmed up by itself", "cachesim/clock/sampled_rays.py", "stretches.append((int(cuts[piece - 1]), int(cuts[piece])))", "stretches.append((int(cuts[piece]), int(cuts[piece + 1])))", "tests/cachesim/clock/test_sampled_rays.py"),
    Mutation("parts: rays that differ without and with prefetches do not cancel", "cachesim/clock/sampled_rays.py", "(residuals, slow_residuals - residuals)", "(residuals, slow_residuals)", "tests/cachesim/clock/test_sampled_rays.py"),
    Mutation("parts: a map of part of the rays is taken for one of all", "nptrace/break_even.py", "leaf, asdict(grid), one_in,", "leaf, asdict(grid),", "tests/nptrace/test_clock_commands.py -k part_of"),
    # Without a clock, and policies of others
    Mutation("replay: a policy that needs the clock is replayed", "cachesim/prefetch.py", "if prefetch.policy.needs_clock:", "if prefetch.policy.needs_clock and prefetch.kind != \"treelet\":", NEEDS),
    Mutation("replay: a scout that is left out", "cachesim/prefetch.py", "unit = scout(self._machine, self._facts, **prefetch.options) if scout else None", "unit = None", UNTIMED),
    Mutation("kernels: those of another package's unit are stored", "nptrace_base/jit.py", "if all(map(_is_ours, data.signature.args)) and self._open():", "if self._open():", FOREIGN),
    Mutation("kernels: policies do not count as imported", "nptrace_base/source_files.py", "return tuple(file for name in _names(text) for file in _files(name)) + tuple(listed)", "return tuple(file for name in _names(text) for file in _files(name))", "tests/nptrace_base/test_kernel_cache.py -k listing"),
    Mutation("compare: lines longer than the cache", "cachesim/clock/compare.py", "if not 0 < ways <= lines or", "if lines < ways or", "tests/cachesim/clock/test_baselines.py"),
    Mutation("kernels: everybody's packages count as imported", "nptrace_base/source_files.py", "((?:{'|'.join(OURS)})\\b[.\\w]*)", "([.\\w]+)", "tests/nptrace_base/test_kernel_cache.py -k everybodys"),
]
