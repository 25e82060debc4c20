"""Figures, tables and the page in which a person looks at them."""
