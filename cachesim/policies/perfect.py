"""The bound of all prefetchers of nodes: every demand read is a hit. What is left is tests, hits and the port."""

from cachesim.policies import Policy, no_options
from cachesim.policies.none import make_unit

FORM = "perfect"
HELP = "every read hits: no prefetcher, but the bound of all"

POLICY = Policy("perfect", FORM, no_options, make_unit, needs_clock=True, is_perfect=True)
