"""Scenes and rays that are hard for floats, each with its answer, one kind of difficulty per module."""
