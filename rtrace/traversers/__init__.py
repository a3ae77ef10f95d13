"""One kernel per node format, and what they share."""
