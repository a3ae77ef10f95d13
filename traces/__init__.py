"""The contract between the stages: what a run on disk is, how it is written and read."""
