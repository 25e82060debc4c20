"""The experiments of ``trainer evaluate``."""
