"""Comparisons that decided a default."""
