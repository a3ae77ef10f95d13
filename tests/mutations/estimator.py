"""Mutations of an estimate: its claims, its variances, its file of counts."""

# ruff: noqa: E501
# fmt: off

from tests.mutations.mutation import Mutation

QU, SA = "cachesim/sampling/quantities.py", "cachesim/sampling/sampler.py"
ES, UN, RE, SP, RU, KE = "cachesim/sampling/estimate.py", "cachesim/sampling/unit_counts.py", "cachesim/sampling/two_phase.py", "cachesim/sampling/spread.py", "rtrace/ray_source.py", "cachesim/sampling/resume_file.py"
CLAIMS, SPREAD, RESUME = "tests/cachesim/sampling/test_estimate_claims.py", "tests/cachesim/sampling/test_spread.py", "tests/cachesim/sampling/test_resume.py"

MUTATIONS = [
    # --- quantities ---
    Mutation("estimate claims: the paper's rate over demand accesses", QU, "Ratio((both,), (everything,))", "Ratio((both,), (demand,))", f"{CLAIMS} -k every_quantity"),
    Mutation("estimate claims: demand B over all accesses", QU, "Ratio((with_,), (demand,))", "Ratio((with_,), (everything,))", f"{CLAIMS} -k every_quantity"),
    Mutation("estimate claims: demand B/A over all misses of B", QU, "Ratio((with_,), (alone,))", "Ratio((with_,), (both,))", f"{CLAIMS} -k every_quantity"),
    Mutation("estimate claims: traffic over B's demand misses", QU, "Ratio((both,), (alone,))", "Ratio((both,), (with_,))", f"{CLAIMS} -k every_quantity"),
    Mutation("estimate claims: bytes of B are those of A", QU, "Ratio((config.line_bytes * both,))", "Ratio((config.line_bytes * alone,))", f"{CLAIMS} -k every_quantity"),
    Mutation("estimate claims: accesses per position", QU, "Ratio((demand,), (form(RAYS),))", "Ratio((everything,), (form(RAYS),))", f"{CLAIMS} -k every_quantity"),
    Mutation("estimate claims: half width and unsettled part swapped", ES, '"half_width": value.half, "unsettled": value.bracket', '"half_width": value.bracket, "unsettled": value.half', f"{CLAIMS} -k json"),
    Mutation("estimate claims: NaN is printed", ES, "None if math.isnan(interval.value) else interval", "interval", f"{CLAIMS} -k without_accesses"),
    # --- what it took ---
    Mutation("estimate claims: warm-up left out of the share", UN, "(min(far, low), stop)", "(start, stop)", f"{CLAIMS} -k share"),
    Mutation("estimate claims: the long warm-up left out of the share", UN, "(min(far, low), stop)", "(low, stop)", f"{CLAIMS} -k share"),
    Mutation("estimate claims: the scout left out of the share", UN, "self._looked = np.concatenate([self._looked, looked])", "pass", f"{CLAIMS} -k share"),
    Mutation("estimate claims: rays traced twice count twice", UN, "np.maximum(spans[:, 1] - np.maximum(spans[:, 0], reached[:-1]), 0).sum()", "(spans[:, 1] - spans[:, 0]).sum()", f"{CLAIMS} -k share"),
    Mutation("estimate claims: shares forget what was resumed", UN, "self._spans += [(int(low), int(high)) for low, high in found.spans]", "pass", f"{CLAIMS} -k share"),
    Mutation("estimate claims: seconds of counting alone", ES, "seconds = time.perf_counter() - call.start", "seconds = counts.work.wall_s", f"{CLAIMS} -k seconds"),
    Mutation("estimate claims: seconds and exact seconds swapped", ES, "seconds=seconds, exact_seconds=exact_seconds)\n", "seconds=exact_seconds, exact_seconds=seconds)\n", f"{CLAIMS} -k seconds"),
    Mutation("estimate claims: seconds of an exact run without the abandoned sample", ES, "seconds=end - call.start, exact_seconds=end - before", "seconds=end - before, exact_seconds=end - call.start", f"{CLAIMS} -k everything_once"),
    Mutation("estimate claims: prefetches cost nothing", SA, "found.totals[[ACCESSES, PREFETCHES]].sum()", "found.totals[[ACCESSES]].sum()", f"{CLAIMS} -k seconds"),
    Mutation("estimate claims: a call costs nothing", "cachesim/sampling/work.py", "return x * each + n * max((self.y - each * self.x) / self.n, 0.0)", "return x * each", f"{CLAIMS} -k line_through"),
    Mutation("estimate claims: other programs do not slow the exact run", "cachesim/sampling/work.py", "return cpu * self.wall_s / max(self.tracing.y + self.replaying.y, 1e-9)", "return cpu", f"{CLAIMS} -k line_through"),
    # --- seeds, batches, parts ---
    Mutation("estimate claims: the seed draws nothing", "cachesim/sampling/strata.py", "np.random.default_rng([self._seed, a, b])", "np.random.default_rng([0, a, b])", "tests/cachesim/sampling/test_two_phase.py -k nested"),
    Mutation("estimate claims: the scout looks at the same pixels for every seed", RU, "np.random.default_rng([seed, step])", "np.random.default_rng([0, step])", f"{CLAIMS} -k elsewhere"),
    Mutation("estimate claims: the probe takes the same pixels for every seed", RU, "np.random.default_rng(seed).integers(self._n_pixels", "np.random.default_rng(0).integers(self._n_pixels", f"{CLAIMS} -k elsewhere"),
    Mutation("estimate claims: stretches in batches of one", RU, "self._shooting.batch, None), cuts)", "1, None), cuts)", "tests/cachesim/sampling/test_estimate.py -k stretches"),
    Mutation("ray source: pieces of a chunk in the wrong order", RU, "reversed(smaller_pieces(start, stop, batch, pass_))", "smaller_pieces(start, stop, batch, pass_)", "tests/rtrace/test_ray_source.py"),
    Mutation("ray source: the limit is not handed on", RU, "pass_, MOST_EVENTS)", "pass_, None)", "tests/rtrace/test_ray_source.py"),
    Mutation("estimate claims: units cut batches", UN, "unit = -(-source.unit // source.grain) * source.grain", "unit = source.unit", f"{CLAIMS} -k units_warmed"),
    Mutation("estimate claims: warm-ups cut batches", UN, "return max(position - -(-n // grain) * grain, 0)", "return max(position - n, 0)", f"{CLAIMS} -k cuts_a_batch"),
    Mutation("estimate claims: the last part of a run is left out", UN, "np.append(np.arange(0, source.n_positions, unit), source.n_positions)", "np.arange(0, source.n_positions + 1, unit)", f"{CLAIMS} -k what_is_left"),
    Mutation("estimate claims: narrow pictures in rows", RU, "rows * shooting.width", "shooting.width", "tests/cachesim/sampling/test_estimate.py -k flat_and_high"),
    # --- what is stated ---
    Mutation("estimate claims: no finite-population factor", RE, "sizes**2 * (1 - drawn / sizes) / drawn", "sizes**2 / drawn", f"{CLAIMS} -k half_width"),
    Mutation("estimate claims: no finite-population factor of the second phase", RE, "(1 / m - 1 / n_units)", "(1 / m)", f"{CLAIMS} -k half_width"),
    Mutation("estimate claims: a figure without a bound is printed", SA, "is_within = widest <= 1 and is_stated and not flags", "is_within = widest <= 1 and not flags", f"{CLAIMS} -k without_a_bound"),
    Mutation("estimate claims: open misses are misses to judge by", SA, "seen = sample.known.sum(axis=0) + share * sample.unknown.sum(axis=0)", "seen = (sample.known + sample.unknown).sum(axis=0)", f"{CLAIMS} -k turn_out"),
    Mutation("estimate claims: any sample is drawn", SA, "if least > MOST_SHARE * self._counts.n_positions:", "if least > 60 * self._counts.n_positions:", f"{CLAIMS} -k more_than_it_saves"),
    Mutation("estimate claims: prefetches come evenly", QU, "_BURSTS = 4.0", "_BURSTS = 0.25", f"{CLAIMS} -k bursts"),
    Mutation("spread: steps leave no variance", SP, "_STEP = 1 / 12", "_STEP = 0.0", SPREAD),
    Mutation("spread: a stratum's neighbours do not count", SP, "return np.maximum(own, factor @ expected)", "return own", SPREAD),
    Mutation("spread: what the strata saw themselves does not count", SP, "return np.maximum(own, factor @ expected)", "return factor @ expected", f"{SPREAD} -k by_hand"),
    Mutation("spread: nothing is unlike what was drawn", SP, "n_unlike = (n_units - n) / (n + 1)", "n_unlike = 0.0", SPREAD),
    Mutation("spread: the farthest unit does not count", SP, "np.maximum(distance.max(axis=0), least)", "least", f"{SPREAD} -k by_hand"),
    Mutation("spread: a second sample that agrees leaves no doubt", SP, "return (opened / (m + 2)) ** 2 * (1 - m / n_units)", "return 0.0 * opened", SPREAD),
    Mutation("spread: a value of 0 is certain", RE, "r.unlike * (abs(v) or 1.0) / n_units", "r.unlike * abs(v) / n_units", f"{SPREAD} -k value_of_zero"),
    Mutation("regression: errors of which nothing was seen are those of others", RE, "np.where(np.outer(is_seen, is_seen), covariance / np.outer(scale, scale), 0.0)", "np.where(np.outer(is_seen, is_seen), covariance / np.outer(scale, scale), 1.0)", f"{SPREAD} -k nothing_was_seen"),
    # --- the file of counts ---
    Mutation("kept: a file of another run is continued", KE, "if own == key:", "if own:", RESUME),
    Mutation("kept: arrays are taken as they are", KE, "return _checked(Kept(**arrays), n_units, 3 * n_caches, n_positions)", "return Kept(**arrays)", RESUME),
    Mutation("kept: compressed files of any size", KE, "if any(member.compress_type != zipfile.ZIP_STORED for member in members.infolist()):", "if False:", RESUME),
    Mutation("kept: a missing folder is found when it is too late", UN, "resume_file.check_place(path)", "pass", RESUME),
    Mutation("kept: what a damaged archive raises is a bug", KE, "ValueError, KeyError, TypeError, EOFError, zipfile.BadZipFile, zlib.error", "ValueError, KeyError, TypeError, EOFError, zlib.error", RESUME),
    Mutation("kept: units beyond the run", KE, "if (units >= n_units).any():", "if False:", RESUME),
]
