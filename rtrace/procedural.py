"""Built-in scenes of the same kind and size as the benchmark scenes, for where those cannot be had; and small test shapes."""

from rtrace.shapes import boxes, height_field, icosphere, soup

__all__ = ["boxes", "height_field", "icosphere", "soup"]
