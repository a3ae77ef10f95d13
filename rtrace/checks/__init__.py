"""Checks of the traversal: hard cases, exact answers, Embree."""
