"""Stage 2: a run on disk -> cache counts -> tables and reports."""
