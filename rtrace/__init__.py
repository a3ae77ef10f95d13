"""Stage 1: scene -> tree -> traced rays -> a run on disk."""
