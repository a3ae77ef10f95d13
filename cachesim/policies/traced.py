"""The requests that were recorded with the trace: those of the paper's unit, had it all the time it wants."""

from cachesim.policies import Policy, no_options

FORM = "traced"
HELP = "the requests in the trace, those of stack"

POLICY = Policy("traced", FORM, no_options, begins_anew=True)
