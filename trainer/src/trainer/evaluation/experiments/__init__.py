"""The experiments of ``trainer evaluate``, and the comparison that decided the defaults of ``trainer fit``."""
