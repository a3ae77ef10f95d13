"""Scenes: mesh files, the catalogue, stand-ins."""
