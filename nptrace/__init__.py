"""nptrace: node-cache studies in ray tracing."""

__all__ = ["__version__"]

__version__ = "0.1.0"
