"""Results as tables, CSV, JSON and plots."""
