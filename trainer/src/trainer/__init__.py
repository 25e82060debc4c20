"""Radar datasets to networks that image sharper than the array."""
