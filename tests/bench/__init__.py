"""Benchmarks: ratios against peers in the same process. Nothing here is a test; no time is asserted anywhere."""
