"""Estimates from part of the rays."""
